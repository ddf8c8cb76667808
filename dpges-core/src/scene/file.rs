//! The scene file: safetensors with little-endian f32 tensors named after the fields of
//! [`SceneData`] (`surfels.positions` [N, 3] … `gaussians.colour.detail` [M, D]) and three strings
//! of metadata: `format` = "dpges-scene", `version` = "1", `info` = [`SceneInfo`] as JSON.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

use safetensors::{Dtype, SafeTensors, View};

use super::{ColourData, ColourModel, GaussianData, SceneData, SceneInfo, SurfelData};
use crate::atomic::write_atomically;
use crate::error::{Error, Result};
use crate::tensor_file;

const FORMAT: &str = "dpges-scene";
const VERSION: &str = "1";
const MAX_LOBES: usize = 64;

/// One tensor of the file: its name, the shape it must have, its values row-major.
struct Rows<'a> {
    name: &'static str,
    shape: Vec<usize>,
    values: &'a [f32],
}

impl View for Rows<'_> {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        self.values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>().into()
    }

    fn data_len(&self) -> usize {
        size_of_val(self.values)
    }
}

impl Rows<'_> {
    fn check(&self) -> Result<()> {
        let expected = self.shape.iter().product::<usize>();
        if self.values.len() != expected {
            return Err(Error::Shape {
                tensor: self.name.to_owned(),
                expected: format!("{:?}", self.shape),
                found: vec![self.values.len()],
            });
        }
        match self.values.iter().position(|value| !value.is_finite()) {
            Some(at) => {
                let width = self.shape[1..].iter().product::<usize>();
                Err(Error::NonFinite { tensor: self.name.to_owned(), row: at / width })
            }
            None => Ok(()),
        }
    }
}

impl SceneData {
    /// Writes the scene file; an existing file is replaced only once the new one is complete.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::NonFinite`] naming the tensor, [`Error::SceneFile`] naming the
    /// field of the info that is out of range, [`Error::Io`].
    pub fn save(&self, path: &Path) -> Result<()> {
        let wrong = |reason| Error::SceneFile { path: path.to_owned(), reason };
        check_info(&self.info).map_err(wrong)?;
        let tensors = self.tensors();
        tensors.iter().try_for_each(Rows::check)?;
        let metadata = HashMap::from([
            ("format".to_owned(), FORMAT.to_owned()),
            ("version".to_owned(), VERSION.to_owned()),
            ("info".to_owned(), serde_json::to_string(&self.info).map_err(|error| wrong(error.to_string()))?),
        ]);
        let bytes = tensor_file::serialize(tensors.into_iter().map(|tensor| (tensor.name, tensor)), metadata)
            .map_err(|error| wrong(error.to_string()))?;
        write_atomically(path, |file| file.write_all(&bytes))
    }

    /// Reads a scene file and checks every tensor against the shapes its info asks for.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be read; [`Error::SceneFile`] naming the path, and the
    /// tensor where there is one, if it is no scene file, truncated, of another version, or has a
    /// tensor that is missing, of a wrong shape or type, or not finite.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes =
            std::fs::read(path).map_err(|source| Error::Io { action: "cannot read", path: path.to_owned(), source })?;
        parse(&bytes).map_err(|reason| Error::SceneFile { path: path.to_owned(), reason })
    }

    fn tensors(&self) -> [Rows<'_>; 12] {
        let (surfels, gaussians) = (&self.surfels, &self.gaussians);
        let (n, m, detail) = (surfels.len(), gaussians.len(), self.info.colour_model.detail_len());
        let rows = |name, shape: &[usize], values| Rows { name, shape: shape.to_vec(), values };
        [
            rows("surfels.positions", &[n, 3], &surfels.positions),
            rows("surfels.quaternions", &[n, 4], &surfels.quaternions),
            rows("surfels.log_scales", &[n, 2], &surfels.log_scales),
            rows("surfels.colour.base", &[n, 3], &surfels.colour.base),
            rows("surfels.colour.detail", &[n, detail], &surfels.colour.detail),
            rows("surfels.margins", &[n], &surfels.margins),
            rows("gaussians.positions", &[m, 3], &gaussians.positions),
            rows("gaussians.quaternions", &[m, 4], &gaussians.quaternions),
            rows("gaussians.log_scales", &[m, 3], &gaussians.log_scales),
            rows("gaussians.opacities", &[m], &gaussians.opacities),
            rows("gaussians.colour.base", &[m, 3], &gaussians.colour.base),
            rows("gaussians.colour.detail", &[m, detail], &gaussians.colour.detail),
        ]
    }
}

fn parse(bytes: &[u8]) -> Result<SceneData, String> {
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(unreadable)?;
    let file = SafeTensors::deserialize(bytes).map_err(unreadable)?;
    let metadata = header.metadata().clone().unwrap_or_default();
    let entry = |key: &str| metadata.get(key).map(String::as_str);
    if entry("format") != Some(FORMAT) {
        return Err("a safetensors file, but not a dpges scene".to_owned());
    }
    match entry("version") {
        Some(VERSION) => {}
        found => return Err(format!("version {} is unknown, expected {VERSION}", found.unwrap_or("(none)"))),
    }
    let info = entry("info").ok_or("metadata `info` is missing")?;
    let info: SceneInfo = serde_json::from_str(info).map_err(|error| format!("metadata `info`: {error}"))?;
    check_info(&info)?;

    let model = info.colour_model;
    let scene = SceneData { surfels: read_surfels(&file, model)?, gaussians: read_gaussians(&file, model)?, info };
    scene.tensors().iter().try_for_each(Rows::check).map_err(|error| error.to_string())?;
    Ok(scene)
}

fn unreadable(error: safetensors::SafeTensorError) -> String {
    format!("not a safetensors file, or truncated: {error}")
}

fn read_surfels(file: &SafeTensors, model: ColourModel) -> Result<SurfelData, String> {
    let count = row_count(file, "surfels.positions")?;
    Ok(SurfelData {
        positions: read(file, "surfels.positions", &[count, 3])?,
        quaternions: read(file, "surfels.quaternions", &[count, 4])?,
        log_scales: read(file, "surfels.log_scales", &[count, 2])?,
        colour: ColourData {
            base: read(file, "surfels.colour.base", &[count, 3])?,
            detail: read(file, "surfels.colour.detail", &[count, model.detail_len()])?,
        },
        margins: read(file, "surfels.margins", &[count])?,
    })
}

fn read_gaussians(file: &SafeTensors, model: ColourModel) -> Result<GaussianData, String> {
    let count = row_count(file, "gaussians.positions")?;
    Ok(GaussianData {
        positions: read(file, "gaussians.positions", &[count, 3])?,
        quaternions: read(file, "gaussians.quaternions", &[count, 4])?,
        log_scales: read(file, "gaussians.log_scales", &[count, 3])?,
        opacities: read(file, "gaussians.opacities", &[count])?,
        colour: ColourData {
            base: read(file, "gaussians.colour.base", &[count, 3])?,
            detail: read(file, "gaussians.colour.detail", &[count, model.detail_len()])?,
        },
    })
}

fn row_count(file: &SafeTensors, name: &str) -> Result<usize, String> {
    let tensor = file.tensor(name).map_err(|_| format!("tensor `{name}` is missing"))?;
    Ok(tensor.shape().first().copied().unwrap_or(0))
}

fn read(file: &SafeTensors, name: &str, shape: &[usize]) -> Result<Vec<f32>, String> {
    let tensor = file.tensor(name).map_err(|_| format!("tensor `{name}` is missing"))?;
    if tensor.dtype() != Dtype::F32 {
        return Err(format!("tensor `{name}` has element type {:?}, expected F32", tensor.dtype()));
    }
    if tensor.shape() != shape {
        return Err(format!("tensor `{name}` has shape {:?}, expected {shape:?}", tensor.shape()));
    }
    let (numbers, _) = tensor.data().as_chunks::<4>();
    Ok(numbers.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect())
}

fn check_info(info: &SceneInfo) -> Result<(), String> {
    let check = |field: &str, ok: bool, found: String, expected: &str| {
        if ok { Ok(()) } else { Err(format!("info `{field}` is {found}, expected {expected}")) }
    };
    let positive = |value: f64| value.is_finite() && value > 0.0;
    let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
    if let ColourModel::SphericalBeta { lobes } = info.colour_model {
        check("colour_model", lobes <= MAX_LOBES, info.colour_model.to_string(), "at most 64 lobes")?;
    }
    check("modulation", positive(info.modulation), info.modulation.to_string(), "a positive number")?;
    check("layer_count", info.layer_count > 0, info.layer_count.to_string(), "at least 1")?;
    check("background", finite(&info.background), format!("{:?}", info.background), "finite numbers")?;
    check("offset", finite(&info.offset), format!("{:?}", info.offset), "finite numbers")?;
    check("extent", info.extent.is_finite() && info.extent >= 0.0, info.extent.to_string(), "a number of at least 0")?;
    check("near", positive(info.near), info.near.to_string(), "a positive number")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Footprint, MarginLookup};

    fn scene(model: ColourModel, surfels: usize, gaussians: usize) -> SceneData {
        let rows = |count: usize, width: usize| (0..count * width).map(|i| (i as f32 * 0.37).sin()).collect::<Vec<_>>();
        let colour = |count| ColourData { base: rows(count, 3), detail: rows(count, model.detail_len()) };
        SceneData {
            info: SceneInfo {
                colour_model: model,
                modulation: 30.0,
                layer_count: 3,
                footprint: Footprint::Kernel,
                margin_lookup: MarginLookup::Literal,
                background: [0.0, 0.5, 1.0],
                offset: [5.25e5, -2.0, 0.125],
                extent: 4.5,
                near: 0.2,
            },
            surfels: SurfelData {
                positions: rows(surfels, 3),
                quaternions: rows(surfels, 4),
                log_scales: rows(surfels, 2),
                colour: colour(surfels),
                margins: rows(surfels, 1),
            },
            gaussians: GaussianData {
                positions: rows(gaussians, 3),
                quaternions: rows(gaussians, 4),
                log_scales: rows(gaussians, 3),
                opacities: rows(gaussians, 1),
                colour: colour(gaussians),
            },
        }
    }

    fn load_bytes(bytes: &[u8]) -> String {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        let error = SceneData::load(file.path()).unwrap_err().to_string();
        assert!(error.contains(&*file.path().to_string_lossy()), "{error}");
        error
    }

    fn save_bytes(scene: &SceneData, edit: impl Fn(&mut HashMap<String, String>), drop: &str) -> Vec<u8> {
        let mut metadata = HashMap::from([
            ("format".to_owned(), FORMAT.to_owned()),
            ("version".to_owned(), VERSION.to_owned()),
            ("info".to_owned(), serde_json::to_string(&scene.info).unwrap()),
        ]);
        edit(&mut metadata);
        let tensors = scene.tensors().into_iter().filter(|tensor| tensor.name != drop);
        safetensors::serialize(tensors.map(|tensor| (tensor.name, tensor)), Some(metadata)).unwrap()
    }

    #[test]
    fn what_was_saved_is_loaded_for_every_colour_model_and_for_empty_sets() {
        let folder = tempfile::tempdir().unwrap();
        for model in ["sb0", "sb2", "sh0", "sh3"] {
            for (surfels, gaussians) in [(3, 5), (0, 5), (3, 0), (0, 0)] {
                let scene = scene(model.parse().unwrap(), surfels, gaussians);
                let path = folder.path().join("scene.safetensors");
                scene.save(&path).unwrap();
                assert_eq!(SceneData::load(&path).unwrap(), scene, "{model} {surfels} {gaussians}");
            }
        }
    }

    #[test]
    fn a_file_that_does_not_name_the_lookup_has_the_shifted_one() {
        let scene = scene(ColourModel::SphericalBeta { lobes: 2 }, 3, 5);
        let without = |metadata: &mut HashMap<String, String>| {
            let info = metadata["info"].replace(r#""margin_lookup":"literal","#, "");
            assert!(!info.contains("margin_lookup"), "{info}");
            metadata.insert("info".into(), info);
        };
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), save_bytes(&scene, without, "")).unwrap();
        let loaded = SceneData::load(file.path()).unwrap();
        assert_eq!(loaded.info, SceneInfo { margin_lookup: MarginLookup::Shifted, ..scene.info });
    }

    #[test]
    fn a_scene_that_is_wrong_is_not_saved() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.safetensors");
        let good = scene(ColourModel::SphericalBeta { lobes: 2 }, 3, 5);
        let mut bad = good.clone();
        bad.gaussians.log_scales[7] = f32::NAN;
        assert!(
            matches!(bad.save(&path), Err(Error::NonFinite { tensor, row: 2, .. }) if tensor == "gaussians.log_scales")
        );
        let mut bad = good.clone();
        bad.surfels.quaternions.pop();
        assert!(matches!(bad.save(&path), Err(Error::Shape { tensor, .. }) if tensor == "surfels.quaternions"));
        let mut bad = good;
        bad.info.near = f64::NAN;
        assert!(bad.save(&path).unwrap_err().to_string().contains("`near`"));
        assert!(!path.exists());
    }

    #[test]
    fn broken_files_are_told_apart() {
        let good = scene(ColourModel::SphericalBeta { lobes: 2 }, 3, 5);
        let bytes = save_bytes(&good, |_| {}, "");
        for end in [0, 4, 40, bytes.len() - 1] {
            assert!(load_bytes(&bytes[..end]).contains("truncated"));
        }
        assert!(load_bytes(b"ply\nformat binary_little_endian 1.0\n").contains("not a safetensors file"));
        assert!(load_bytes(&save_bytes(&good, |m| drop(m.remove("format")), "")).contains("not a dpges scene"));
        let newer = |m: &mut HashMap<String, String>| drop(m.insert("version".into(), "2".into()));
        assert!(load_bytes(&save_bytes(&good, newer, "")).contains("version 2"));
        let no_info = |m: &mut HashMap<String, String>| drop(m.insert("info".into(), "{}".into()));
        assert!(load_bytes(&save_bytes(&good, no_info, "")).contains("`info`"));
        assert!(load_bytes(&save_bytes(&good, |_| {}, "surfels.margins")).contains("`surfels.margins` is missing"));
        let missing = SceneData::load(Path::new("/nowhere/scene.safetensors")).unwrap_err();
        assert!(matches!(&missing, Error::Io { .. }) && missing.to_string().contains("/nowhere"));
    }

    #[test]
    fn wrong_tensors_are_named() {
        let mut bad = scene(ColourModel::SphericalBeta { lobes: 2 }, 3, 5);
        bad.info.colour_model = ColourModel::SphericalBeta { lobes: 1 };
        let bytes = save_bytes(
            &scene(ColourModel::SphericalBeta { lobes: 2 }, 3, 5),
            |m| {
                m.insert("info".into(), serde_json::to_string(&bad.info).unwrap());
            },
            "",
        );
        assert!(load_bytes(&bytes).contains("`surfels.colour.detail` has shape [3, 12], expected [3, 6]"));
        let mut bad = scene(ColourModel::SphericalBeta { lobes: 2 }, 3, 5);
        bad.surfels.positions[4] = f32::INFINITY;
        let error = load_bytes(&save_bytes(&bad, |_| {}, ""));
        assert!(error.contains("`surfels.positions` is not finite at row 1"), "{error}");
    }
}
