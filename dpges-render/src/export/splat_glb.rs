//! Splats in a binary glTF file, by the extension `KHR_gaussian_splatting`.
//!
//! One primitive of points, with float attributes: positions, rotations (x, y, z, w), scales and opacities as they are
//! (neither logarithms nor logits), and all coefficients of the harmonics. `COLOR_0` is there for programs that do not
//! know the extension and draw points. y is up: [`UpAxis`] says how it comes about. `asset.extras` has the note that it is
//! an approximation, and the offset of the scene, in the axes of the dataset.

use dpges_core::scene::SH_C0;
use serde_json::{Map, json};

use super::APPROXIMATION;
use super::axes::UpAxis;
use super::cloud::SplatCloud;
use super::error::ExportError;
use super::glb::GlbBuilder;

const EXTENSION: &str = "KHR_gaussian_splatting";
/// Mode of primitives.
const POINTS: u32 = 0;

/// The bytes of the file of `cloud`, which stands in axes with `up` upwards.
///
/// # Errors
/// [`ExportError::TooMany`] if the file would exceed the 4 GiB that its header can say.
pub fn to_glb(cloud: &SplatCloud, up: UpAxis) -> Result<Vec<u8>, ExportError> {
    let bytes_per_splat = 4 * (3 + 1 + 4 + 3 + 1 + cloud.harmonics_len());
    let limit = (u32::MAX as usize - (1 << 20)) / bytes_per_splat;
    if cloud.len() > limit {
        return Err(ExportError::TooMany { count: cloud.len(), limit });
    }
    let cloud = cloud.rotated(up.to_gltf());
    let rows = || (0..cloud.len()).map(|row| cloud.harmonics_of(row));
    let byte = |value: f64| (255.0 * value).round().clamp(0.0, 255.0) as u8;
    let fallback = rows().zip(&cloud.opacities).map(|(k, &opacity)| {
        let [red, green, blue] = k[0].map(|k0| byte(0.5 + SH_C0 * f64::from(k0)));
        [red, green, blue, byte(f64::from(opacity))]
    });
    let xyzw = cloud.quaternions.iter().map(|&[w, x, y, z]| [x, y, z, w]);
    let (mut glb, mut attributes) = (GlbBuilder::default(), Map::new());
    let mut name = |name: String, accessor: usize| attributes.insert(name, accessor.into());
    name("POSITION".to_owned(), glb.positions(&cloud.positions));
    name("COLOR_0".to_owned(), glb.colours(fallback));
    name(format!("{EXTENSION}:ROTATION"), glb.floats(xyzw));
    name(format!("{EXTENSION}:SCALE"), glb.floats(cloud.log_scales.iter().map(|scales| scales.map(f32::exp))));
    name(format!("{EXTENSION}:OPACITY"), glb.floats(cloud.opacities.iter().map(|&opacity| [opacity])));
    for degree in 0..=cloud.degree {
        for order in 0..2 * degree + 1 {
            let values = rows().map(|k| k[degree * degree + order]);
            name(format!("{EXTENSION}:SH_DEGREE_{degree}_COEF_{order}"), glb.floats(values));
        }
    }
    let kernel = json!({
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    });
    let primitive = json!({ "mode": POINTS, "attributes": attributes, "extensions": { EXTENSION: kernel } });
    Ok(glb.finish(primitive, &[EXTENSION], APPROXIMATION, cloud.info.offset))
}

#[cfg(test)]
mod tests {
    use super::super::cloud::tests::sample;
    use super::super::glb::{floats, parts};
    use super::*;

    #[test]
    fn every_number_is_under_the_name_of_the_extension() {
        let cloud = sample(5, 2);
        let bytes = to_glb(&cloud, UpAxis::Y).unwrap();
        let (document, binary) = parts(&bytes);
        assert_eq!(document["extensionsUsed"], json!([EXTENSION]));
        assert_eq!(document["asset"]["version"], "2.0");
        assert_eq!(document["asset"]["extras"]["offset"], json!([100.0, -20.5, 3.0]));
        let primitive = &document["meshes"][0]["primitives"][0];
        assert_eq!((&primitive["mode"], &primitive["extensions"][EXTENSION]["kernel"]), (&json!(0), &json!("ellipse")));
        let attributes = primitive["attributes"].as_object().unwrap();
        assert_eq!(attributes.len(), 5 + 9);
        let values = |name: &str| floats(&document, binary, &attributes[&format!("{EXTENSION}:{name}")]);
        assert_eq!(floats(&document, binary, &attributes["POSITION"]), cloud.positions.as_flattened());
        assert_eq!(values("OPACITY"), cloud.opacities);
        assert_eq!(values("SCALE")[5], cloud.log_scales[1][2].exp());
        assert_eq!(values("ROTATION")[4..8], [1, 2, 3, 0].map(|i: usize| cloud.quaternions[1][i]));
        assert_eq!(values("SH_DEGREE_2_COEF_4")[3..6], cloud.harmonics_of(1)[8]);
        assert_eq!(values("SH_DEGREE_0_COEF_0")[..3], cloud.harmonics_of(0)[0]);
        let position = &document["accessors"][attributes["POSITION"].as_u64().unwrap() as usize];
        let smallest = cloud.positions.iter().map(|p| p[0]).fold(f32::INFINITY, f32::min);
        assert_eq!(position["min"][0].as_f64().unwrap() as f32, smallest);
    }

    #[test]
    fn the_scene_stands_upright() {
        let cloud = sample(3, 1);
        let bytes = to_glb(&cloud, UpAxis::Z).unwrap();
        let (document, binary) = parts(&bytes);
        let at = &document["meshes"][0]["primitives"][0]["attributes"]["POSITION"];
        let [x, y, z] = cloud.positions[2];
        assert_eq!(floats(&document, binary, at)[6..], [x, z, -y]);
    }
}
