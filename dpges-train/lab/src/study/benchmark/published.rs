//! Published scenes, settings and results of datasets and methods.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use serde::Deserialize;

use super::super::ablate;

/// The content of `published.toml`, which says where everything is from.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    #[serde(rename = "dataset")]
    pub datasets: Vec<DatasetEntry>,
    #[serde(rename = "method")]
    pub methods: Vec<MethodEntry>,
    #[serde(rename = "ablation")]
    pub ablations: Vec<AblationEntry>,
}

/// A dataset of several scenes.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetEntry {
    /// Also that of the preset of DP-GES.
    pub name: String,
    pub title: String,
    /// Where it may lie below the folder of all data.
    pub folders: Vec<String>,
    /// The budget of DP-GES.
    pub primitives: usize,
    /// `key=value` of all methods.
    pub settings: Vec<String>,
    #[serde(rename = "group")]
    pub groups: Vec<Group>,
}

/// Scenes of a dataset whose photographs are used alike.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Group {
    pub scenes: Vec<String>,
    /// N of `images_N`.
    pub image_scale: u32,
    /// Range of the longer sides of its photographs, px.
    pub longest_px: [usize; 2],
}

/// A method in the tables.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodEntry {
    pub name: String,
    pub title: String,
    /// The preset that settings are on top of; `dataset` for that of the dataset.
    pub preset: Option<String>,
    /// Whether the paper gave it as many primitives as DP-GES has.
    #[serde(default)]
    pub matches: bool,
    /// `key=value`.
    pub settings: Vec<String>,
    #[serde(default, rename = "exception")]
    pub exceptions: Vec<Exception>,
    /// Primitives by scene, of its own publication.
    #[serde(default)]
    pub caps: BTreeMap<String, usize>,
    /// SSIM, PSNR (dB) and LPIPS by dataset.
    pub quality: BTreeMap<String, [f64; 3]>,
    /// Of Mip-NeRF360.
    pub costs: Option<Costs>,
}

/// `key=value` of some scenes.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exception {
    pub scenes: Vec<String>,
    pub settings: Vec<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Costs {
    pub frames_per_second: f64,
    pub megabytes: f64,
    pub minutes: f64,
    pub flip_1: f64,
    pub flip_7: f64,
}

/// DP-GES without one of its parts.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AblationEntry {
    pub name: String,
    pub title: String,
    /// A variant of [`ablate::VARIANTS`].
    pub variant: String,
    /// `key=value` on top of it.
    #[serde(default)]
    pub settings: Vec<String>,
    /// As in [`MethodEntry::quality`], of Mip-NeRF360.
    pub quality: [f64; 3],
    pub frames_per_second: f64,
}

pub static PUBLISHED: LazyLock<Published> =
    LazyLock::new(|| toml::from_str(include_str!("published.toml")).expect("comes with the program"));

/// Name of the dataset of Table 2 and Table 3.
pub const MIPNERF360: &str = "mipnerf360";
/// The method of the paper.
pub const DPGES: &str = "dpges";

/// A way to train: a method, or an ablation of DP-GES.
#[derive(Debug)]
pub struct Way {
    pub name: &'static str,
    /// Of which scenes have which settings.
    method: &'static MethodEntry,
    /// `key=value` on top of the method.
    settings: Vec<String>,
    /// Whether it is DP-GES without one of its parts.
    pub is_ablation: bool,
}

/// All that this program can train: methods, then ablations, each in the order of the tables.
pub static WAYS: LazyLock<Vec<Way>> = LazyLock::new(|| {
    let whole =
        |method: &'static MethodEntry| Way { name: &method.name, method, settings: Vec::new(), is_ablation: false };
    let dpges = PUBLISHED.methods.iter().find(|method| method.name == DPGES).expect("the method of the paper");
    let ablated = |ablation: &'static AblationEntry| {
        let variant = ablate::VARIANTS.iter().find(|variant| variant.label == ablation.variant);
        let of_variant = &variant.expect("a variant of `dpges ablate`").settings;
        let settings = [of_variant, &ablation.settings[..]].concat();
        Way { name: &ablation.name, settings, is_ablation: true, ..whole(dpges) }
    };
    let ablations = PUBLISHED.ablations.iter().filter(|ablation| ablation.name != DPGES);
    PUBLISHED.methods.iter().map(whole).chain(ablations.map(ablated)).collect()
});

impl Published {
    /// Of datasets.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.datasets.iter().map(|dataset| &dataset.name[..])
    }

    /// The dataset that is called `name`.
    pub fn dataset(&self, name: &str) -> Option<&DatasetEntry> {
        self.datasets.iter().find(|dataset| dataset.name == name)
    }
}

impl DatasetEntry {
    pub fn scenes(&self) -> impl Iterator<Item = &str> {
        self.groups.iter().flat_map(|group| group.scenes.iter().map(String::as_str))
    }

    /// The group of `scene`.
    pub fn group(&self, scene: &str) -> Option<&Group> {
        self.groups.iter().find(|group| group.scenes.iter().any(|other| other == scene))
    }
}

impl Way {
    /// Whether it is trained on `dataset`.
    pub fn is_of(&self, dataset: &DatasetEntry) -> bool {
        !self.is_ablation || dataset.name == MIPNERF360
    }

    /// The preset for a scene of `dataset`.
    pub fn preset<'a>(&self, dataset: &'a DatasetEntry) -> Option<&'a str> {
        let preset = self.method.preset.as_deref()?;
        Some(if preset == "dataset" { &dataset.name } else { preset })
    }

    /// `key=value` for `scene` of `dataset`. With `own_caps` a method that matches DP-GES in the paper has as many primitives
    /// as in its own publication, if that says how many.
    pub fn settings(&self, dataset: &DatasetEntry, scene: &str, own_caps: bool) -> Vec<String> {
        let image_scale = dataset.group(scene).map_or(1, |group| group.image_scale);
        let of = self.method.exceptions.iter().filter(|exception| exception.scenes.iter().any(|other| other == scene));
        let cap = self.method.caps.get(scene).filter(|_| own_caps && self.method.matches);
        let primitives = cap.copied().unwrap_or(dataset.primitives);
        let of_scene = [format!("data.image_scale={image_scale}"), format!("refine.budget={primitives}")];
        let mut settings = [&dataset.settings[..], &of_scene, &self.method.settings].concat();
        settings.extend(of.flat_map(|exception| exception.settings.iter().cloned()));
        settings.extend_from_slice(&self.settings);
        settings
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use dpges_train::config::{Budget, Config};

    use super::super::super::compare;
    use super::*;

    fn config(way: &str, dataset: &str, scene: &str, own_caps: bool) -> Config {
        let (way, dataset) =
            (WAYS.iter().find(|known| known.name == way).unwrap(), PUBLISHED.dataset(dataset).unwrap());
        Config::resolve(way.preset(dataset), None, &way.settings(dataset, scene, own_caps)).unwrap()
    }

    #[test]
    fn every_key_of_a_known_method_exists_for_every_scene() {
        for dataset in &PUBLISHED.datasets {
            for way in WAYS.iter() {
                for (scene, own_caps) in dataset.scenes().flat_map(|scene| [(scene, false), (scene, true)]) {
                    let settings = way.settings(dataset, scene, own_caps);
                    if let Err(error) = Config::resolve(way.preset(dataset), None, &settings) {
                        panic!("{} on {scene}: {error}", way.name);
                    }
                }
            }
        }
        let of_compare: HashSet<&str> = compare::METHODS.iter().map(|method| method.label).collect();
        for method in &PUBLISHED.methods {
            assert!(of_compare.contains(&method.name[..]), "{} is no method of `dpges compare`", method.name);
        }
        for exception in PUBLISHED.methods.iter().flat_map(|method| &method.exceptions) {
            assert!(exception.settings.iter().all(|setting| setting.contains('=')), "{exception:?}");
        }
    }

    #[test]
    fn names_are_those_of_scenes_datasets_and_methods_and_differ() {
        let scenes: Vec<&str> = PUBLISHED.datasets.iter().flat_map(DatasetEntry::scenes).collect();
        assert_eq!(scenes.iter().collect::<HashSet<_>>().len(), 21);
        for method in &PUBLISHED.methods {
            let of_exceptions = method.exceptions.iter().flat_map(|exception| &exception.scenes);
            assert!(method.caps.keys().chain(of_exceptions).all(|scene| scenes.contains(&&scene[..])), "{method:?}");
            assert!(method.quality.keys().all(|dataset| PUBLISHED.dataset(dataset).is_some()), "{method:?}");
            assert_eq!(method.quality.len(), PUBLISHED.datasets.len(), "{}", method.name);
        }
        let names: Vec<&str> = WAYS.iter().map(|way| way.name).collect();
        assert_eq!(names.iter().collect::<HashSet<_>>().len(), names.len());
        for known in ["3dgs", "mcmc", "dbs", "ges", "dpges", "layers-2", "base-mcmc"] {
            assert!(names.contains(&known), "{known}: {names:?}");
        }
        assert_eq!(WAYS.iter().filter(|way| way.is_ablation).count(), 11);
    }

    #[test]
    fn budgets_of_datasets_are_those_of_the_presets() {
        for dataset in &PUBLISHED.datasets {
            let preset = Config::resolve(Some(&dataset.name), None, &[]).unwrap();
            assert_eq!(preset.refine.budget, Budget::Primitives(dataset.primitives), "{}", dataset.name);
            let scene = dataset.scenes().next().unwrap();
            let found = config(DPGES, &dataset.name, scene, true);
            let expected = Config::resolve(
                Some(&dataset.name),
                None,
                &[format!("data.image_scale={}", dataset.groups[0].image_scale)],
            );
            let mut expected = expected.unwrap();
            expected.init.random_gaussians = found.init.random_gaussians;
            assert_eq!(found, expected, "nothing but the scale of the photographs is changed: {}", dataset.name);
        }
    }

    #[test]
    fn scenes_have_their_pictures_caps_and_exceptions() {
        let budget = |way, dataset, scene, own| config(way, dataset, scene, own).refine.budget;
        assert_eq!(budget("mcmc", "mipnerf360", "bicycle", false), Budget::Primitives(1_500_000), "that of DP-GES");
        assert_eq!(budget("mcmc", "mipnerf360", "bicycle", true), Budget::Primitives(5_900_000));
        assert_eq!(budget("mcmc", "mipnerf360", "flowers", true), Budget::Primitives(1_500_000), "not published");
        assert_eq!(budget("dbs", "nerf-synthetic", "ship", true), Budget::Primitives(300_000));
        assert_eq!(budget("3dgs", "mipnerf360", "garden", false), Budget::Primitives(20_000_000));
        assert_eq!(config("dpges", "mipnerf360", "room", false).data.image_scale, 2);
        assert_eq!(config("ges", "mipnerf360", "garden", false).data.image_scale, 4);
        let burn_in = |scene| {
            let config = config("sss", "mipnerf360", scene, false);
            config.plan(0)[0].scaled(config.students.burn_in)
        };
        assert_eq!(["garden", "flowers", "bicycle", "stump"].map(burn_in), [7000, 7000, 15_000, 15_000]);
        let lambda = |scene| config("mcmc", "deep-blending", scene, false).relocation.lambda_opacity;
        assert_eq!((lambda("drjohnson"), lambda("playroom")), (0.001, 0.01));
        assert_eq!(config("layers-2", "mipnerf360", "room", false).model.layers, 2);
    }
}
