//! Kinds of exports, and what is asked of them.

use std::path::Path;

use clap::ValueEnum;
use dpges_core::scene::length::four_digits;
use dpges_core::scene::{Rendering, SceneData, SceneInfo, ScreenFilter};
use dpges_render::Up;
use dpges_render::export::spz::SpzVersion;
use dpges_render::export::{Coordinates, SplatCloud};

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
    /// Splats, quantised in pictures: SOG version 2, one file
    Sog,
    /// A folder for any web server: splats in levels of detail, Streamed SOG
    SogLod,
    /// Splats in binary glTF with KHR_gaussian_splatting
    Glb,
    /// Splats in OpenUSD, text
    Usda,
    /// Splats in OpenUSD, an archive
    Usdz,
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
const ENDINGS: [&str; 14] = [
    "ply",
    "spz",
    "glb",
    "gltf",
    "sog",
    "splat",
    "ksplat",
    "usd",
    "usda",
    "usdc",
    "usdz",
    "obj",
    "safetensors",
    "html",
];

/// Checks that the ending of `out` does not say that it is anything but a scene file.
///
/// # Errors
/// A sentence that names the file.
pub fn check_scene_file(out: &Path) -> Result<(), String> {
    let ending = out.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    if ENDINGS.contains(&&*ending) && ending != "safetensors" {
        let out = out.display();
        return Err(format!("--out {out} says .{ending}: a scene file is written; `dpges export` writes splats"));
    }
    Ok(())
}

impl ExportFormat {
    /// `None` if it is not one of splats.
    pub fn of_splats(self) -> Option<SplatFormat> {
        match self {
            Self::Ply => Some(SplatFormat::Ply),
            Self::Spz => Some(SplatFormat::Spz(SpzVersion::Four)),
            Self::Spz3 => Some(SplatFormat::Spz(SpzVersion::Three)),
            Self::Sog | Self::SogLod => Some(SplatFormat::Sog),
            Self::Glb => Some(SplatFormat::Glb),
            Self::Usda => Some(SplatFormat::Usda),
            Self::Usdz => Some(SplatFormat::Usdz),
            Self::MeshPly | Self::MeshGlb | Self::Html | Self::Lod => None,
        }
    }

    /// The ending of its files; empty for folders.
    const fn ending(self) -> &'static str {
        match self {
            Self::Ply | Self::MeshPly => "ply",
            Self::Spz | Self::Spz3 => "spz",
            Self::Sog => "sog",
            Self::Glb | Self::MeshGlb => "glb",
            Self::Usda => "usda",
            Self::Usdz => "usdz",
            Self::SogLod | Self::Html | Self::Lod => "",
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
            Self::Scene => Ok(Coordinates::Scene),
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

impl Filter {
    pub const fn filter(self) -> ScreenFilter {
        match self {
            Self::Mip => ScreenFilter::Compensated,
            Self::Classic => ScreenFilter::Plain,
        }
    }
}

/// Which programs show splats of `filter` as they are.
const fn filter_text(filter: ScreenFilter) -> &'static str {
    match filter {
        ScreenFilter::Plain => "classic: 0.3 px², not compensated",
        ScreenFilter::Compensated => "mip: 0.1 px², compensated",
        ScreenFilter::Off => "none",
    }
}

/// The part of their scene that splats show, and the programs that show it so.
pub fn splat_rows(
    scene: &SceneData,
    cloud: &SplatCloud,
    filter: ScreenFilter,
    coordinates: Coordinates,
    format: ExportFormat,
) -> Vec<(&'static str, String)> {
    let counts = format!("{} surfels and {} Gaussians", scene.surfels.len(), scene.gaussians.len());
    let mut rows = vec![("splats", format!("{} of {counts}", cloud.len()))];
    rows.extend(place_rows(&scene.info, coordinates, format));
    rows.push(("filter", filter_text(filter).to_owned()));
    if scene.info.rendering == Rendering::Peeled {
        let text = "approximation: sorted splats cannot express peeled surfels and order-free Gaussians";
        rows.push(("note", text.to_owned()));
    }
    if scene.environment.is_some() {
        rows.push(("sky", "missing: the format has no environment".to_owned()));
    }
    rows
}

/// Where a file has its scene, and its unit: PLY files are not turned, and those of glTF are in metres if it is known how long a
/// world unit is.
pub fn place_rows(info: &SceneInfo, coordinates: Coordinates, format: ExportFormat) -> Vec<(&'static str, String)> {
    let keeps_axes =
        matches!(format, ExportFormat::Ply | ExportFormat::MeshPly | ExportFormat::Sog | ExportFormat::SogLod);
    let in_metres = matches!(format, ExportFormat::Glb | ExportFormat::MeshGlb) && info.metres_per_unit.is_some();
    let (unit, factor) = match info.metres_per_unit {
        None => ("unknown: `dpges scale` sets it".to_owned(), 1.0),
        Some(metres) if in_metres => ("metres".to_owned(), metres),
        Some(metres) => (format!("{} metres", four_digits(metres)), 1.0),
    };
    let (up, [x, y, z]) = (Up::of(info), info.scaled(factor).offset);
    let mut rows =
        vec![("up", format!("{up}, {}", if keeps_axes { "as in the scene" } else { "turned to y" })), ("unit", unit)];
    if coordinates == Coordinates::Scene && info.offset != [0.0; 3] {
        let turned = if keeps_axes { "" } else { ", before they were turned" };
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
        assert!(refused(ExportFormat::Usdz, "x.usdc").unwrap().contains("--format usdz writes a .usdz file"));
        let far = SceneInfo { offset: [448_251.0, 5_411_933.0, 213.0], ..SceneInfo::default() };
        assert_eq!(Origin::Dataset.of(ExportFormat::Ply, &far), Ok(Coordinates::Dataset));
        assert!(Origin::Dataset.of(ExportFormat::Usda, &far).is_err());
        assert!(Origin::Dataset.of(ExportFormat::Spz, &far).unwrap_err().contains("steps of 0.5"));
        assert_eq!(Origin::Dataset.of(ExportFormat::Glb, &SceneInfo::default()), Ok(Coordinates::Scene));
        assert!(place_rows(&far, Coordinates::Scene, ExportFormat::Ply)[2].1.contains("448251 5411933 213: add it"));
    }

    #[test]
    fn units_are_those_of_the_file() {
        let known = SceneInfo { metres_per_unit: Some(0.25), offset: [8.0; 3], ..SceneInfo::default() };
        let rows = |format| place_rows(&known, Coordinates::Scene, format);
        assert_eq!((&*rows(ExportFormat::Ply)[1].1, &*rows(ExportFormat::MeshGlb)[1].1), ("0.2500 metres", "metres"));
        assert!(
            rows(ExportFormat::Spz)[2].1.starts_with("8 8 8:") && rows(ExportFormat::Glb)[2].1.starts_with("2 2 2:")
        );
        assert!(place_rows(&SceneInfo::default(), Coordinates::Scene, ExportFormat::Glb)[1].1.contains("dpges scale"));
    }
}
