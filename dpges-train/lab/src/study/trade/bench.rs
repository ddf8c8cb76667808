//! Pictures and frame times of a scene, on the real-time renderer or, without an adapter, on the one that trains.

use std::path::Path;

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::scene::{Quality, SceneData};
use dpges_render::frame_times::{FrameTimes, Rounds, frame_times};
use dpges_render::{Headless, Precision, RasterRenderer, RenderOptions, Rgb8Image};
use dpges_train::dataset::View;
use dpges_train::eval::compress::Compressed;
use dpges_train::eval::pictures::save_png;
use dpges_train::eval::rendered::{TrainingRenderer, scaled, to_picture};
use dpges_train::eval::{Measures, ViewScore, mean_scores, score_picture};
use dpges_train::metrics::lpips::Lpips;
use dpges_train::run::scene::in_scene;
use glam::DVec3;
use image::imageops::{FilterType, resize};
use image::{ImageBuffer, Rgb};

use super::super::Result;
use super::super::row::Row;
use super::knob::Change;

/// Folder of the pictures in that of the study.
pub const PICTURES: &str = "pictures";
/// Rounds over the cameras that are not counted.
const WARM_UP: usize = 1;

struct Drawn {
    pictures: Vec<Rgb8Image>,
    times: FrameTimes,
    /// On the adapter; `None` without one.
    gpu_bytes: Option<u64>,
}

/// Draws scenes from the views of one dataset.
pub struct Bench<'a> {
    /// In the coordinates of a scene with the offset below.
    pub views: Vec<&'a View>,
    pub offset: DVec3,
    /// A camera with the size of frames.
    pub sized: &'a dyn Fn(&Camera) -> Camera,
    /// Counted rounds over the views.
    pub rounds: usize,
    /// Where pictures are compared, and drawn without an adapter.
    pub device: &'a Device,
    /// On that device: LPIPS is measured by these.
    pub networks: &'a [Lpips],
    /// `None`: the renderer that is trained with.
    pub headless: Option<Headless>,
    /// Of the study.
    pub folder: &'a Path,
}

impl Bench<'_> {
    /// Whether there is a choice between sums of 32 and of 16 bits.
    pub fn sums_floats(&self) -> bool {
        let best = |headless: &Headless| RasterRenderer::best_precision(headless.device());
        self.headless.as_ref().map(best) == Some(Precision::Float)
    }

    /// The row of `scene`, drawn as those of `changes` say that are no part of it. Its first picture is kept.
    ///
    /// # Errors
    /// If the scene cannot be drawn, or the picture not be written.
    pub fn row(&self, scene: &SceneData, changes: &[Change], label: &str, seed: Option<u64>) -> Result<Row> {
        let mut row = Row::new(label, seed);
        row.settings = changes.iter().map(Change::to_string).collect();
        row.set_counts(scene.surfels.len(), scene.gaussians.len());
        let (mut percent, mut level) = (100, None);
        for change in changes {
            match *change {
                Change::Resolution(of_side) => percent = of_side,
                Change::Compression(index) => level = Some(Quality::LEVELS[index].1),
                _ => {}
            }
        }
        let (compressed, bytes) = match level {
            Some(quality) => {
                let compressed = Compressed::new(scene, &quality, Path::new("scene.safetensors"))?;
                (Some(compressed.scene()?), compressed.bytes.len() as u64)
            }
            None => (None, file_bytes(scene)?),
        };
        let scene = compressed.as_ref().unwrap_or(scene);
        let smaller =
            |camera: Camera| if percent == 100 { camera } else { scaled(&camera, f64::from(percent) / 100.0) };
        let cameras: Vec<Camera> =
            self.views.iter().map(|view| in_scene(view.camera, self.offset, &scene.info)).collect();
        let frames: Vec<Camera> = cameras.iter().map(|camera| smaller((self.sized)(camera))).collect();
        let drawn: Vec<Camera> = cameras.into_iter().map(smaller).collect();
        let Drawn { pictures, times, gpu_bytes } = match &self.headless {
            Some(headless) => self.raster(headless, scene, &drawn, &frames, changes.contains(&Change::HalfSums))?,
            None => self.training(scene, &drawn, &frames)?,
        };
        let shown: Vec<Rgb8Image> = pictures
            .into_iter()
            .zip(&self.views)
            .map(|(picture, view)| enlarged(picture, view.camera.width, view.camera.height))
            .collect();
        let measures = Measures::lpips(self.networks);
        let score = |(view, picture): (&&View, &Rgb8Image)| score_picture(view, picture, 0.0, self.device, measures);
        let scores = self.views.iter().zip(&shown).map(score).collect::<Result<Vec<ViewScore>, _>>()?;
        let scores = mean_scores(&scores);
        row.set_scores(&scores);
        row.set("frame_ms", Some(times.p50_ms));
        row.set("frame_p99_ms", Some(times.p99_ms));
        row.set("frames", Some(times.frames as f64));
        row.set("bytes", Some(bytes as f64));
        row.set("gpu_bytes", gpu_bytes.map(|bytes| bytes as f64));
        let (psnr, ms, megabytes) = (scores.psnr, times.p50_ms, bytes as f64 / 1e6);
        tracing::info!("{label}: {psnr:.2} dB, {ms:.2} ms, {megabytes:.2} MB");
        let file = format!("{PICTURES}/{}.png", file_stem(label, seed));
        save_png(&shown[0], &self.folder.join(&file))?;
        row.picture = Some(file);
        Ok(row)
    }

    fn counts(&self) -> Rounds {
        Rounds { warm_up: WARM_UP, counted: self.rounds }
    }

    fn raster(
        &self,
        headless: &Headless,
        scene: &SceneData,
        cameras: &[Camera],
        frames: &[Camera],
        half_sums: bool,
    ) -> Result<Drawn> {
        let mut renderer = headless.renderer_with(half_sums.then_some(Precision::Half))?;
        renderer.upload(scene)?;
        let options = RenderOptions::from(&scene.info);
        let draw = |camera: &Camera| headless.draw(&mut renderer, camera, &options);
        let pictures = cameras.iter().map(draw).collect::<dpges_render::Result<_>>()?;
        let times = frame_times(headless, &mut renderer, frames, &options, self.counts())?;
        Ok(Drawn { pictures, times, gpu_bytes: headless.allocated_bytes() })
    }

    fn training(&self, scene: &SceneData, cameras: &[Camera], frames: &[Camera]) -> Result<Drawn> {
        let renderer = TrainingRenderer::new(scene, self.device);
        let picture = |camera: &Camera| Ok(to_picture(renderer.render(camera)?.image()));
        let pictures = cameras.iter().map(picture).collect::<Result<_>>()?;
        Ok(Drawn { pictures, times: renderer.frame_times(frames, self.counts())?, gpu_bytes: None })
    }
}

/// `picture` at a larger size, by a Catmull-Rom filter.
fn enlarged(picture: Rgb8Image, width: usize, height: usize) -> Rgb8Image {
    if (picture.width, picture.height) == (width, height) {
        return picture;
    }
    let Rgb8Image { width: from_width, height: from_height, bytes } = picture;
    let pixels = ImageBuffer::<Rgb<u8>, _>::from_raw(from_width as u32, from_height as u32, bytes);
    let pixels = pixels.expect("three bytes for every pixel");
    let bytes = resize(&pixels, width as u32, height as u32, FilterType::CatmullRom).into_raw();
    Rgb8Image { width, height, bytes }
}

/// The name of a row as that of a file: letters, digits, `.` and `-`.
fn file_stem(label: &str, seed: Option<u64>) -> String {
    let label = label.replace('%', "");
    let words: Vec<&str> =
        label.split(|c: char| !c.is_alphanumeric() && c != '.').filter(|word| !word.is_empty()).collect();
    let seed = seed.map(|seed| format!("-seed-{seed}")).unwrap_or_default();
    words.join("-") + &seed
}

fn file_bytes(scene: &SceneData) -> Result<u64> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("scene.safetensors");
    scene.save(&path)?;
    Ok(std::fs::metadata(&path)?.len())
}

#[cfg(test)]
mod tests {
    use dpges_train::dataset::{BuiltinOptions, builtin};

    use super::super::knob::tests::scene;
    use super::*;
    use crate::fixtures::device;

    #[test]
    fn smaller_pictures_are_compared_at_the_size_of_the_photographs() {
        let options =
            BuiltinOptions { width: 20, height: 12, train_views: 1, test_views: 2, points: 0, ..Default::default() };
        let dataset = builtin(&options);
        let (scene, _) = scene();
        let device = device();
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join(PICTURES)).unwrap();
        let bench = Bench {
            views: dataset.test.iter().collect(),
            offset: DVec3::ZERO,
            sized: &|camera| camera.resized(16, 8),
            rounds: 2,
            device: &device,
            networks: &[],
            headless: None,
            folder: folder.path(),
        };
        let row = |changes: &[Change]| bench.row(&scene, changes, &super::super::knob::label(changes), None).unwrap();
        let picture = |row: &Row| image::open(folder.path().join(row.picture.as_ref().unwrap())).unwrap().into_rgb8();
        let number = |row: &Row, key: &str| row.get(key).unwrap();
        let [whole, half] = [&[][..], &[Change::Resolution(50)]].map(row);
        for row in [&whole, &half] {
            assert_eq!((picture(row).dimensions(), row.get("frames")), ((20, 12), Some(4.0)));
            assert!(number(row, "psnr") > 0.0 && number(row, "frame_ms") > 0.0);
        }
        assert_eq!(
            (half.settings.as_slice(), half.get("bytes")),
            (&["resolution=50%".to_owned()][..], whole.get("bytes"))
        );
        let compressed = row(&[Change::Compression(0)]);
        assert_ne!(compressed.get("bytes"), whole.get("bytes"));
        assert!((number(&compressed, "psnr") - number(&whole, "psnr")).abs() < 0.5, "{compressed:?}");
        assert!(picture(&whole) != picture(&half) && !bench.sums_floats());
    }

    #[test]
    fn labels_become_names_of_files_that_differ() {
        assert_eq!(file_stem("layers=2 + primitives=50%", None), "layers-2-primitives-50");
        assert_eq!(file_stem("modulation=0.5w", None), "modulation-0.5w");
        assert_eq!(file_stem("budget-half", Some(3)), "budget-half-seed-3");
        let all = Change::all(&scene().0, true);
        let stems: std::collections::HashSet<String> =
            all.iter().map(|change| file_stem(&change.to_string(), None)).collect();
        assert_eq!(stems.len(), all.len());
    }

    #[test]
    fn scaled_cameras_see_the_same() {
        let view = builtin(&BuiltinOptions { width: 21, height: 9, train_views: 1, points: 0, ..Default::default() });
        let camera = view.train[0].camera;
        let small = scaled(&camera, 0.25);
        assert_eq!((small.width, small.height), (5, 2));
        assert!((small.cx / 5.0 - camera.cx / 21.0).abs() < 1e-12 && (small.fy / 2.0 - camera.fy / 9.0).abs() < 1e-12);
        let smallest = scaled(&camera, 0.01);
        assert_eq!((smallest.width, smallest.height), (1, 1));
    }

    #[test]
    fn enlarged_pictures_keep_their_colours() {
        let picture = Rgb8Image { width: 2, height: 2, bytes: [10, 100, 200].repeat(4) };
        assert_eq!(enlarged(picture.clone(), 2, 2), picture);
        let large = enlarged(picture, 5, 3);
        assert_eq!((large.width, large.height, large.bytes), (5, 3, [10, 100, 200].repeat(15)));
    }
}
