//! Every key of the configuration: its meaning, default, unit, range and ablations.
//!
//! Documents that repeat them are made from this file; `dpges-train/cli/tests/documents.rs` says how.

use dpges_core::ops::peel::MAX_LAYERS;
use dpges_core::scene::{ColourModel, DepthWeight, Footprint, OpacityActivation, Peeling, Transparency};

use super::budget::Budget;
use super::choices::{
    Alpha, Background, DepthMaps, Environment, Exposure, GaussianStage, InitMethod, JointOpacity, Margin, Method,
    NewGaussians, Poses, Stop, SurfelStart, Upwards,
};
use super::declare::{Ablation, Key, Section, Value, configuration, optional};
use super::error::ConfigError;
use super::memory::Memory;
use super::pixels::PixelCount;
use super::range::{self, POSITIVE, POSITIVE_SHARE};
use crate::dataset::MaxResolution;

configuration! {
    /// How a dataset is read.
    [data] DataConfig {
        /// Colour behind the scene. Pictures with alpha are composited on it.
        background: Background = Background::Auto;
        /// What is up in the scene: for orbits, the window, pages and exports.
        up: Upwards = Upwards::Auto;
        /// Meaning of the alpha of pictures.
        alpha: Alpha = Alpha::Matte;
        /// Masks are black where pixels count, and white where they are ignored, instead of the other way round.
        invert_masks: bool = false;
        /// Which photographs to read: 1 for the folder `images`, N for `images_N`, downsampled N times as shipped.
        image_scale: u32 = 1, range: 1..;
        /// Longest side of a picture. Larger photographs are downsampled; 0 sets no limit.
        max_resolution: MaxResolution = MaxResolution(1600), unit: "px";
        /// Hold out every n-th view by name for testing if the dataset has no split of its own. 0 holds out none.
        test_every: usize = 8, unit: "views";
        /// Keep every n-th training view for validation, for `train.stop` and `refine.budget` to decide by. 0 keeps
        /// every 8th if `train.stop = "validation"`, and none otherwise.
        validation_every: usize = 0, unit: "views";
        /// Most memory for photographs. Those beyond are read again from their files whenever they are needed, which takes
        /// time and changes nothing else.
        memory: Memory = Memory::Auto;
        /// Most memory of a GPU for the photographs and masks of training views, which stay there once they were uploaded. Those
        /// beyond are uploaded by every step that needs them, which takes time and changes nothing else.
        device_memory: Memory = Memory::Gigabytes(2.0);
        /// Near plane of every camera. 0 takes a tenth of the depth of the nearest points that the cameras see, or a 400th of
        /// the extent where there are no points.
        near: f64 = 0.0, unit: "world units", range: 0.0..;
        /// Resample photographs that were taken through a lens for a pinhole camera. Otherwise the scene is trained and
        /// evaluated through the lens, on the photographs as they are, which discs cannot be (`stages.surfels = 0`).
        undistort: bool = true;
        /// Depth maps beside the photographs, 16-bit grey PNGs in which 0 means unknown: the `depth_file_path` of a frame,
        /// or files in the folder `depths` named as the photographs. `train.lambda_depth_maps` is their weight.
        depth: DepthMaps = DepthMaps::None;
        /// File of measured points, PLY, LAS, LAZ or E57, that training begins with in place of those of the dataset. It has the
        /// coordinates of the cameras. Empty for none. `train.lambda_points` holds surfels to them.
        points: String = String::new();
    }

    /// Length, losses and output of a run.
    [train] TrainConfig {
        /// The method to train.
        method: Method = Method::Dpges;
        /// Length of the run, all stages together. Each step renders one view.
        steps: usize = 5000, unit: "steps", range: 1..;
        /// The end of the run.
        stop: Stop = Stop::Steps;
        /// End the run after this many evaluations in a row without a better validation PSNR, if
        /// `train.stop = "validation"`.
        patience: usize = 5, unit: "evaluations", range: 1..;
        /// Seed of all random numbers.
        seed: u64 = 0, range: ..=i64::MAX as u64;
        /// λ1: weight of the L1 loss of the surfels rendered alone (DP-GES).
        lambda_surfel: f64 = 0.01, range: 0.0..,
            ablation: "no-surfel-loss" = "0" ("Without the loss of the surfels rendered alone");
        /// λ2: weight of the scale loss (DP-GES: 5e-5 for unbounded and 1e-5 for bounded scenes).
        lambda_scale: f64 = 1e-5, range: 0.0.., ablation: "no-scale-loss" = "0" ("Without the scale loss");
        /// λ3: weight of the transmittance loss (DP-GES: 0.08), which continuous peeling does without.
        lambda_transmittance: f64 = 0.0, range: 0.0..,
            ablation: "no-transmittance-loss" = "0" ("Without the transmittance loss"),
            ablation: "transmittance-loss" = "0.08" ("With the transmittance loss");
        /// Weight of the mean opacity of Gaussians in the joint stage of scenes whose background is not given (3DGS-MCMC: 0.01,
        /// DP-GES: 0). It makes those fade that few pictures need. Without an environment, runs of 50 passes over the
        /// photographs have all of it, and those of 150 none.
        lambda_opacity: f64 = 3e-3, range: 0.0..,
            ablation: "no-opacity-loss" = "0" ("Let Gaussians stay that few pictures need");
        /// Weight of the mean scale of these Gaussians, relative to the extent of the scene (DP-GES: 0; 3DGS-MCMC: 0.01 per
        /// world unit).
        lambda_gaussian_scale: f64 = 0.05, unit: "per extent", range: 0.0..;
        /// Weight of what surfels and Gaussians hide of the environment, in the joint stage, at pixels that show nothing but
        /// sky: above the horizon, with no point of the dataset up to the border of the picture, and of the colour of the sky.
        lambda_sky: f64 = 0.1, range: 0.0.., ablation: "no-sky-loss" = "0" ("Let surfels and Gaussians take part in the sky");
        /// Share of D-SSIM in the image loss; the rest is L1 (3DGS).
        lambda_dssim: f64 = 0.2, range: 0.0..=1.0;
        /// Whether every training view has a colour correction of its own, for photographs with different exposures or
        /// white balances. The scene has the mean exposure of all.
        exposure: Exposure = Exposure::Off;
        /// Whether every training view has a small rotation and translation of its own, for cameras that were not placed
        /// quite right. What all have in common is left out: a rotation, a translation, and a scale.
        poses: Poses = Poses::Off;
        /// λ4: weight of the difference between the depths of surfels and of the discs they come from, for surface
        /// reconstruction (DP-GES: 0.1), in fifths of the extent. It acts in the joint stage and needs a stage or a file of discs.
        lambda_disc_depth: f64 = 0.0, range: 0.0..;
        /// λ5: weight of the difference between the normals of surfels and discs, likewise (DP-GES: 0.05).
        lambda_disc_normal: f64 = 0.0, range: 0.0..;
        /// λ6: weight of the difference between the normals of the surfels' depth and the discs' normals, likewise
        /// (DP-GES: 0.05).
        lambda_disc_depth_normal: f64 = 0.0, range: 0.0..;
        /// Weight of the relative error of rendered depths against the depth maps of `data.depth`: of surfels in the joint
        /// stage, of all primitives in the stages before it. With 0 maps are read but not used.
        lambda_depth_maps: f64 = 0.2, range: 0.0..;
        /// Factor on `train.lambda_depth_maps` at the last step of the run. Its logarithm is interpolated from 1 at the first.
        depth_maps_decay: f64 = 0.01, range: POSITIVE_SHARE;
        /// Weight of the distance between surfels and the points of the dataset next to them, up to three spacings of the points,
        /// along the normals of the surfels and in fifths of the extent, in the joint stage. For points of a laser (`data.points`): those
        /// of structure from motion are not as exact.
        lambda_points: f64 = 0.0, range: 0.0..;
        /// File that says which block of a large capture the run trains: its views, its bounds and the scene around it
        /// (`dpges blocks` writes it). Empty for the whole capture.
        block: String = String::new();
        /// Stop the gradient from Gaussians to surfels through the transmittance.
        detach_transmittance: bool = false,
            ablation: "no-transmittance-gradient" = "true" ("Without the gradient from Gaussians to surfels");
        /// Keep positions, rotations and scales of surfels in the joint stage, and prune none. Colours are still
        /// trained (GES).
        freeze_surfels: bool = false, ablation: "frozen-surfels" = "true" ("Train only the colours of surfels");
        /// Largest share of Gaussians that a step leaves out at random, in the joint stage of scenes with an environment
        /// (DropGaussian; DP-GES: 0), so that these learn no photograph by heart. Runs of up to 50 passes over the training
        /// views leave out none, those of 150 passes or more as many.
        dropout: f64 = 0.2, range: 0.0..1.0, ablation: "no-dropout" = "0" ("Leave out no Gaussians at random");
        /// Interval of evaluations on held-out views. 0 evaluates only at the end.
        evaluate_every: usize = 1000, unit: "steps";
        /// Interval of checkpoints. 0 writes one only at the end.
        checkpoint_every: usize = 1000, unit: "steps";
    }

    /// Primitives of a scene, and how they are drawn.
    [model] ModelConfig {
        /// How colours depend on the viewing direction.
        colour: ColourModel = ColourModel::SphericalBeta { lobes: 2 },
            ablation: "sh" = "sh3" ("Replace spherical Beta lobes by spherical harmonics of degree 3");
        /// K: number of surfels peeled per pixel (DP-GES).
        layers: usize = 5, range: 1..=MAX_LAYERS,
            ablation: "layers-2" = "2" ("Peel two layers"), ablation: "layers-3" = "3" ("Peel three layers"),
            ablation: "layers-4" = "4" ("Peel four layers");
        /// w: steepness of a surfel's rim. Its opacity is min(1, w G), where G is its Gaussian kernel (DP-GES: 30,
        /// GES: 255). A single layer needs hard rims: nothing shows behind soft ones, so surfels grow over the picture.
        modulation: f64 = 30.0, range: POSITIVE, ablation: "modulation-60" = "60" ("Make rims of surfels twice as steep");
        /// How the opacity of a Gaussian in the joint stage follows from the trained number.
        opacity: OpacityActivation = OpacityActivation::Linear,
            ablation: "sigmoid-opacity" = "sigmoid" ("Keep opacities of Gaussians below 1");
        /// Where a surfel is cut off.
        footprint: Footprint = Footprint::Kernel,
            ablation: "opacity-footprint" = "opacity" ("Cut surfels off by opacity instead of kernel value");
        /// Which surfels of a pixel are its layers, and how they hide each other and Gaussians. The scene file keeps it.
        peeling: Peeling = Peeling::Continuous,
            ablation: "nearest-layers" = "nearest" ("Peel the nearest surfels, opaque or not, in strict order"),
            ablation: "literal-lookup" = "literal" ("The same, and look the transmittance up without margins");
        /// Which scales the depth margin of a surfel is computed from.
        margin: Margin = Margin::Median, ablation: "raw-margin" = "raw" ("Compute margins from a surfel's own scales");
        /// Colour behind all surfels and Gaussians, in the direction of a pixel.
        environment: Environment = Environment::Auto,
            ablation: "no-environment" = "none" ("Without an environment, if the run has one");
        /// Standard deviation of a filter in the world that limits how fine surfels and Gaussians of the joint stage are:
        /// in pixels of the training view that resolves them best (Mip-Splatting: √0.2). 0 sets no limit (DP-GES), but
        /// √0.2 with `train.method = "mip-splatting"` or `"htgs"`.
        sampling_limit: f64 = 0.0, unit: "px", range: 0.0..,
            ablation: "sampling-limit" = "0.4472136" ("Let no primitive be finer than the training views resolve");
    }

    /// Where surfels and Gaussians start, unless a stage has trained them.
    [init] InitConfig {
        /// Where surfels and Gaussians start.
        method: InitMethod = InitMethod::Auto;
        /// Largest number of points. The rest are dropped at random; each point gives a surfel and a Gaussian.
        max_points: usize = 50_000, unit: "points", range: 1..;
        /// Start no primitive larger than 0.06 extents of the scene or 10 times the median (3DGS, DP-GES: false).
        limit_scales: bool = true;
        /// Number of Gaussians that start at random places.
        random_gaussians: usize = 50_000, range: 1..;
        /// Half the side of the cube around the origin in which they are (3DGS: 1.3 for NeRF-Synthetic). 0 takes a cube that
        /// the cameras see.
        random_half_side: f64 = 0.0, unit: "world units", range: 0.0..;
        /// Voxels along each side of the visual hull.
        hull_resolution: usize = 96, unit: "voxels", range: 8..=512;
    }

    /// Stages before surfels and Gaussians are trained together.
    [stages] StagesConfig {
        /// Share of `train.steps` for discs (2DGS), the opaque ones of which become surfels (DP-GES: 20/65). 0 starts
        /// surfels as `[init]` says.
        surfels: f64 = 0.0, range: 0.0..=1.0,
            ablation: "no-surfel-stage" = "0" ("Without the stage of discs, if the run has one");
        /// Share of `train.steps` for Gaussians (DP-GES: 20/65). 0 starts them as `[init]` says. It has no effect with
        /// `stages.gaussians_by = "rest"`.
        gaussians: f64 = 0.2, range: 0.0..=1.0,
            ablation: "no-gaussian-stage" = "0" ("Without the stage of Gaussians, if the run has one");
        /// Share of `train.steps` that learns from photographs of half the width and height, with no more primitives than the budget
        /// `pixels` has for these, before the rest of the joint stage learns from all of their pixels. 0 for none. Photographs of fewer
        /// than 300 px, methods alone, and runs with discs or that begin with a file have none (DP-GES: 0).
        coarse: f64 = 0.0, range: 0.0..=1.0, ablation: "coarse-to-fine" = "0.7" ("Learn from photographs of half the size first");
        /// Where the Gaussians of the joint stage come from.
        gaussians_by: GaussianStage = GaussianStage::Mcmc,
            ablation: "dbs-gaussians" = "dbs" ("Train Gaussians by DBS, if the run has a stage of them");
        /// Scene file whose discs or surfels replace the stage of discs. Empty for none.
        surfels_from: String = String::new();
        /// Scene file whose Gaussians replace the stage of Gaussians. Empty for none.
        gaussians_from: String = String::new();
        /// Opacity above which a disc becomes a surfel (GES, DP-GES).
        surfel_opacity: f64 = 0.8, range: 0.0..=1.0;
        /// Scale of a surfel relative to its disc (DP-GES: 1). A disc is half opaque at 1.2 σ and a surfel with w = 30
        /// at 2.9 σ, so they cover the same area at about 0.4.
        surfel_scale: f64 = 0.35, range: POSITIVE;
        /// Where surfels start if no discs were trained.
        surfels_by: SurfelStart = SurfelStart::Depth;
        /// Largest share of `refine.budget` of surfels that start on surfaces seen in depths.
        depth_surfels: f64 = 0.4, range: POSITIVE_SHARE;
        /// Share of `refine.budget` that discs may use. 0 sets no limit (2DGS).
        surfel_budget: f64 = 0.3, range: 0.0..;
        /// Share of `refine.budget` that Gaussians may use before the joint stage.
        gaussian_budget: f64 = 0.9, range: POSITIVE_SHARE;
        /// Opacity in the joint stage of Gaussians that were blended before, if `model.opacity` is linear; otherwise it is
        /// kept.
        joint_opacity: JointOpacity = JointOpacity::Odds;
        /// Share of the decay from `optimizer.position_start` to `optimizer.position_end` that each of these stages goes
        /// through, and at which the joint stage begins (DP-GES: 2/3).
        position_share: f64 = 0.0, range: 0.0..=1.0;
    }

    /// Training of discs (2DGS).
    [discs] DiscsConfig {
        /// Weight of the difference between normals and the normals of the depth, from 7000 steps of a stage of 20,000 on (2DGS).
        lambda_normal: f64 = 0.05, range: 0.0..;
        /// Weight of the depth distortion, from 3000 such steps on (2DGS).
        lambda_distortion: f64 = 0.0, range: 0.0..;
    }

    /// Adaptive density control of discs and Gaussians (2DGS, 3DGS, AbsGS, Mip-Splatting, HTGS).
    [density] DensityConfig {
        /// Mean norm of the gradient of the projected centre above which a disc or a Gaussian is cloned or split (3DGS).
        gradient_threshold: f64 = 2e-4, unit: "per NDC unit", range: POSITIVE;
        /// Which fragments of a pixel have an order, with `train.method = "htgs"`.
        transparency: Transparency = Transparency::Hybrid,
            ablation: "nearest-alone" = "nearest" ("Blend the nearest fragments alone, with `train.method = \"htgs\"`"),
            ablation: "sorted-by-centres" = "sorted" ("One order for all pixels, with `train.method = \"htgs\"`"),
            ablation: "tail-alone" = "tail" ("No order at all, with `train.method = \"htgs\"`");
    }

    /// Gaussians that are summed in any order (`train.method = "sortfree"`).
    [weighted_sum] WeightedSumConfig {
        /// How a Gaussian is weighed by its depth d.
        weight: DepthWeight = DepthWeight::Linear,
            ablation: "weights-dir" = "dir" ("Weigh all depths alike, with `train.method = \"sortfree\"`"),
            ablation: "weights-exp" = "exp" ("Weigh depths exponentially, with `train.method = \"sortfree\"`");
    }

    /// Positions of Student's t kernels (SSS), with `train.method = "sss"`.
    [students] StudentsConfig {
        /// Friction and noise of positions after burn-in (SSS: 100 to 120).
        friction: f64 = 100.0, range: 0.0..;
        /// The same in burn-in (SSS: 5e5, for two scenes 5e8).
        burn_in_friction: f64 = 5e5, range: 0.0..;
        /// End of burn-in. The number is that of a run of 30,000 steps and scales with its length (SSS).
        burn_in: usize = 7000, unit: "steps";
    }

    /// Training of Gaussians that are relocated (3DGS-MCMC, DBS).
    [relocation] RelocationConfig {
        /// Weight of the mean opacity in the loss (3DGS-MCMC; for one scene it takes 0.001).
        lambda_opacity: f64 = 0.01, range: 0.0..;
        /// Scale at the start relative to the root mean square distance to the 3 nearest points (DBS: 1, 3DGS-MCMC: 0.1).
        start_scale: f64 = 1.0, range: POSITIVE;
    }

    /// Adam. Learning rates are per step and of raw parameters. The defaults suit 5000 steps; the presets of benchmarks
    /// have the paper's rates, for 65,000.
    [optimizer] OptimizerConfig {
        /// Learning rate of positions at the first step (3DGS).
        position_start: f64 = 1.6e-4, unit: "extents", range: POSITIVE;
        /// Learning rate of positions at the last step. Its logarithm is interpolated in between (3DGS).
        position_end: f64 = 1.6e-6, unit: "extents", range: POSITIVE;
        /// Learning rate of quaternions.
        quaternions: f64 = 4e-3, range: 0.0..;
        /// Learning rate of the logarithms of scales.
        log_scales: f64 = 0.015, range: 0.0..;
        /// Factor on the learning rates of positions, quaternions and scales in the joint stage (DP-GES: 1).
        joint_geometry: f64 = 2.0, range: 0.0..;
        /// Learning rate of opacities in the joint stage.
        opacities: f64 = 0.02, range: 0.0..;
        /// Learning rate of base colours.
        base: f64 = 0.01, range: 0.0..;
        /// Learning rate of lobes, or of spherical harmonics above degree 0.
        detail: f64 = 0.01, range: 0.0..;
        /// Learning rate of the environment.
        environment: f64 = 5e-3, range: 0.0..;
        /// Learning rate of the colour corrections of `train.exposure` at the first step of the run. It falls to a tenth at
        /// the last.
        exposure: f64 = 5e-3, range: 0.0..;
        /// Learning rate of the rotations of `train.poses`, in radians, and of their translations, in extents. It rises from 0
        /// over a tenth of the run, and falls to 0 at its end.
        poses: f64 = 1e-3, unit: "radians, extents", range: 0.0..;
        /// Share of the run after which poses are learnt: before, the scene is too coarse to say where cameras are.
        pose_from: f64 = 0.2, range: 0.0..1.0;
        /// Factor on all learning rates but those of positions at the last step of the last stage (DP-GES, 3DGS: 1).
        /// Its logarithm is interpolated from 1 after seven tenths of the stage.
        decay: f64 = 0.3, range: POSITIVE;
    }

    /// How the set of surfels and Gaussians changes in the joint stage. Numbers of steps are those of a stage of 25,000
    /// steps and scale with its length.
    [refine] RefineConfig {
        /// Steps at which margins are computed (DP-GES).
        margins_at: Vec<usize> = vec![0, 4000], unit: "steps";
        /// Interval of pruning surfels. It is extended to whole passes over the training views.
        surfel_prune_every: usize = 1000, unit: "steps", range: 1..;
        /// First step at which surfels are pruned.
        surfel_prune_from: usize = 1000, unit: "steps";
        /// Last step at which surfels are pruned, inclusive.
        surfel_prune_until: usize = 15_000, unit: "steps";
        /// Remove a surfel that is the nearest at no more pixels than this in every view.
        surfel_pixels: PixelCount = PixelCount::PerMegapixel(16);
        /// Interval of pruning Gaussians. It is extended to whole passes over the training views.
        gaussian_prune_every: usize = 500, unit: "steps", range: 1..;
        /// Step at which pruning of Gaussians ends, exclusive (DP-GES: 2000). With 0 none is pruned.
        gaussian_prune_until: usize = 0, unit: "steps";
        /// Remove a Gaussian that contributes less than this colour to every pixel.
        gaussian_min_contribution: f64 = 0.02, range: 0.0..;
        /// Interval of adding Gaussians.
        add_every: usize = 1000, unit: "steps", range: 1..;
        /// First step at which Gaussians are added.
        add_from: usize = 3000, unit: "steps";
        /// Step at which adding Gaussians ends, exclusive.
        add_until: usize = 13_000, unit: "steps";
        /// Step at which replacing Gaussians ends, exclusive (DP-GES: 0). From `refine.add_until` on, and with every
        /// batch before, new Gaussians take the place of those too faint to be drawn.
        replace_until: usize = 20_000, unit: "steps",
            ablation: "no-replacement" = "0" ("Replace no Gaussians after the last batch");
        /// Kind of new Gaussians.
        new_gaussians: NewGaussians = NewGaussians::Copies,
            ablation: "black-gaussians" = "black" ("Add black Gaussians where errors are large");
        /// Largest number of surfels and Gaussians together, or largest size of the scene file.
        budget: Budget = Budget::Pixels;
        /// Interval of splitting Gaussians that are large compared with the margins around them (DP-GES).
        split_every: usize = 2000, unit: "steps", range: 1..;
        /// Last step at which Gaussians are split, inclusive. With 0 none is split.
        split_until: usize = 16_000, unit: "steps", ablation: "no-split" = "0" ("Split no Gaussians");
        /// Mean scale of a Gaussian relative to the margins around it above which it is split (DP-GES).
        split_factor: f64 = 2.0, range: POSITIVE;
    }
}
