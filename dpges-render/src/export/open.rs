//! Scenes in files of any kind that can be drawn: our own, and splats of other programs.

use std::path::Path;

use dpges_core::scene::{SceneData, SceneInfo};
use dpges_core::{Error, Result};

use super::harmonics::MAX_DEGREE;
use super::read_ply::read_ply;
use super::{sog, splat_glb, spz};
use crate::path::Extent;

/// Near plane of splats of which nothing is known, over the radius around most of them.
const NEAR: f64 = 0.01;

const SPLATS: &str = "of splats, PLY, SPZ, SOG and glTF are read: splat-transform makes them of others";

/// A scene from a file.
#[derive(Clone, Debug)]
pub struct Opened {
    pub scene: SceneData,
    /// Whether the file says all of its scene, as ours do. Of splats of other programs only the filter is known; where they
    /// are seen from, what is up, and how far they reach is guessed.
    pub own: bool,
    /// Sentences about what is left out of it, or read in another way than usual.
    pub remarks: Vec<String>,
}

/// Reads a scene file, or splats in PLY, SPZ, SOG (a `meta.json` too) or glTF.
///
/// # Errors
/// [`Error::Io`]; [`Error::SceneFile`] names the path and the reason.
pub fn open(path: &Path) -> Result<Opened> {
    let bytes =
        std::fs::read(path).map_err(|source| Error::Io { action: "cannot read", path: path.to_owned(), source })?;
    let folder = path.parent().unwrap_or(path);
    match read_splats(&bytes, folder) {
        Some(splats) => {
            let opened = splats.map_err(|reason| Error::SceneFile { path: path.to_owned(), reason })?;
            opened.scene.validate(path)?;
            Ok(opened)
        }
        None => {
            let scene = SceneData::from_bytes(&bytes, &path.to_string_lossy()).map_err(|error| match error {
                Error::SceneFile { path, reason } if path.extension().is_none_or(|ending| ending != "safetensors") => {
                    Error::SceneFile { path, reason: format!("{reason}; {SPLATS}") }
                }
                other => other,
            });
            Ok(Opened { scene: scene?, own: true, remarks: Vec::new() })
        }
    }
}

/// The scene of splats in the bytes of a file; `None` if they are no splats in PLY, SPZ, SOG or glTF. glTF and a `meta.json`
/// of SOG may name files in `folder`.
pub fn read_splats(bytes: &[u8], folder: &Path) -> Option<std::result::Result<Opened, String>> {
    let read = match bytes {
        [b'p', b'l', b'y', b'\n' | b'\r', ..] => read_ply(bytes),
        [0x1f, 0x8b, ..] | [b'N', b'G', b'S', b'P', ..] => spz::read(bytes),
        [b'P', b'K', 3, 4, ..] => sog::read(bytes),
        [b'{', ..] if sog::is_meta(bytes) => sog::read_unbundled(bytes, folder),
        [b'g', b'l', b'T', b'F', ..] | [b'{', ..] => splat_glb::read(bytes, folder),
        _ => return None,
    };
    Some(read.and_then(|(cloud, notes)| {
        if cloud.is_empty() {
            return Err("there are no splats in it".to_owned());
        }
        let mut scene = cloud.to_scene();
        if !notes.own {
            let radius = Extent::of(&scene).radius;
            scene.info = SceneInfo { extent: radius, near: NEAR * radius, ..scene.info };
        }
        let not_finite =
            (notes.not_finite > 0).then(|| format!("{} splats that are not finite are left out", notes.not_finite));
        let degree =
            notes.degree.map(|degree| format!("harmonics of degree {degree} are left out above degree {MAX_DEGREE}"));
        let read_as = notes.read_as.into_iter().map(str::to_owned);
        Ok(Opened { scene, own: notes.own, remarks: not_finite.into_iter().chain(degree).chain(read_as).collect() })
    }))
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::along_morton_curve;

    use super::super::cloud::tests::sample;
    use super::super::sog::to_sog;
    use super::super::spz::{SpzVersion, to_spz};
    use super::super::{Coordinates, to_glb, to_ply};
    use super::*;

    #[test]
    fn exports_come_back_as_the_scenes_they_were() {
        let mut cloud = sample(50, 2);
        cloud = cloud.select(&along_morton_curve(cloud.positions.as_flattened()));
        let folder = tempfile::tempdir().unwrap();
        for up in [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.6, 0.0, 0.8]] {
            cloud.info.up = Some(up);
            let expected = cloud.to_scene();
            for (name, bytes, tolerance) in [
                ("a.ply", to_ply(&cloud, Coordinates::Scene), 1e-6),
                ("a.glb", to_glb(&cloud).unwrap(), 1e-5),
                ("a.spz", to_spz(&cloud, SpzVersion::Four).unwrap(), 1e-5),
                ("b.spz", to_spz(&cloud, SpzVersion::Three).unwrap(), 1e-5),
                ("a.sog", to_sog(&cloud).unwrap(), 1e-4),
            ] {
                let file = folder.path().join(name);
                std::fs::write(&file, bytes).unwrap();
                let opened = open(&file).unwrap();
                assert!(opened.own && opened.scene.info == expected.info, "{name}: {:?}", opened.scene.info);
                let positions = opened.scene.gaussians.positions.iter().zip(&expected.gaussians.positions);
                assert!(positions.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) < tolerance, "{name}");
            }
        }
        let file = folder.path().join("c.ksplat");
        std::fs::write(&file, [0; 4096]).unwrap();
        let error = open(&file).unwrap_err().to_string();
        assert!(error.contains("c.ksplat") && error.contains("PLY, SPZ, SOG and glTF"), "{error}");
        let file = folder.path().join("c.ply");
        std::fs::write(&file, "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n").unwrap();
        let error = open(&file).unwrap_err().to_string();
        assert!(error.contains("c.ply") && error.contains("no splats"), "{error}");
    }
}
