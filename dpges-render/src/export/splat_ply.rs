//! Splats in a PLY file, in the convention of 3DGS.
//!
//! Binary, little endian, one element `vertex` of floats: `x y z`, `nx ny nz` (zeros), `f_dc_0..2`, `f_rest_*` (all
//! coefficients of red, then of green, then of blue), `opacity` as a logit, `scale_0..2` as natural logarithms,
//! `rot_0..3` as (w, x, y, z). Positions are in the axes of the dataset, and in the coordinates of the scene: a comment
//! names the offset to those of the dataset, which f32 might not hold.

use super::axes::UpAxis;
use super::cloud::SplatCloud;
use super::{APPROXIMATION, ply_head};

/// The bytes of the file. `up` is only noted in a comment.
pub fn to_ply(cloud: &SplatCloud, up: UpAxis) -> Vec<u8> {
    let names = property_names(cloud.degree);
    let mut bytes = header(cloud, up, &names).into_bytes();
    bytes.reserve_exact(4 * names.len() * cloud.len());
    for row in 0..cloud.len() {
        let harmonics = cloud.harmonics_of(row);
        let opacity = cloud.opacities[row];
        let mut write = |values: &[f32]| values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        write(&cloud.positions[row]);
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

fn header(cloud: &SplatCloud, up: UpAxis, names: &[String]) -> String {
    // the splats are made for a low-pass filter that dims what it widens (Mip-Splatting)
    let mut text = ply_head(&[APPROXIMATION, "SplatRenderMode: mip"], up, cloud.info.offset);
    text.push_str(&format!("element vertex {}\n", cloud.len()));
    text.extend(names.iter().map(|name| format!("property float {name}\n")));
    text.push_str("end_header\n");
    text
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use serde::Deserialize;

    use super::super::cloud::tests::sample;
    use super::*;

    #[derive(Deserialize)]
    struct File {
        vertex: Vec<HashMap<String, f32>>,
    }

    #[test]
    fn a_general_reader_finds_every_number_by_its_name() {
        for degree in 0..=3 {
            let cloud = sample(5, degree);
            let bytes = to_ply(&cloud, UpAxis::Z);
            let file: File = serde_ply::from_bytes(&bytes).unwrap();
            assert_eq!(file.vertex.len(), 5);
            let count = super::super::coefficient_count(degree) - 1;
            for (row, vertex) in file.vertex.iter().enumerate() {
                assert_eq!(vertex.len(), 17 + 3 * count);
                let three = |name: &str| std::array::from_fn(|i| vertex[&format!("{name}_{i}")]);
                assert_eq!([vertex["x"], vertex["y"], vertex["z"]], cloud.positions[row]);
                assert_eq!(three("scale"), cloud.log_scales[row]);
                assert_eq!(three("f_dc"), cloud.harmonics_of(row)[0]);
                assert_eq!(std::array::from_fn(|i| vertex[&format!("rot_{i}")]), cloud.quaternions[row]);
                let opacity = 1.0 / (1.0 + (-vertex["opacity"]).exp());
                assert!((opacity - cloud.opacities[row]).abs() < 1e-6);
                for (index, coefficient) in cloud.harmonics_of(row)[1..].iter().enumerate() {
                    let found = std::array::from_fn(|channel| vertex[&format!("f_rest_{}", index + channel * count)]);
                    assert_eq!(found, *coefficient);
                }
            }
        }
    }

    #[test]
    fn the_header_says_what_the_file_is() {
        let bytes = to_ply(&sample(1, 0), UpAxis::MinusY);
        let end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap();
        let text = std::str::from_utf8(&bytes[..end]).unwrap();
        for expected in [
            "ply\nformat binary_little_endian 1.0\ncomment Exported from dpges ",
            "comment Approximation: sorted splats",
            "comment Vertical axis: -y\n",
            "comment Offset: 100 -20.5 3 (",
            "element vertex 1\nproperty float x\n",
        ] {
            assert!(text.contains(expected), "{expected:?} in {text}");
        }
        assert_eq!(bytes.len(), end + 11 + 4 * 17);
    }
}
