//! Kinds of exports, and what is asked of them.

use std::path::Path;

use clap::ValueEnum;
use dpges_core::scene::length::four_digits;
use dpges_core::scene::{SceneInfo, ScreenFilter};
use dpges_render::Up;
use dpges_render::export::Coordinates;
use dpges_render::export::spz::SpzVersion;

use super::splats::SplatFormat;

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// Splats, in the convention of 3DGS
    Ply,
    /// Splats, quantised: SPZ version 4
    Spz,
    /// Splats, quantised: SPZ version 3, for older readers
    Spz3,
    /// Splats in binary glTF with KHR_gaussian_splatting
    Glb,
    /// Triangles of the surfels
    MeshPly,
    /// Triangles of the surfels in binary glTF
    MeshGlb,
    /// A folder for any web server: the scene itself in a page for browsers
    Html,
    /// A folder for any web server: the scene in levels of detail, of which viewers load what they show
    Lod,
}

/// Which coordinates are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Origin {
    /// Those of the scene, near its origin; what is to be added to them is printed, and stands in the file
    Scene,
    /// Those of the dataset, in 64 bits where they need them: ply and mesh-ply alone
    Dataset,
    /// Those of the scene in metres, by the scale that `dpges scale` has stored. Files of glTF always are, if there is one
    Metres,
}

/// The low-pass filter of the programs that show splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Filter {
    /// 0.1 square pixels, and dimmed by as much as it widens (Mip-Splatting)
    Mip,
    /// 0.3 square pixels and no compensation, as most viewers (3DGS)
    Classic,
}

/// Endings that say what is in a file.
const ENDINGS: [&str; 10] = ["ply", "spz", "glb", "gltf", "sog", "splat", "ksplat", "obj", "safetensors", "html"];

impl ExportFormat {
    /// `None` if it is not one of splats.
    pub fn of_splats(self) -> Option<SplatFormat> {
        match self {
            Self::Ply => Some(SplatFormat::Ply),
            Self::Spz => Some(SplatFormat::Spz(SpzVersion::Four)),
            Self::Spz3 => Some(SplatFormat::Spz(SpzVersion::Three)),
            Self::Glb => Some(SplatFormat::Glb),
            Self::MeshPly | Self::MeshGlb | Self::Html | Self::Lod => None,
        }
    }

    /// The ending of its files; empty for folders.
    const fn ending(self) -> &'static str {
        match self {
            Self::Ply | Self::MeshPly => "ply",
            Self::Spz | Self::Spz3 => "spz",
            Self::Glb | Self::MeshGlb => "glb",
            Self::Html | Self::Lod => "",
        }
    }

    /// Checks that the ending of `out` says no other format.
    ///
    /// # Errors
    /// A sentence that names both.
    pub fn check_ending(self, out: &Path) -> Result<(), String> {
        let ending = out.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        if !ENDINGS.contains(&&*ending) || ending == self.ending() {
            return Ok(());
        }
        let (format, out) = (self.to_possible_value().expect("none is skipped"), out.display());
        let what = match self.ending() {
            "" => "a folder".to_owned(),
            own => format!("a .{own} file"),
        };
        Err(format!("--format {} writes {what}, and --out {out} says .{ending}: name them alike", format.get_name()))
    }
}

impl Origin {
    /// The coordinates to write of a scene of `info`.
    ///
    /// # Errors
    /// A sentence if the format would round them.
    pub fn of(self, format: ExportFormat, info: &SceneInfo) -> Result<Coordinates, String> {
        let farthest = info.offset.iter().fold(0.0, |far: f64, x| far.max(x.abs())) as f32;
        let wide = matches!(format, ExportFormat::Ply | ExportFormat::MeshPly);
        match self {
            Self::Scene | Self::Metres => Ok(Coordinates::Scene),
            Self::Dataset if wide && farthest > 0.0 => Ok(Coordinates::Dataset),
            Self::Dataset if farthest == 0.0 => Ok(Coordinates::Scene),
            Self::Dataset => Err(format!(
                "--coordinates dataset: this format would round positions {farthest} world units from the origin to steps of {}: \
                 write ply or mesh-ply, or the coordinates of the scene, whose offset is in the file",
                farthest.next_up() - farthest
            )),
        }
    }
}

impl Origin {
    /// What coordinates of a scene of `info` are multiplied by.
    ///
    /// # Errors
    /// A sentence if metres are asked for, and the scene has no scale or the format no place for it.
    pub fn factor(self, format: ExportFormat, info: &SceneInfo) -> Result<f64, String> {
        let is_gltf = matches!(format, ExportFormat::Glb | ExportFormat::MeshGlb);
        match (self, info.metres_per_unit) {
            (Self::Metres, _) if matches!(format, ExportFormat::Html | ExportFormat::Lod) => {
                Err("--coordinates metres: this format holds the scene itself, which says how many metres a unit has"
                    .to_owned())
            }
            (Self::Metres, None) => Err(
                "--coordinates metres: nobody has said how long a world unit is; `dpges scale` stores it in the scene"
                    .to_owned(),
            ),
            (Self::Metres, Some(metres)) => Ok(metres),
            (Self::Scene | Self::Dataset, metres) => Ok(metres.filter(|_| is_gltf).unwrap_or(1.0)),
        }
    }
}

impl Filter {
    pub const fn filter(self) -> ScreenFilter {
        match self {
            Self::Mip => ScreenFilter::Compensated,
            Self::Classic => ScreenFilter::Plain,
        }
    }
}

/// Which programs show splats of `filter` as they are.
pub const fn filter_text(filter: ScreenFilter) -> &'static str {
    match filter {
        ScreenFilter::Plain => "classic: 0.3 px², not compensated",
        ScreenFilter::Compensated => "mip: 0.1 px², compensated",
        ScreenFilter::Off => "none",
    }
}

/// Where a file has its scene: PLY files are not turned.
pub fn place_rows(info: &SceneInfo, coordinates: Coordinates, is_ply: bool) -> Vec<(&'static str, String)> {
    let (up, [x, y, z]) = (Up::of(info), info.offset);
    let mut rows = vec![("up", format!("{up}, {}", if is_ply { "as in the scene" } else { "turned to y" }))];
    let metres = |metres| if metres == 1.0 { "metres".to_owned() } else { format!("{} metres", four_digits(metres)) };
    rows.push(("unit", info.metres_per_unit.map_or_else(|| "unknown: `dpges scale` sets it".to_owned(), metres)));
    if coordinates == Coordinates::Scene && info.offset != [0.0; 3] {
        let turned = if is_ply { "" } else { ", before they were turned" };
        rows.push(("offset", format!("{x} {y} {z}: add it to positions to get those of the dataset{turned}")));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endings_and_coordinates_that_do_not_fit_the_format_are_refused() {
        let refused = |format: ExportFormat, out: &str| format.check_ending(out.as_ref()).err();
        assert_eq!(refused(ExportFormat::Spz3, "file.SPZ"), None);
        assert_eq!(refused(ExportFormat::MeshPly, "file.tmp"), None);
        assert!(refused(ExportFormat::Ply, "x.spz").unwrap().contains("--format ply writes a .ply file"));
        assert!(refused(ExportFormat::Html, "x.glb").unwrap().contains("a folder"));
        let far = SceneInfo { offset: [448_251.0, 5_411_933.0, 213.0], ..SceneInfo::default() };
        assert_eq!(Origin::Dataset.of(ExportFormat::Ply, &far), Ok(Coordinates::Dataset));
        assert!(Origin::Dataset.of(ExportFormat::Spz, &far).unwrap_err().contains("steps of 0.5"));
        assert_eq!(Origin::Dataset.of(ExportFormat::Glb, &SceneInfo::default()), Ok(Coordinates::Scene));
        assert!(place_rows(&far, Coordinates::Scene, true)[2].1.contains("448251 5411933 213: add it"));
    }

    #[test]
    fn gltf_is_in_metres_where_the_scale_is_known_and_others_if_asked_to() {
        let unknown = SceneInfo::default();
        let known = SceneInfo { metres_per_unit: Some(0.25), ..unknown.clone() };
        let factor = |origin: Origin, format| origin.factor(format, &known);
        assert_eq!(
            (factor(Origin::Scene, ExportFormat::Glb), factor(Origin::Scene, ExportFormat::Ply)),
            (Ok(0.25), Ok(1.0))
        );
        assert_eq!(factor(Origin::Metres, ExportFormat::Spz), Ok(0.25));
        assert!(factor(Origin::Metres, ExportFormat::Lod).unwrap_err().contains("the scene itself"));
        assert_eq!(Origin::Scene.factor(ExportFormat::MeshGlb, &unknown), Ok(1.0));
        assert!(Origin::Metres.factor(ExportFormat::Ply, &unknown).unwrap_err().contains("dpges scale"));
        let unit = |info: &SceneInfo| place_rows(info, Coordinates::Scene, true)[1].1.clone();
        assert_eq!([unit(&known), unit(&known.scaled(0.25))], ["0.2500 metres", "metres"]);
    }
}
