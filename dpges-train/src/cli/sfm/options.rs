//! Options on photographs without cameras.

use clap::Args;
use dpges_train::dataset::capture::{FEWEST, Options, SfmCamera, SfmMatching, SfmProgram};

/// Options on photographs without cameras.
#[derive(Debug, Args)]
pub struct SfmOptions {
    /// Which program places the cameras of photographs without cameras
    #[arg(long, value_name = "PROGRAM", value_enum, default_value_t)]
    sfm: SfmProgram,
    /// Which camera model it fits to them
    #[arg(long, value_name = "MODEL", value_enum, default_value_t)]
    sfm_camera: SfmCamera,
    /// Which pairs of them it compares
    #[arg(long, value_name = "PAIRS", value_enum, default_value_t)]
    sfm_matching: SfmMatching,
    /// Largest number of frames of a video that become photographs. Of neighbouring frames the sharpest is taken
    #[arg(long, value_name = "N", value_parser = frames, default_value_t = Options::default().video_frames)]
    video_frames: usize,
}

impl SfmOptions {
    /// For photographs whose masks are black where they count if `invert_masks`.
    pub fn options(&self, invert_masks: bool) -> Options {
        Options {
            program: self.sfm,
            camera: self.sfm_camera,
            matching: self.sfm_matching,
            video_frames: self.video_frames,
            invert_masks,
            ..Options::default()
        }
    }
}

fn frames(text: &str) -> Result<usize, String> {
    let fewest = || format!("expected a number of frames, at least {FEWEST}");
    text.parse().ok().filter(|&frames| frames >= FEWEST).ok_or_else(fewest)
}
