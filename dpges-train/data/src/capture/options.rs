//! How cameras are found. The names of values are those of options on the command line.

use clap::ValueEnum;

/// Which program places the cameras.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum SfmProgram {
    /// COLMAP, one photograph after another
    #[default]
    Colmap,
    /// GLOMAP, all photographs at once: quicker if there are hundreds; features and matches are COLMAP's
    Glomap,
}

/// Which camera model is fitted, by its name in COLMAP.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum SfmCamera {
    /// Two focal lengths, a centre, two radial and two tangential coefficients
    #[default]
    #[value(name = "OPENCV")]
    OpenCv,
    /// The same with six radial coefficients
    #[value(name = "FULL_OPENCV")]
    FullOpenCv,
    /// One focal length, a centre, two radial coefficients
    Radial,
    /// One focal length, a centre, one radial coefficient
    SimpleRadial,
    /// Two focal lengths and a centre: for pictures without distortion
    Pinhole,
    /// One focal length and a centre: likewise
    SimplePinhole,
    /// Two focal lengths, a centre, four coefficients of a fisheye lens; `data.undistort` keeps or undoes it
    #[value(name = "OPENCV_FISHEYE")]
    OpenCvFisheye,
}

/// Which pairs of photographs are compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum SfmMatching {
    /// All pairs of up to 200 photographs; neighbours if there are more, in a video or by numbered names
    #[default]
    Auto,
    /// All pairs
    Exhaustive,
    /// Each with those that follow it by name, at distances up to 10 and at powers of two
    Sequential,
}

/// How cameras are found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    pub program: SfmProgram,
    pub camera: SfmCamera,
    pub matching: SfmMatching,
    /// Largest number of frames of a video that become photographs, at least 3.
    pub video_frames: usize,
    /// Whether masks are black where photographs count, instead of white.
    pub invert_masks: bool,
    /// Threads of each program. `None`: as many as it likes.
    pub threads: Option<usize>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            program: SfmProgram::default(),
            camera: SfmCamera::default(),
            matching: SfmMatching::default(),
            video_frames: 150,
            invert_masks: false,
            threads: Some(rayon::current_num_threads()),
        }
    }
}

impl Options {
    /// Those that the features of photographs depend on, in the name of a file.
    pub(super) fn of_features(&self, one_camera: bool) -> String {
        let flag = |name, is_set: bool| if is_set { name } else { "" };
        let flags = [flag("-shared", one_camera), flag("-inverted", self.invert_masks)];
        name_of(self.camera).to_lowercase() + &flags.concat()
    }
}

/// The name of a value on the command line; that of a camera model in COLMAP.
pub fn name_of(value: impl ValueEnum) -> String {
    value.to_possible_value().expect("no variant is skipped").get_name().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_models_have_the_names_of_colmap() {
        let names: Vec<String> = SfmCamera::value_variants().iter().map(|&camera| name_of(camera)).collect();
        let known = ["OPENCV", "FULL_OPENCV", "RADIAL", "SIMPLE_RADIAL", "PINHOLE", "SIMPLE_PINHOLE", "OPENCV_FISHEYE"];
        assert_eq!(names, known);
    }
}
