//! Splats in OpenUSD, from version 26.03 on: a prim `ParticleField3DGaussianSplat` of the schema UsdVol.
//!
//! Numbers are text that says every bit of f32. Scales and opacities are as they are (neither logarithms nor logits), and
//! quaternions are (w, x, y, z), as in USD; the coefficients of a splat stand together, red, green and blue of each. y is
//! up: [`Up`] says how it comes about. World units stand for metres where no scale is known. All that a file says of its scene is in
//! `customLayerData`. USDZ is an archive of that one file.

use std::fmt::{Debug, Write};

use super::archive::stored;
use super::cloud::SplatCloud;
use super::error::ExportError;
use super::{APPROXIMATION, GENERATOR, all_of};
use crate::up::Up;

/// Standard deviations within which a splat is drawn.
const REACH: f32 = 3.0;
/// Archives of USD are below 4 GiB.
const MOST_BYTES: usize = u32::MAX as usize - (1 << 16);

/// The text of the file of `cloud`, turned upright.
pub fn to_usda(cloud: &SplatCloud) -> String {
    let cloud = cloud.rotated(Up::of(&cloud.info).to_gltf());
    let coefficients = cloud.harmonics.as_chunks::<3>().0;
    let (said, unit) = (all_of(&cloud.info), cloud.info.metres_per_unit.unwrap_or(1.0));
    let mut text = format!(
        "#usda 1.0\n(\n    customLayerData = {{\n        string dpges = '{said}'\n    }}\n    defaultPrim = \"Splats\"\n    \
         doc = \"Exported from {GENERATOR}. {APPROXIMATION}\"\n    metersPerUnit = {unit}\n    upAxis = \"Y\"\n)\n\n\
         def ParticleField3DGaussianSplat \"Splats\"\n{{\n"
    );
    array(&mut text, "float3[] extent", &extent(&cloud));
    array(&mut text, "point3f[] positions", &cloud.positions);
    array(&mut text, "quatf[] orientations", &cloud.quaternions);
    array(&mut text, "float3[] scales", &cloud.log_scales.iter().map(|s| s.map(f32::exp)).collect::<Vec<_>>());
    array(&mut text, "float[] opacities", &cloud.opacities);
    put(&mut text, format_args!("    uniform int radiance:sphericalHarmonicsDegree = {}\n", cloud.degree));
    array(&mut text, "float3[] radiance:sphericalHarmonicsCoefficients", coefficients);
    text.push_str("    uniform token sortingModeHint = \"zDepth\"\n}\n");
    text
}

/// The bytes of an archive with the text of the file of `cloud`.
///
/// # Errors
/// [`ExportError::TooMany`] if it would not be below 4 GiB.
pub fn to_usdz(cloud: &SplatCloud) -> Result<Vec<u8>, ExportError> {
    let text = to_usda(cloud);
    if text.len() > MOST_BYTES {
        let limit = (MOST_BYTES as f64 / text.len() as f64 * cloud.len() as f64) as usize;
        return Err(ExportError::TooMany { count: cloud.len(), limit });
    }
    Ok(stored([("splats.usda", text.as_bytes())]))
}

/// A box around all splats.
fn extent(cloud: &SplatCloud) -> [[f32; 3]; 2] {
    let mut corners = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    for (position, log_scales) in cloud.positions.iter().zip(&cloud.log_scales) {
        let reach = REACH * log_scales.iter().copied().fold(f32::NEG_INFINITY, f32::max).exp();
        for axis in 0..3 {
            corners[0][axis] = corners[0][axis].min(position[axis] - reach);
            corners[1][axis] = corners[1][axis].max(position[axis] + reach);
        }
    }
    corners
}

/// Numbers, or tuples of them. Rust writes arrays with brackets where USD has parentheses.
fn array<T: Debug>(text: &mut String, name: &str, values: &[T]) {
    put(text, format_args!("    {name} = ["));
    for (at, value) in values.iter().enumerate() {
        let before = text.len();
        put(text, format_args!("{}{value:?}", if at > 0 { ", " } else { "" }));
        if text.ends_with(']') {
            let tuple = text.split_off(before).replace('[', "(").replace(']', ")");
            text.push_str(&tuple);
        }
    }
    text.push_str("]\n");
}

fn put(text: &mut String, what: std::fmt::Arguments) {
    text.write_fmt(what).expect("memory takes all that is written");
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::SceneInfo;

    use super::super::archive::Archive;
    use super::super::cloud::tests::sample;
    use super::*;

    /// The numbers of an attribute.
    fn numbers(text: &str, name: &str) -> Vec<f32> {
        let line = text.lines().find_map(|line| line.trim().strip_prefix(name)?.strip_prefix(" = ["));
        let line = line.unwrap_or_else(|| panic!("{name} in {text}")).replace(['(', ')', ']'], "");
        line.split(", ").map(|number| number.parse().unwrap()).collect()
    }

    #[test]
    fn a_splat_is_written_as_usd_has_it() {
        let splat = SplatCloud {
            positions: vec![[1.0, 2.0, 3e-9]],
            quaternions: vec![[0.5, -0.5, 0.5, 0.5]],
            log_scales: vec![[0.0, 0.0, 0.0]],
            opacities: vec![0.25],
            degree: 0,
            harmonics: vec![0.1, -0.2, 0.3],
            info: SceneInfo { up: Some([0.0, 1.0, 0.0]), ..SceneInfo::default() },
        };
        let text = to_usda(&splat);
        let prim = text.split_once("\n\n").unwrap().1;
        let expected = r#"def ParticleField3DGaussianSplat "Splats"
{
    float3[] extent = [(-2.0, -1.0, -3.0), (4.0, 5.0, 3.0)]
    point3f[] positions = [(1.0, 2.0, 3e-9)]
    quatf[] orientations = [(0.5, -0.5, 0.5, 0.5)]
    float3[] scales = [(1.0, 1.0, 1.0)]
    float[] opacities = [0.25]
    uniform int radiance:sphericalHarmonicsDegree = 0
    float3[] radiance:sphericalHarmonicsCoefficients = [(0.1, -0.2, 0.3)]
    uniform token sortingModeHint = "zDepth"
}
"#;
        assert_eq!(prim, expected);
        assert!(
            text.starts_with("#usda 1.0\n(\n") && text.contains("upAxis = \"Y\"") && text.contains("Approximation")
        );
    }

    #[test]
    fn every_number_is_there_in_full_and_the_scene_upright() {
        let mut cloud = sample(7, 3);
        cloud.info.up = Some([0.0, 0.0, 1.0]);
        let bytes = to_usdz(&cloud).unwrap();
        let text = Archive::new(&bytes).unwrap().file("splats.usda").unwrap();
        let text = std::str::from_utf8(&text).unwrap();
        let upright = cloud.rotated(Up::Z.to_gltf());
        let [x, y, z] = cloud.positions[3];
        assert_eq!(upright.positions[3], [x, z, -y]);
        assert_eq!(numbers(text, "point3f[] positions"), upright.positions.as_flattened());
        assert_eq!(numbers(text, "quatf[] orientations"), upright.quaternions.as_flattened());
        assert_eq!(numbers(text, "float[] opacities"), upright.opacities);
        assert_eq!(numbers(text, "float3[] radiance:sphericalHarmonicsCoefficients"), upright.harmonics);
        let said = text.split('\'').nth(1).unwrap();
        assert_eq!(serde_json::from_str::<SceneInfo>(said).unwrap(), cloud.info);
    }
}
