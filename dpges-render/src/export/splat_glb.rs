//! Splats in a binary glTF file, by the extension `KHR_gaussian_splatting`.
//!
//! One primitive of points, with float attributes: positions, rotations (x, y, z, w), scales and opacities as they are
//! (neither logarithms nor logits), and all coefficients of the harmonics. `COLOR_0` is there for programs that do not
//! know the extension and draw points. y is up: [`Up`] says how it comes about. `asset.extras` has the note that it is an
//! approximation, and all of the scene's info, in the axes of the dataset.

use std::path::Path;

use dpges_core::scene::{Rendering, SH_C0, SceneInfo, ScreenFilter};
use glam::{DMat3, DMat4, DQuat, DVec3};
use serde_json::{Map, Value, json};

use super::APPROXIMATION;
use super::cloud::SplatCloud;
use super::error::ExportError;
use super::glb::{GlbBuilder, Gltf, INFO};
use super::harmonics::MAX_DEGREE;
use super::notes::Notes;
use crate::up::Up;

const EXTENSION: &str = "KHR_gaussian_splatting";
/// Mode of primitives.
const POINTS: u32 = 0;
/// 1, and what rounding may add to it.
const LARGEST_OPACITY: f32 = 1.001;
/// Values of `colorSpace`.
const DISPLAY: &str = "srgb_rec709_display";
const LINEAR: &str = "lin_rec709_display";

/// The bytes of the file of `cloud`, turned upright, and in metres, the unit of glTF, where it is known how long a world unit is.
///
/// # Errors
/// [`ExportError::TooMany`] if the file would exceed the 4 GiB that its header can say.
pub fn to_glb(cloud: &SplatCloud) -> Result<Vec<u8>, ExportError> {
    let bytes_per_splat = 4 * (3 + 1 + 4 + 3 + 1 + cloud.harmonics_len());
    let limit = (u32::MAX as usize - (1 << 20)) / bytes_per_splat;
    if cloud.len() > limit {
        return Err(ExportError::TooMany { count: cloud.len(), limit });
    }
    let info = &cloud.info;
    let cloud = cloud.rotated(Up::of(info).to_gltf()).scaled(info.metres_per_unit.unwrap_or(1.0));
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
        "colorSpace": DISPLAY,
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    });
    let primitive = json!({ "mode": POINTS, "attributes": attributes, "extensions": { EXTENSION: kernel } });
    Ok(glb.finish(primitive, Some(EXTENSION), APPROXIMATION, info))
}

/// The splats of a file, with all of its nodes where they stand; in axes with −y upwards if it does not say what is up in its
/// scene.
pub(super) fn read(bytes: &[u8], folder: &Path) -> Result<(SplatCloud, Notes), String> {
    let gltf = Gltf::read(bytes, folder)?;
    let said: Option<SceneInfo> = serde_json::from_value(gltf.document["asset"]["extras"][INFO].clone()).ok();
    let mut notes = Notes { own: said.is_some(), ..Notes::default() };
    let foreign =
        || SceneInfo { screen_filter: ScreenFilter::Plain, rendering: Rendering::Ellipsoids, ..SceneInfo::default() };
    let mut all = SplatCloud { info: said.unwrap_or_else(foreign), ..SplatCloud::default() };
    let scene = &gltf.document["scenes"][gltf.document["scene"].as_u64().unwrap_or(0) as usize];
    for root in scene["nodes"].as_array().into_iter().flatten() {
        add_node(&gltf, root, DMat4::IDENTITY, 0, &mut all, &mut notes)?;
    }
    if all.is_empty() {
        return Err(format!("no node of its scene has splats ({EXTENSION})"));
    }
    let info = all.info.clone();
    let in_world_units =
        all.rotated(Up::of(&info).to_gltf().transpose()).scaled(1.0 / info.metres_per_unit.unwrap_or(1.0));
    Ok((SplatCloud { info, ..in_world_units }, notes))
}

/// Deepest tree of nodes.
const DEEPEST: usize = 64;

fn add_node(
    gltf: &Gltf,
    index: &Value,
    above: DMat4,
    depth: usize,
    all: &mut SplatCloud,
    notes: &mut Notes,
) -> Result<(), String> {
    let node = &gltf.document["nodes"][index.as_u64().unwrap_or(u64::MAX) as usize];
    if depth > DEEPEST {
        return Err(format!("its nodes lie more than {DEEPEST} deep"));
    }
    let list =
        |name: &str| -> Vec<f64> { node[name].as_array().into_iter().flatten().filter_map(Value::as_f64).collect() };
    let three = |name: &str, otherwise: DVec3| <[f64; 3]>::try_from(list(name)).map_or(otherwise, DVec3::from);
    let here = match <[f64; 16]>::try_from(list("matrix")) {
        Ok(matrix) => DMat4::from_cols_array(&matrix),
        Err(_) => {
            let rotation = <[f64; 4]>::try_from(list("rotation")).map_or(DQuat::IDENTITY, DQuat::from_array);
            let (scale, translation) = (three("scale", DVec3::ONE), three("translation", DVec3::ZERO));
            DMat4::from_scale_rotation_translation(scale, rotation, translation)
        }
    };
    let here = above * here;
    let mesh = node.get("mesh").map(|mesh| &gltf.document["meshes"][mesh.as_u64().unwrap_or(u64::MAX) as usize]);
    for primitive in mesh.and_then(|mesh| mesh["primitives"].as_array()).into_iter().flatten() {
        let splats = &primitive["extensions"][EXTENSION];
        if let Some((packed, _)) = splats["extensions"].as_object().and_then(|inner| inner.iter().next()) {
            return Err(format!("its splats are packed by {packed}, which cannot be read"));
        }
        if splats.is_object() {
            let mut cloud = primitive_splats(gltf, &primitive["attributes"], notes)?;
            match &splats["colorSpace"] {
                Value::Null => {}
                Value::String(space) if space == DISPLAY => {}
                Value::String(space) if space == LINEAR => {
                    to_display(&mut cloud);
                    notes.read_as.insert(
                        "its colours are linear (lin_rec709_display): they are converted, but splats in front of \
                         one another are mixed as display-referred colours, which looks a little different",
                    );
                }
                other => {
                    return Err(format!("its splats have colorSpace {other}, expected \"{DISPLAY}\" or \"{LINEAR}\""));
                }
            }
            add(all, moved(cloud, here)?)?;
        }
    }
    let mut children = node["children"].as_array().into_iter().flatten();
    children.try_for_each(|child| add_node(gltf, child, here, depth + 1, all, notes))
}

/// Encodes linear colours: the base exactly, what depends on the direction by the slope there.
fn to_display(cloud: &mut SplatCloud) {
    let len = cloud.harmonics_len();
    for k in cloud.harmonics.chunks_exact_mut(len) {
        for channel in 0..3 {
            let linear = 0.5 + SH_C0 * f64::from(k[channel]);
            let (display, slope) = if linear <= 0.003_130_8 {
                (12.92 * linear, 12.92)
            } else {
                let power = linear.powf(1.0 / 2.4);
                (1.055 * power - 0.055, 1.055 / 2.4 * power / linear)
            };
            k[channel] = ((display - 0.5) / SH_C0) as f32;
            k.iter_mut().skip(3 + channel).step_by(3).for_each(|k| *k *= slope as f32);
        }
    }
}

fn primitive_splats(gltf: &Gltf, attributes: &Value, notes: &mut Notes) -> Result<SplatCloud, String> {
    let index = |name: &str| attributes.get(name).ok_or_else(|| format!("its splats have no attribute `{name}`"));
    let own = |name: &str| index(&format!("{EXTENSION}:{name}")).cloned();
    let names: Vec<Vec<String>> = (0..=MAX_DEGREE)
        .map(|degree| (0..2 * degree + 1).map(|order| format!("SH_DEGREE_{degree}_COEF_{order}")).collect())
        .collect();
    let degree = (1..=MAX_DEGREE).take_while(|&degree| own(&names[degree][0]).is_ok()).last().unwrap_or(0);
    let coefficients = names[..=degree].iter().flatten().map(|name| gltf.numbers::<3>(&own(name)?));
    let coefficients = coefficients.collect::<Result<Vec<_>, String>>()?;
    let (positions, opacities) = (gltf.numbers::<3>(index("POSITION")?)?, gltf.numbers::<1>(&own("OPACITY")?)?);
    let (rotations, scales) = (gltf.numbers::<4>(&own("ROTATION")?)?, gltf.numbers::<3>(&own("SCALE")?)?);
    if let Some([opacity]) = opacities.iter().find(|[opacity]| !(0.0..=LARGEST_OPACITY).contains(opacity)) {
        return Err(format!(
            "OPACITY of a splat is {opacity}, expected 0 to 1 (logits, or integers that are not `normalized`?)"
        ));
    }
    let count = positions.len();
    let counts = [opacities.len(), rotations.len(), scales.len()].into_iter().chain(coefficients.iter().map(Vec::len));
    if let Some(other) = counts.into_iter().find(|&other| other != count) {
        return Err(format!("it has {count} positions and {other} values of another attribute"));
    }
    let log_scales = if scales.as_flattened().iter().any(|&scale| scale < 0.0) {
        notes.read_as.insert("scales are negative: they are read as logarithms, as drafts of the extension had them");
        scales
    } else {
        scales.into_iter().map(|scales| scales.map(|scale| scale.max(f32::MIN_POSITIVE).ln())).collect()
    };
    Ok(SplatCloud {
        positions,
        quaternions: rotations.into_iter().map(|[x, y, z, w]| [w, x, y, z]).collect(),
        log_scales,
        opacities: opacities.into_iter().map(|[opacity]| opacity).collect(),
        degree,
        harmonics: (0..count).flat_map(|row| coefficients.iter().flat_map(move |k| k[row])).collect(),
        info: SceneInfo::default(),
    })
}

/// `cloud` where a node of `matrix` stands.
fn moved(cloud: SplatCloud, matrix: DMat4) -> Result<SplatCloud, String> {
    let (scale, rotation, translation) = matrix.to_scale_rotation_translation();
    let even = (scale - scale.x).abs().max_element() < 1e-4 * scale.x.abs();
    if !(even && scale.x > 0.0 && translation.is_finite()) {
        return Err(format!("a node is scaled by {scale}: splats can only be scaled evenly"));
    }
    let mut cloud = cloud.rotated(DMat3::from_quat(rotation));
    for position in &mut cloud.positions {
        *position = (scale.x * glam::Vec3::from(*position).as_dvec3() + translation).as_vec3().to_array();
    }
    cloud.log_scales.iter_mut().flatten().for_each(|log_scale| *log_scale += scale.x.ln() as f32);
    Ok(cloud)
}

fn add(all: &mut SplatCloud, more: SplatCloud) -> Result<(), String> {
    if !all.is_empty() && all.degree != more.degree {
        return Err(format!("its splats have harmonics of degrees {} and {}", all.degree, more.degree));
    }
    all.degree = more.degree;
    all.positions.extend(more.positions);
    all.quaternions.extend(more.quaternions);
    all.log_scales.extend(more.log_scales);
    all.opacities.extend(more.opacities);
    all.harmonics.extend(more.harmonics);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::cloud::tests::sample;
    use super::*;

    fn read_back(bytes: &[u8]) -> (Gltf, SplatCloud) {
        let folder = Path::new("nowhere");
        (Gltf::read(bytes, folder).unwrap(), read(bytes, folder).unwrap().0)
    }

    #[test]
    fn every_number_is_under_the_name_of_the_extension() {
        let cloud = sample(5, 2);
        let (gltf, read) = read_back(&to_glb(&cloud).unwrap());
        let document = &gltf.document;
        assert_eq!(document["extensionsUsed"], json!([EXTENSION]));
        assert_eq!(document["asset"]["version"], "2.0");
        assert_eq!(document["asset"]["extras"]["offset"], json!([100.0, -20.5, 3.0]));
        let primitive = &document["meshes"][0]["primitives"][0];
        assert_eq!((&primitive["mode"], &primitive["extensions"][EXTENSION]["kernel"]), (&json!(0), &json!("ellipse")));
        let attributes = primitive["attributes"].as_object().unwrap();
        assert_eq!(attributes.len(), 5 + 9);
        let three = |name: &str| gltf.numbers::<3>(&attributes[&format!("{EXTENSION}:{name}")]).unwrap();
        assert_eq!(three("SCALE")[1][2], cloud.log_scales[1][2].exp());
        assert_eq!(three("SH_DEGREE_2_COEF_4")[1], cloud.harmonics_of(1)[8]);
        let rotations = gltf.numbers::<4>(&attributes[&format!("{EXTENSION}:ROTATION")]).unwrap();
        assert_eq!(rotations[1], [1, 2, 3, 0].map(|i: usize| cloud.quaternions[1][i]));
        let position = &document["accessors"][attributes["POSITION"].as_u64().unwrap() as usize];
        let smallest = cloud.positions.iter().map(|p| p[0]).fold(f32::INFINITY, f32::min);
        assert_eq!(position["min"][0].as_f64().unwrap() as f32, smallest);
        assert_eq!(
            (read.positions, read.opacities, read.harmonics),
            (cloud.positions, cloud.opacities, cloud.harmonics)
        );
    }

    #[test]
    fn a_file_is_in_metres_and_read_in_world_units() {
        let plain = sample(3, 1);
        let cloud =
            SplatCloud { info: SceneInfo { metres_per_unit: Some(0.25), ..plain.info.clone() }, ..plain.clone() };
        let (gltf, read) = read_back(&to_glb(&cloud).unwrap());
        let (in_units, _) = read_back(&to_glb(&plain).unwrap());
        let [metres, units] = [gltf, in_units]
            .map(|gltf| gltf.numbers::<3>(&gltf.document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]));
        assert_eq!(metres.unwrap()[2], units.unwrap()[2].map(|x| 0.25 * x));
        assert_eq!((read.info, read.positions.len()), (cloud.info.clone(), 3));
        for (read, expected) in read.positions.iter().flatten().zip(cloud.positions.iter().flatten()) {
            assert!((read - expected).abs() < 1e-5, "{read}, {expected}");
        }
    }

    #[test]
    fn nodes_stand_where_they_say_and_what_cannot_be_read_is_named() {
        let mut cloud = sample(3, 1);
        cloud.info.up = Some([0.0, 0.0, 1.0]);
        let [x, y, z] = cloud.positions[2];
        let (gltf, _) = read_back(&to_glb(&cloud).unwrap());
        let at = gltf.document["meshes"][0]["primitives"][0]["attributes"]["POSITION"].clone();
        assert_eq!(gltf.numbers::<3>(&at).unwrap()[2], [x, z, -y]);
        // as text, of another program, in a node that is moved and twice as large
        let mut document = gltf.document.clone();
        let base64 = base64::Engine::encode(&base64::prelude::BASE64_STANDARD, gltf.buffer(0));
        document["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{base64}"));
        document["asset"].as_object_mut().unwrap().remove("extras");
        document["nodes"] = json!([{ "children": [1], "translation": [0, 10, 0] }, { "mesh": 0, "scale": [2, 2, 2] }]);
        let text = |document: &Value| read(&serde_json::to_vec(document).unwrap(), Path::new("nowhere"));
        let (read, notes) = text(&document).unwrap();
        assert!(!notes.own && read.info.screen_filter == ScreenFilter::Plain);
        let expected = [-2.0 * x, -(2.0 * z + 10.0), -2.0 * y];
        assert!(read.positions[2].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", read.positions[2]);
        assert!((read.log_scales[0][0] - cloud.log_scales[0][0] - 2f32.ln()).abs() < 1e-6);
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a b.bin"), gltf.buffer(0)).unwrap();
        let beside = serde_json::to_string(&document)
            .unwrap()
            .replace(&document["buffers"][0]["uri"].to_string(), "\"a%20b.bin\"");
        assert_eq!(super::read(beside.as_bytes(), folder.path()).unwrap().0.positions, read.positions);
        document["accessors"][0]["count"] = json!(4);
        assert!(text(&document).err().unwrap().contains("ends after 3 of 4"));
        document["nodes"] = json!([{ "mesh": 0, "scale": [1, 2, 1] }]);
        document["accessors"][0]["count"] = json!(3);
        assert!(text(&document).err().unwrap().contains("evenly"));
        document["nodes"] = json!([{}]);
        assert!(text(&document).err().unwrap().contains(EXTENSION));
    }

    /// A file of `sample(2, 1)` that `edit` has changed, as text with its buffer.
    fn edited(edit: impl FnOnce(&mut Value, &mut Vec<u8>)) -> Result<(SplatCloud, Notes), String> {
        let gltf = Gltf::read(&to_glb(&sample(2, 1)).unwrap(), Path::new("nowhere")).unwrap();
        let (mut document, mut buffer) = (gltf.document.clone(), gltf.buffer(0).to_vec());
        edit(&mut document, &mut buffer);
        let base64 = base64::Engine::encode(&base64::prelude::BASE64_STANDARD, buffer);
        document["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{base64}"));
        read(&serde_json::to_vec(&document).unwrap(), Path::new("nowhere"))
    }

    /// Index of the accessor and first byte of the attribute `name`.
    fn place(document: &Value, name: &str) -> (usize, usize) {
        let index = document["meshes"][0]["primitives"][0]["attributes"][name].as_u64().unwrap() as usize;
        (index, document["bufferViews"][index]["byteOffset"].as_u64().unwrap() as usize)
    }

    #[test]
    fn integers_are_shares_of_their_range_only_if_they_say_so() {
        let positions = |normalized: bool| {
            let shorts = |document: &mut Value, buffer: &mut Vec<u8>| {
                let (index, at) = place(document, "POSITION");
                for (slot, value) in [0u16, 300, 65535, 1, 2, 3].into_iter().enumerate() {
                    buffer[at + 2 * slot..][..2].copy_from_slice(&value.to_le_bytes());
                }
                document["accessors"][index]["componentType"] = json!(5123);
                document["accessors"][index]["normalized"] = json!(normalized);
                document["extensionsRequired"] = json!(["KHR_mesh_quantization", "KHR_materials_unlit"]);
                document["asset"].as_object_mut().unwrap().remove("extras");
            };
            edited(shorts).unwrap().0.positions[0].map(|x| x.abs())
        };
        assert_eq!((positions(false), positions(true)[2]), ([0.0, 300.0, 65535.0], 1.0));
    }

    #[test]
    fn what_the_extension_or_its_drafts_allow_is_read_with_a_remark_and_other_words_are_refused() {
        let (plain, notes) = edited(|_, _| ()).unwrap();
        assert!(notes.read_as.is_empty());
        let (logarithms, notes) = edited(|document, buffer| {
            let (_, at) = place(document, "KHR_gaussian_splatting:SCALE");
            for slot in buffer[at..][..24].as_chunks_mut::<4>().0 {
                *slot = f32::from_le_bytes(*slot).ln().to_le_bytes();
            }
        })
        .unwrap();
        let pairs = logarithms.log_scales.iter().flatten().zip(plain.log_scales.iter().flatten());
        assert!(notes.read_as.len() == 1 && plain.log_scales[0][0] < 0.0);
        pairs.for_each(|(found, expected)| assert!((found - expected).abs() < 1e-6, "{found} {expected}"));

        let space = |name: &str| {
            edited(|document, _| {
                document["meshes"][0]["primitives"][0]["extensions"][EXTENSION]["colorSpace"] = json!(name);
            })
        };
        let (linear, notes) = space(LINEAR).unwrap();
        assert_eq!(notes.read_as.len(), 1);
        // (0.5 encoded − 0.5) / 0.2821 for grey, and the slope there
        let mut grey = SplatCloud { degree: 1, harmonics: vec![0.0; 12], ..sample(1, 1) };
        grey.harmonics[3..].fill(0.1);
        to_display(&mut grey);
        assert!((grey.harmonics[0] - 0.835).abs() < 1e-3 && (grey.harmonics[5] - 0.0659).abs() < 1e-4, "{grey:?}");
        assert_ne!(linear.harmonics, plain.harmonics);
        assert!(space("aces").err().unwrap().contains("aces"));
        let logit = edited(|document, buffer| {
            let (_, at) = place(document, "KHR_gaussian_splatting:OPACITY");
            buffer[at..][..4].copy_from_slice(&(-2f32).to_le_bytes());
        });
        assert!(logit.err().unwrap().contains("OPACITY of a splat is -2"));
        let packed = edited(|document, _| document["extensionsRequired"] = json!(["EXT_meshopt_compression"]));
        assert!(packed.err().unwrap().contains("EXT_meshopt_compression"));
        let second = edited(|document, _| {
            document["buffers"].as_array_mut().unwrap().push(json!({ "byteLength": 4 }));
            document["bufferViews"][0]["buffer"] = json!(1);
        });
        assert!(second.err().unwrap().contains("ends after 0 of 2"));
    }
}
