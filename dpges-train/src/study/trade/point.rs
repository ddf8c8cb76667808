//! What was measured at one setting: an entry of `trade.json`, a line of `trade.csv`.

use dpges_train::metrics::{Fitted, Metric, Perceptual, Scores, further_metrics};
use serde::{Deserialize, Serialize};

/// A scene drawn in one way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Its changes, joined by ` + `; unique but for the seed.
    pub label: String,
    pub kind: Kind,
    /// The knobs that were turned.
    pub knobs: Vec<String>,
    /// Of the run, where one was trained for it.
    pub seed: Option<u64>,
    /// Of the views, dB.
    pub psnr: f64,
    pub ssim: f64,
    /// An error, from 0 to 1.
    pub flip: f64,
    /// LPIPS, where a network was there when it was measured.
    #[serde(flatten)]
    pub perceptual: Perceptual,
    /// Median time of a frame.
    pub frame_ms: f64,
    /// Time that 99 % of the frames do not exceed.
    pub frame_p99_ms: f64,
    pub frames: usize,
    /// What drew the pictures and the frames.
    pub device: String,
    /// Size of the scene file.
    pub bytes: u64,
    pub surfels: usize,
    pub gaussians: usize,
    /// What the device has allocated while it draws; `None` where it does not tell.
    pub gpu_bytes: Option<u64>,
    /// Wall clock of the training up to its last step, where a run was trained.
    pub training_seconds: Option<f64>,
    /// Largest memory of the process while it trained, where the system tells.
    pub training_peak_bytes: Option<u64>,
    /// One view, relative to the folder.
    pub picture: String,
}

/// Which knobs were turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Those of rendering, with the scene that was given.
    Rendering,
    /// Those of training: another scene.
    Training,
}

const COLUMNS: &str = "label,kind,knobs,seed,psnr,ssim,flip,lpips_alex,lpips_vgg,frame_ms,frame_p99_ms,frames,\
                       device,bytes,surfels,gaussians,primitives,gpu_bytes,training_seconds,training_peak_bytes,picture";

impl Point {
    pub fn primitives(&self) -> usize {
        self.surfels + self.gaussians
    }

    fn scores(&self) -> Scores {
        let Self { psnr, ssim, flip, perceptual, .. } = *self;
        Scores { psnr, ssim, flip, perceptual, fitted: Fitted::default() }
    }

    /// The value of `metric` as people read it, empty if it is absent.
    pub fn text(&self, metric: &Metric) -> String {
        metric.of(&self.scores()).map(|value| metric.text(Some(value))).unwrap_or_default()
    }

    fn line(&self) -> String {
        fn known<T: ToString>(value: Option<T>) -> String {
            value.map(|value| value.to_string()).unwrap_or_default()
        }
        let kind = match self.kind {
            Kind::Rendering => "rendering",
            Kind::Training => "training",
        };
        let fields = [
            quoted(&self.label),
            kind.to_owned(),
            quoted(&self.knobs.join(" ")),
            known(self.seed),
            format!("{:.4}", self.psnr),
            format!("{:.6}", self.ssim),
            format!("{:.6}", self.flip),
            known(self.perceptual.lpips_alex.map(|value| format!("{value:.6}"))),
            known(self.perceptual.lpips_vgg.map(|value| format!("{value:.6}"))),
            format!("{:.4}", self.frame_ms),
            format!("{:.4}", self.frame_p99_ms),
            self.frames.to_string(),
            quoted(&self.device),
            self.bytes.to_string(),
            self.surfels.to_string(),
            self.gaussians.to_string(),
            self.primitives().to_string(),
            known(self.gpu_bytes),
            known(self.training_seconds.map(|seconds| format!("{seconds:.1}"))),
            known(self.training_peak_bytes),
            quoted(&self.picture),
        ];
        fields.join(",") + "\n"
    }
}

/// What some of `points` have besides PSNR, SSIM and FLIP.
pub fn further(points: &[Point]) -> Vec<&'static Metric> {
    let is_known = |metric: &&Metric| points.iter().any(|point| metric.of(&point.scores()).is_some());
    further_metrics().iter().filter(is_known).collect()
}

/// A line per point under a line of names; empty where nothing is known (RFC 4180).
pub fn csv(points: &[Point]) -> String {
    let lines: String = points.iter().map(Point::line).collect();
    format!("{COLUMNS}\n{lines}")
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A point of rendering that was measured on an adapter with a comma in its name.
    pub fn point(label: &str, psnr: f64, frame_ms: f64, bytes: u64) -> Point {
        Point {
            label: label.to_owned(),
            kind: Kind::Rendering,
            knobs: label.split(" + ").filter_map(|part| Some(part.split_once('=')?.0.to_owned())).collect(),
            seed: None,
            psnr,
            ssim: 0.75,
            flip: 0.125,
            perceptual: Perceptual::default(),
            frame_ms,
            frame_p99_ms: 2.0 * frame_ms,
            frames: 30,
            device: "llvmpipe (LLVM 19, 256 bits)".to_owned(),
            bytes,
            surfels: 10,
            gaussians: 32,
            gpu_bytes: None,
            training_seconds: None,
            training_peak_bytes: None,
            picture: "pictures/a.png".to_owned(),
        }
    }

    #[test]
    fn the_csv_has_a_line_per_point_and_quotes_what_needs_it() {
        let mut trained = point("budget=half", 20.0, 3.0, 500);
        (trained.kind, trained.seed, trained.training_seconds) = (Kind::Training, Some(4), Some(61.24));
        let mut measured = point("layers=1 + detail=0", 21.5, 2.5, 1000);
        measured.perceptual.lpips_vgg = Some(0.25);
        let text = csv(&[measured, trained]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 3);
        let expected = "layers=1 + detail=0,rendering,layers detail,,21.5000,0.750000,0.125000,,0.250000,2.5000,5.0000,30,\
                        \"llvmpipe (LLVM 19, 256 bits)\",1000,10,32,42,,,,pictures/a.png";
        assert_eq!(lines[1], expected);
        assert!(lines[2].contains(",training,budget,4,20.0000,") && lines[2].contains(",42,,61.2,,"), "{}", lines[2]);
        assert_eq!(lines[0].split(',').count(), expected.split(',').count() - 1, "one comma is quoted");
        assert_eq!(quoted("a \"b\""), "\"a \"\"b\"\"\"");
        assert_eq!(csv(&[]).lines().count(), 1);
    }

    #[test]
    fn what_is_written_is_read_back() {
        let mut point = point("as trained", 30.25, 1.5, 7);
        let without = serde_json::to_string(&point).unwrap();
        assert!(!without.contains("lpips") && serde_json::from_str::<Point>(&without).unwrap() == point, "{without}");
        point.perceptual.lpips_vgg = Some(0.5);
        let text = serde_json::to_string(&point).unwrap();
        assert!(text.contains("\"kind\":\"rendering\"") && text.contains("\"gpu_bytes\":null"), "{text}");
        assert_eq!(serde_json::from_str::<Point>(&text).unwrap(), point);
    }
}
