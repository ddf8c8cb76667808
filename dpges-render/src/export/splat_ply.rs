//! Splats in a PLY file, in the convention of 3DGS.
//!
//! Binary, little endian, one element `vertex` of floats: `x y z`, `nx ny nz` (zeros), `f_dc_0..2`, `f_rest_*` (all
//! coefficients of red, then of green, then of blue), `opacity` as a logit, `scale_0..2` as natural logarithms,
//! `rot_0..3` as (w, x, y, z). Positions are in the axes of the dataset. In coordinates of the scene a comment names the
//! offset to those of the dataset, which f32 might not hold; in those of the dataset `x y z` are doubles.

use dpges_core::scene::ScreenFilter;

use super::cloud::SplatCloud;
use super::{APPROXIMATION, Coordinates, SAYS_ALL, all_of, ply_head};

/// The bytes of the file. A comment notes the up axis.
pub fn to_ply(cloud: &SplatCloud, coordinates: Coordinates) -> Vec<u8> {
    let names = property_names(cloud.degree);
    let mut bytes = header(cloud, coordinates, &names).into_bytes();
    bytes.reserve((4 * names.len() + 12) * cloud.len());
    for row in 0..cloud.len() {
        let harmonics = cloud.harmonics_of(row);
        let opacity = cloud.opacities[row];
        bytes.extend(coordinates.ply_position(cloud.positions[row], &cloud.info));
        let mut write = |values: &[f32]| values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        write(&[0.0; 3]);
        write(&harmonics[0]);
        for channel in 0..3 {
            harmonics[1..].iter().for_each(|coefficient| write(&[coefficient[channel]]));
        }
        write(&[(opacity / (1.0 - opacity)).ln()]);
        write(&cloud.log_scales[row]);
        write(&cloud.quaternions[row]);
    }
    bytes
}

fn property_names(degree: usize) -> Vec<String> {
    let rest = 3 * (super::coefficient_count(degree) - 1);
    let numbered = |name: &str, count: usize| (0..count).map(|i| format!("{name}_{i}")).collect::<Vec<_>>();
    let mut names: Vec<String> = ["x", "y", "z", "nx", "ny", "nz"].map(str::to_owned).into();
    names.extend(numbered("f_dc", 3));
    names.extend(numbered("f_rest", rest));
    names.push("opacity".to_owned());
    names.extend(numbered("scale", 3));
    names.extend(numbered("rot", 4));
    names
}

fn header(cloud: &SplatCloud, coordinates: Coordinates, names: &[String]) -> String {
    let info = coordinates.info(&cloud.info);
    // whether they are made for a low-pass filter that dims what it widens (Mip-Splatting)
    let mode = if info.screen_filter == ScreenFilter::Compensated { "mip" } else { "default" };
    let [mode, all] = [format!("SplatRenderMode: {mode}"), format!("{SAYS_ALL}{}", all_of(&info))];
    let mut text = ply_head(&[APPROXIMATION, &mode, &all], &info);
    text.push_str(&format!("element vertex {}\n", cloud.len()));
    let kind = |name: &str| if ["x", "y", "z"].contains(&name) { coordinates.ply_type() } else { "float" };
    text.extend(names.iter().map(|name| format!("property {} {name}\n", kind(name))));
    text.push_str("end_header\n");
    text
}

#[cfg(test)]
mod tests {
    use super::super::cloud::tests::sample;
    use super::*;

    #[test]
    fn the_header_says_what_the_file_is() {
        let bytes = to_ply(&sample(1, 0), Coordinates::Scene);
        let end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap();
        let text = std::str::from_utf8(&bytes[..end]).unwrap();
        for expected in [
            "ply\nformat binary_little_endian 1.0\ncomment Exported from dpges ",
            "comment Approximation: sorted splats",
            "comment SplatRenderMode: mip\n",
            "comment Vertical axis: y\n",
            "comment Offset: 100 -20.5 3 (",
            "element vertex 1\nproperty float x\n",
        ] {
            assert!(text.contains(expected), "{expected:?} in {text}");
        }
        assert_eq!(bytes.len(), end + 11 + 4 * 17);
    }
}
