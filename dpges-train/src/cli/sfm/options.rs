//! Options on photographs without cameras.

use clap::Args;
use dpges_train::config::key;

/// Options that replace keys of `[data]` on photographs without cameras.
#[derive(Debug, Args)]
pub struct SfmOptions {
    #[arg(long, value_name = "PROGRAM", help = key("data.sfm").help())]
    sfm: Option<String>,
    #[arg(long, value_name = "MODEL", help = key("data.sfm_camera").help())]
    sfm_camera: Option<String>,
    #[arg(long, value_name = "PAIRS", help = key("data.sfm_matching").help())]
    sfm_matching: Option<String>,
    #[arg(long, value_name = "N", help = key("data.video_frames").help())]
    video_frames: Option<usize>,
}

impl SfmOptions {
    /// As `key=value`.
    pub fn assignments(&self) -> Vec<String> {
        let set = |key: &str, value: Option<String>| value.map(|value| format!("data.{key}={value}"));
        [
            set("sfm", self.sfm.clone()),
            set("sfm_camera", self.sfm_camera.clone()),
            set("sfm_matching", self.sfm_matching.clone()),
            set("video_frames", self.video_frames.map(|count| count.to_string())),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}
