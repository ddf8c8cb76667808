//! The scene file: safetensors with little-endian f32 tensors named after the fields of
//! [`SceneData`] (`surfels.positions` [N, 3] … `gaussians.colour.detail` [M, D]) and three strings
//! of metadata: `format` = "dpges-scene", `version` = "3", `info` = [`SceneInfo`] as JSON. Files of version "2", whose
//! info does not say what is up, are read as well.
//!
//! Gaussians with Student's t kernels have one tensor more, `gaussians.degrees_of_freedom` `[M]`.
//! A scene with an environment has one tensor more, `environment` [(degree + 1)², 3]; see [`EnvironmentData`].
//!
//! A file stores only the spherical Beta lobes that a primitive has (see [`lobes`](super::lobes)). In place of
//! `surfels.colour.detail` [N, 6 × lobes] stand `surfels.colour.lobe_counts` `[N]`, one byte for every surfel, and
//! `surfels.colour.lobes` [sum of the counts, 6], those of the first surfel first; likewise for the Gaussians.
//! [Compressed](mod@super::compressed) files are read as well.
//!
//! Only scenes of [weighted sums](super::WeightedSum) have the tensors `gaussians.opacity_base` [M, 1] and
//! `gaussians.opacity_detail` [M, 15], and `weighted_sum` in their info.

use std::io::Write;
use std::path::Path;

use safetensors::{Dtype, SafeTensors};
use serde_json::Value;

use super::compressed;
use super::container::{Rows, bytes, lobe_names, read, row_count, scene_file, serialize, unreadable};
use super::data::check_numbers;
use super::lobes::{LOBE_LEN, pack, unpack};
use super::schema::{Attribute, Columns, ENVIRONMENT, Width};
use super::{
    ColourModel, EnvironmentData, GaussianData, Peeling, Rendering, SceneData, SceneInfo, SurfelData, WeightedSum,
};
use crate::error::{Error, Result};
use crate::scene::atomic::write_atomically;

const FORMAT: &str = "dpges-scene";
/// The info of the second says nothing of what is up.
const VERSIONS: [&str; 2] = ["3", "2"];
const MAX_LOBES: usize = 64;

impl SceneData {
    /// Writes the scene file; an existing file is replaced only once the new one is complete.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::NonFinite`] naming the tensor, [`Error::SceneFile`] naming the
    /// field of the info that is out of range, [`Error::Io`].
    pub fn save(&self, path: &Path) -> Result<()> {
        let bytes = self.to_bytes(path)?;
        write_atomically(path, |file| file.write_all(&bytes))
    }

    /// The bytes of the scene file; errors name `path`.
    ///
    /// # Errors
    /// As [`save`](Self::save), without those of writing.
    pub fn to_bytes(&self, path: &Path) -> Result<Vec<u8>> {
        let wrong = |reason| Error::SceneFile { path: path.to_owned(), reason };
        self.validate(path)?;
        scene_file(self, self.stored(), [FORMAT, VERSIONS[0]], None).map_err(wrong)
    }

    /// Reads a scene file and checks every tensor against the shapes its info asks for.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be read; [`Error::SceneFile`] naming the path, and the
    /// tensor where there is one, if it is no scene file, truncated, of another version, or has a
    /// tensor that is missing, of a wrong shape or type, or not finite, or counts of lobes that
    /// exceed those of the colour model or do not fit the lobes of the file.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes =
            std::fs::read(path).map_err(|source| Error::Io { action: "cannot read", path: path.to_owned(), source })?;
        parse(&bytes).map_err(|reason| Error::SceneFile { path: path.to_owned(), reason })
    }

    /// [`load`](Self::load) for the `bytes` of a file; errors name it `name`.
    ///
    /// # Errors
    /// [`Error::SceneFile`], as [`load`](Self::load).
    pub fn from_bytes(bytes: &[u8], name: &str) -> Result<Self> {
        parse(bytes).map_err(|reason| Error::SceneFile { path: name.into(), reason })
    }

    /// Writes into the scene file at `path`, plain or compressed, how many metres a world unit has. Nothing else changes.
    ///
    /// # Errors
    /// Those of [`load`](Self::load); [`Error::SceneFile`] unless the number is positive and finite; [`Error::Io`].
    pub fn set_metres_per_unit(path: &Path, metres_per_unit: f64) -> Result<()> {
        let wrong = |reason| Error::SceneFile { path: path.to_owned(), reason };
        let bytes =
            std::fs::read(path).map_err(|source| Error::Io { action: "cannot read", path: path.to_owned(), source })?;
        let Self { info, .. } = parse(&bytes).map_err(wrong)?;
        let info = SceneInfo { metres_per_unit: Some(metres_per_unit), ..info };
        let bytes = check_info(&info).and_then(|()| with_info(&bytes, &info)).map_err(wrong)?;
        write_atomically(path, |file| file.write_all(&bytes))
    }

    /// The first problem of the scene, for a file at `path`.
    ///
    /// # Errors
    /// As [`save`](Self::save).
    pub fn validate(&self, path: &Path) -> Result<()> {
        let wrong = |reason| Error::SceneFile { path: path.to_owned(), reason };
        check_info(&self.info).map_err(wrong)?;
        let models = [
            ("surfels", self.surfels.len(), self.surfels.model()),
            ("gaussians", self.gaussians.len(), self.gaussians.model()),
        ];
        let expected = self.info.colour_model;
        if let Some((of, _, model)) = models.into_iter().find(|&(_, count, model)| count > 0 && model != expected) {
            return Err(wrong(format!("the colours of {of} are {model}, info `colour_model` is {expected}")));
        }
        self.check()
    }

    fn check(&self) -> Result<()> {
        self.surfels.check()?;
        self.gaussians.check()?;
        if self.gaussians.degrees_of_freedom.is_some() != (self.info.rendering == Rendering::Students) {
            let expected = "those of Student's t kernels in scenes of `students`, and in no others".to_owned();
            let found = format!("info `rendering` = {}", self.info.rendering);
            return Err(Error::Option { option: GaussianData::OPTIONAL[0].name, expected, found });
        }
        self.environment.as_ref().map_or(Ok(()), EnvironmentData::check)
    }

    /// The tensors of the file; those in memory must have been checked.
    fn stored(&self) -> Vec<Rows<'_>> {
        let mut stored = Vec::new();
        stored_columns(&self.surfels, self.surfels.len(), self.info.colour_model, &mut stored);
        stored_columns(&self.gaussians, self.gaussians.len(), self.info.colour_model, &mut stored);
        stored
    }
}

/// The tensors of `count` primitives, with only the lobes that are there.
fn stored_columns<'a, C: Columns<Value = Vec<f32>>>(
    columns: &'a C,
    count: usize,
    model: ColourModel,
    stored: &mut Vec<Rows<'a>>,
) {
    for (attribute, values) in columns.iter().filter(|(attribute, _)| !attribute.is_left_out(model)) {
        match (attribute.width, model) {
            (Width::Detail, ColourModel::SphericalBeta { lobes }) => {
                let (counts, numbers) = pack(values, count, lobes);
                let listed = vec![numbers.len() / LOBE_LEN, LOBE_LEN];
                let [counted, lobes] = lobe_names(attribute);
                stored.push(Rows::bytes(counted, counts));
                stored.push(Rows::numbers(lobes, listed, numbers));
            }
            _ => {
                stored.push(Rows::numbers(attribute.name, attribute.stored_shape(count, model), &values[..]));
            }
        }
    }
}

fn parse(bytes: &[u8]) -> Result<SceneData, String> {
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(unreadable(bytes))?;
    let file = SafeTensors::deserialize(bytes).map_err(unreadable(bytes))?;
    let metadata = header.metadata().clone().unwrap_or_default();
    let entry = |key: &str| metadata.get(key).map(String::as_str);
    let versions: &[&str] = match entry("format") {
        Some(FORMAT) => &VERSIONS,
        Some(compressed::FORMAT) => &[compressed::VERSION],
        _ => return Err("a safetensors file, but not a dpges scene".to_owned()),
    };
    let version = entry("version").unwrap_or("(none)");
    if !versions.contains(&version) {
        return Err(format!("version {version} is unknown, expected {}", versions.join(" or ")));
    }
    let info = entry("info").ok_or("metadata `info` is missing")?;
    let info = read_info(info).map_err(|error| format!("metadata `info`: {error}"))?;
    check_info(&info)?;

    let (surfels, gaussians) = if entry("format") == Some(compressed::FORMAT) {
        compressed::read(&file, &metadata, &info, bytes.len())?
    } else {
        (read_columns::<SurfelData>(&file, info.colour_model)?, read_columns::<GaussianData>(&file, info.colour_model)?)
    };
    let scene = SceneData { surfels, gaussians, environment: read_environment(&file)?, info };
    scene.check().map_err(|error| error.to_string())?;
    Ok(scene)
}

/// The scene file `bytes` with another info.
fn with_info(bytes: &[u8], info: &SceneInfo) -> Result<Vec<u8>, String> {
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(unreadable(bytes))?;
    let file = SafeTensors::deserialize(bytes).map_err(unreadable(bytes))?;
    let mut metadata = header.metadata().clone().unwrap_or_default();
    metadata.insert("info".to_owned(), serde_json::to_string(info).map_err(|error| error.to_string())?);
    serialize(file.tensors(), metadata).map_err(|error| error.to_string())
}

fn read_info(text: &str) -> serde_json::Result<SceneInfo> {
    let mut info: Value = serde_json::from_str(text)?;
    if let Some(entries) = info.as_object_mut().filter(|entries| !entries.contains_key("peeling")) {
        let peeling = serde_json::to_value(Peeling::of_older_file(entries))?;
        entries.insert("peeling".to_owned(), peeling);
    }
    serde_json::from_value(info)
}

/// The attributes of a kind of primitive.
fn read_columns<C: Columns>(file: &SafeTensors, model: ColourModel) -> Result<C::With<Vec<f32>>, String> {
    let count = row_count(file, C::ATTRIBUTES[0].name)?;
    let values = |attribute: &'static Attribute| match (attribute.width, model) {
        _ if attribute.is_left_out(model) => Ok(Vec::new()),
        (Width::Detail, ColourModel::SphericalBeta { lobes }) => read_lobes(file, lobe_names(attribute), count, lobes),
        _ => read(file, attribute.name, &attribute.stored_shape(count, model)),
    };
    let stored = C::OPTIONAL.iter().take_while(|attribute| file.tensor(attribute.name).is_ok());
    let list = C::ATTRIBUTES.iter().chain(stored).map(values).collect::<Result<_, String>>()?;
    Ok(C::from_list(model, list))
}

fn read_environment(file: &SafeTensors) -> Result<Option<EnvironmentData>, String> {
    let name = ENVIRONMENT.name;
    let Ok(tensor) = file.tensor(name) else { return Ok(None) };
    let count = tensor.shape().first().copied().unwrap_or(0);
    if tensor.shape() != [count, 3] || EnvironmentData::degree_of(count).is_none() {
        let expected = EnvironmentData::EXPECTED_SHAPE;
        return Err(format!("tensor `{name}` has shape {:?}, expected {expected}", tensor.shape()));
    }
    Ok(Some(EnvironmentData { coefficients: read(file, name, &[count, 3])? }))
}

/// The detail of `count` primitives with room for `lobes`, from the tensors `names`.
fn read_lobes(file: &SafeTensors, names: [&str; 2], count: usize, lobes: usize) -> Result<Vec<f32>, String> {
    let counts = bytes(file, names[0], Dtype::U8, &[count])?;
    let shape = [row_count(file, names[1])?, LOBE_LEN];
    let numbers = read(file, names[1], &shape)?;
    check_numbers(names[1], &shape, &numbers).map_err(|error| error.to_string())?;
    unpack(counts, &numbers, lobes).map_err(|reason| format!("tensor `{}` {reason}", names[0]))
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
    let (sums, opacity) = (info.rendering == Rendering::Summed, info.colour_model.opacity_len() > 0);
    check(
        "colour_model",
        sums == opacity,
        info.colour_model.to_string(),
        "+opacity where sums are weighted, only there",
    )?;
    let sum = info.weighted_sum.as_ref();
    let fits = sum.is_some() == sums && sum.is_none_or(WeightedSum::is_finite);
    check("weighted_sum", fits, format!("{sum:?}"), "finite numbers where sums are weighted, nothing elsewhere")?;
    check("modulation", positive(info.modulation), info.modulation.to_string(), "a positive number")?;
    check("layer_count", info.layer_count > 0, info.layer_count.to_string(), "at least 1")?;
    check("background", finite(&info.background), format!("{:?}", info.background), "finite numbers")?;
    check("offset", finite(&info.offset), format!("{:?}", info.offset), "finite numbers")?;
    let up = info.up.unwrap_or([0.0, -1.0, 0.0]);
    check("up", finite(&up) && up != [0.0; 3], format!("{up:?}"), "a direction")?;
    check("extent", info.extent.is_finite() && info.extent >= 0.0, info.extent.to_string(), "a number of at least 0")?;
    check("near", positive(info.near), info.near.to_string(), "a positive number")?;
    let metres = info.metres_per_unit.unwrap_or(1.0);
    check("metres_per_unit", positive(metres), metres.to_string(), "a positive number")
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;
    use crate::scene::container::{GAUSSIAN_LOBES, SURFEL_LOBES, environment};
    use crate::scene::lobes::ABSENT_LOBE;
    use crate::scene::{BlendOrder, Quality, ScreenFilter};
    use crate::testing::scenes::numbered;

    const TWO_LOBES: ColourModel = ColourModel::SphericalBeta { lobes: 2 };

    fn scene(model: ColourModel, surfels: usize, gaussians: usize) -> SceneData {
        let mut scene = numbered(model, [surfels, gaussians], |_, at| (at as f32 * 0.37).sin());
        if let Some(sum) = &mut scene.info.weighted_sum {
            sum.sigma = 7.5;
        }
        scene.info = SceneInfo {
            peeling: Peeling::Literal,
            screen_filter: ScreenFilter::Plain,
            blend_order: BlendOrder::Rays,
            background: [0.0, 0.5, 1.0],
            up: Some([0.0, 0.6, 0.8]),
            extent: 4.5,
            ..scene.info
        };
        scene
    }

    fn read_back(bytes: &[u8]) -> Result<SceneData> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        let result = SceneData::load(file.path());
        if let Err(error) = &result {
            assert!(error.to_string().contains(&*file.path().to_string_lossy()), "{error}");
        }
        result
    }

    fn load_bytes(bytes: &[u8]) -> String {
        read_back(bytes).unwrap_err().to_string()
    }

    fn file_bytes(tensors: Vec<Rows>, metadata: HashMap<String, String>) -> Vec<u8> {
        safetensors::serialize(tensors.into_iter().map(|tensor| (tensor.name, tensor)), Some(metadata)).unwrap()
    }

    fn metadata(scene: &SceneData) -> HashMap<String, String> {
        HashMap::from([
            ("format".to_owned(), FORMAT.to_owned()),
            ("version".to_owned(), VERSIONS[0].to_owned()),
            ("info".to_owned(), serde_json::to_string(&scene.info).unwrap()),
        ])
    }

    fn save_bytes(scene: &SceneData, edit: impl Fn(&mut HashMap<String, String>), drop: &str) -> Vec<u8> {
        let mut metadata = metadata(scene);
        edit(&mut metadata);
        let mut tensors = scene.stored();
        tensors.extend(environment(scene));
        tensors.retain(|tensor| tensor.name != drop);
        file_bytes(tensors, metadata)
    }

    /// The file of `scene` with another tensor in place of that with the name of `other`.
    fn with_tensor(scene: &SceneData, other: Rows) -> Vec<u8> {
        let mut tensors = scene.stored();
        tensors.extend(environment(scene));
        tensors.retain(|tensor| tensor.name != other.name);
        tensors.push(other);
        file_bytes(tensors, metadata(scene))
    }

    fn drop_lobe(detail: &mut [f32], lobes: usize, row: usize, lobe: usize) {
        detail[(row * lobes + lobe) * LOBE_LEN..][..LOBE_LEN].copy_from_slice(&ABSENT_LOBE);
    }

    #[test]
    fn a_scale_is_set_and_changes_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let [plain, compressed, set] = ["plain", "compressed", "set"].map(|name| folder.path().join(name));
        let scene = scene(TWO_LOBES, 3, 5);
        let scaled =
            SceneData { info: SceneInfo { metres_per_unit: Some(0.25), ..scene.info.clone() }, ..scene.clone() };
        scene.save(&plain).unwrap();
        SceneData::set_metres_per_unit(&plain, 0.25).unwrap();
        assert_eq!(std::fs::read(&plain).unwrap(), scaled.to_bytes(&plain).unwrap());

        scene.save_compressed(&compressed, &Quality::MEDIUM).unwrap();
        SceneData::set_metres_per_unit(&compressed, 0.25).unwrap();
        scaled.save_compressed(&set, &Quality::MEDIUM).unwrap();
        assert_eq!(std::fs::read(&compressed).unwrap(), std::fs::read(&set).unwrap());

        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let message = SceneData::set_metres_per_unit(&plain, wrong).unwrap_err().to_string();
            assert!(message.contains("metres_per_unit"), "{message}");
        }
        assert_eq!(SceneData::load(&plain).unwrap(), scaled, "refused, and as it was");
    }

    #[test]
    fn larger_coordinates_have_fewer_metres_per_unit() {
        let info =
            SceneInfo { offset: [1.0, -2.0, 0.5], near: 0.5, metres_per_unit: Some(3.0), ..SceneInfo::default() };
        let scaled = info.scaled(2.0);
        assert_eq!((scaled.offset, scaled.near, scaled.extent), ([2.0, -4.0, 1.0], 1.0, 2.0));
        assert_eq!((scaled.metres_per_unit, scaled.up), (Some(1.5), info.up));
    }

    #[test]
    fn what_was_saved_is_loaded_for_every_colour_model_and_for_empty_sets() {
        let folder = tempfile::tempdir().unwrap();
        for model in ["sb0", "sb2", "sh0", "sh3", "sh0+opacity", "sh3+opacity"] {
            for (surfels, gaussians) in [(3, 5), (0, 5), (3, 0), (0, 0)] {
                let scene = scene(model.parse().unwrap(), surfels, gaussians);
                let path = folder.path().join("scene.safetensors");
                scene.save(&path).unwrap();
                assert_eq!(SceneData::load(&path).unwrap(), scene, "{model} {surfels} {gaussians}");
            }
        }
    }

    #[test]
    fn students_have_degrees_of_freedom_and_nothing_else_has() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.safetensors");
        let mut students = scene("sh1".parse().unwrap(), 0, 5);
        let refused = |scene: &SceneData| scene.save(&path).unwrap_err().to_string();
        students.info.rendering = Rendering::Students;
        assert!(refused(&students).contains("`gaussians.degrees_of_freedom`"));
        students.gaussians.degrees_of_freedom = Some(vec![1.0, 2.5, 100.0, 1e4, 7.0]);
        students.save(&path).unwrap();
        assert_eq!(SceneData::load(&path).unwrap(), students);
        let picked = students.gaussians.select(&[3, 0]);
        assert_eq!(picked.degrees_of_freedom, Some(vec![1e4, 1.0]));
        assert!(students.to_compressed(&Quality::LOW, &path).unwrap_err().to_string().contains("Student"));
        let without = load_bytes(&save_bytes(&students, |_| (), "gaussians.degrees_of_freedom"));
        assert!(without.contains("`gaussians.degrees_of_freedom`"), "{without}");
        students.info.rendering = Rendering::Ellipsoids;
        assert!(refused(&students).contains("`gaussians.degrees_of_freedom`"));
    }

    #[test]
    fn older_files_name_their_peeling_by_other_entries() {
        let scene = scene(TWO_LOBES, 3, 5);
        for (entries, peeling) in [
            ("", Peeling::Nearest),
            (r#""backstop":false,"margin_lookup":"shifted","#, Peeling::Nearest),
            (r#""backstop":false,"margin_lookup":"literal","#, Peeling::Literal),
            (r#""backstop":true,"margin_lookup":"shifted","#, Peeling::Continuous),
        ] {
            let older = |metadata: &mut HashMap<String, String>| {
                let info = metadata["info"].replace(r#""peeling":"literal","#, entries);
                assert!(!info.contains("peeling"), "{info}");
                metadata.insert("info".into(), info);
            };
            let loaded = read_back(&save_bytes(&scene, older, "")).unwrap();
            assert_eq!(loaded.info, SceneInfo { peeling, ..scene.info.clone() });
        }
    }

    #[test]
    fn an_environment_of_every_degree_comes_back_and_wrong_ones_are_named() {
        let with = |count: usize| {
            let coefficients = (0..3 * count).map(|i| (i as f32 * 0.7).cos()).collect();
            SceneData { environment: Some(EnvironmentData { coefficients }), ..scene(TWO_LOBES, 3, 5) }
        };
        for (degree, count) in [(0, 1), (1, 4), (2, 9), (3, 16)] {
            assert_eq!(EnvironmentData::neutral(degree).len(), count);
            let good = with(count);
            assert_eq!(read_back(&save_bytes(&good, |_| {}, "")).unwrap(), good);
            assert_eq!(read_back(&save_bytes(&good, |_| {}, "environment")).unwrap().environment, None);
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.safetensors");
        let mut spoilt = with(4);
        spoilt.environment.as_mut().unwrap().coefficients[7] = f32::NAN;
        for (bad, expected) in [
            (with(0), "tensor `environment` has shape [0, 3], expected [(degree + 1)², 3]"),
            (with(5), "tensor `environment` has shape [5, 3], expected [(degree + 1)², 3]"),
            (with(25), "tensor `environment` has shape [25, 3]"),
            (spoilt, "`environment` is not finite at row 2"),
        ] {
            let error = load_bytes(&save_bytes(&bad, |_| {}, ""));
            assert!(error.contains(expected), "{error}");
            assert!(bad.save(&path).unwrap_err().to_string().contains("`environment`"));
        }
        let flat = [0.5; 12];
        let wide = with_tensor(&with(4), Rows::numbers("environment", vec![3, 4], &flat[..]));
        assert!(load_bytes(&wide).contains("`environment` has shape [3, 4]"));
        assert!(!path.exists());
    }

    #[test]
    fn absent_lobes_take_no_room_and_come_back_absent() {
        let mut scene = scene(TWO_LOBES, 3, 5);
        for (row, lobe) in [(0, 1), (2, 0), (2, 1)] {
            drop_lobe(&mut scene.surfels.colour.detail, 2, row, lobe);
        }
        let bytes = save_bytes(&scene, |_| {}, "");
        let file = SafeTensors::deserialize(&bytes).unwrap();
        assert_eq!(file.tensor("surfels.colour.lobe_counts").unwrap().data(), [1, 2, 0]);
        assert_eq!(file.tensor("surfels.colour.lobes").unwrap().shape(), [3, 6]);
        assert_eq!(file.tensor("gaussians.colour.lobe_counts").unwrap().data(), [2; 5]);
        assert!(file.tensor("surfels.colour.detail").is_err());
        assert_eq!(read_back(&bytes).unwrap(), scene);

        let second = scene.gaussians.colour.detail[4 * 12 + 6..].to_vec();
        drop_lobe(&mut scene.gaussians.colour.detail, 2, 4, 0);
        let loaded = read_back(&save_bytes(&scene, |_| {}, "")).unwrap();
        assert_eq!(loaded.gaussians.colour.detail[4 * 12..], [second, ABSENT_LOBE.to_vec()].concat());
    }

    #[test]
    fn a_scene_that_is_wrong_is_not_saved() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.safetensors");
        let good = scene(TWO_LOBES, 3, 5);
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
        let good = scene(TWO_LOBES, 3, 5);
        let bytes = save_bytes(&good, |_| {}, "");
        for end in [4, 40, bytes.len() - 1] {
            assert!(load_bytes(&bytes[..end]).contains("truncated"));
        }
        assert!(load_bytes(b"ply\nformat binary_little_endian 1.0\n").contains("not a safetensors file"));
        assert!(load_bytes(b"").contains("the file is empty"));
        assert!(load_bytes(b"version https://git-lfs.github.com/spec/v1\n").contains("git lfs pull"));
        assert!(load_bytes(b"<!DOCTYPE html>").contains("a web page"));
        assert!(load_bytes(&save_bytes(&good, |m| drop(m.remove("format")), "")).contains("not a dpges scene"));
        let newer = |m: &mut HashMap<String, String>| drop(m.insert("version".into(), "4".into()));
        assert!(load_bytes(&save_bytes(&good, newer, "")).contains("version 4 is unknown, expected 3 or 2"));
        let no_info = |m: &mut HashMap<String, String>| drop(m.insert("info".into(), "{}".into()));
        assert!(load_bytes(&save_bytes(&good, no_info, "")).contains("`info`"));
        assert!(load_bytes(&save_bytes(&good, |_| {}, "surfels.margins")).contains("`surfels.margins` is missing"));
        let mut infinite = good;
        infinite.surfels.positions[4] = f32::INFINITY;
        let error = load_bytes(&save_bytes(&infinite, |_| {}, ""));
        assert!(error.contains("`surfels.positions` is not finite at row 1"), "{error}");
        let missing = SceneData::load(Path::new("/nowhere/scene.safetensors")).unwrap_err();
        assert!(matches!(&missing, Error::Io { .. }) && missing.to_string().contains("/nowhere"));
    }

    #[test]
    fn weighted_sums_have_opacities_that_depend_on_the_direction_and_others_have_none() {
        let weighted = scene("sh1+opacity".parse().unwrap(), 0, 5);
        let bytes = save_bytes(&weighted, |_| {}, "");
        let file = SafeTensors::deserialize(&bytes).unwrap();
        assert_eq!(file.tensor("gaussians.opacity_base").unwrap().shape(), [5, 1]);
        assert_eq!(file.tensor("gaussians.opacity_detail").unwrap().shape(), [5, 3]);
        let plain = save_bytes(&scene("sh1".parse().unwrap(), 0, 5), |_| {}, "");
        assert!(SafeTensors::deserialize(&plain).unwrap().names().iter().all(|name| !name.contains("opacity_")));
        assert!(
            load_bytes(&save_bytes(&weighted, |_| {}, "gaussians.opacity_base")).contains("opacity_base` is missing")
        );

        let spoilt = |spoil: fn(&mut SceneInfo)| {
            let mut scene = weighted.clone();
            spoil(&mut scene.info);
            load_bytes(&save_bytes(&scene, |_| {}, ""))
        };
        assert!(spoilt(|info| info.weighted_sum = None).contains("info `weighted_sum` is None"));
        assert!(spoilt(|info| info.rendering = Rendering::Ellipsoids).contains("info `colour_model` is sh1+opacity"));
        let infinite = spoilt(|info| info.weighted_sum.as_mut().unwrap().beta = f32::INFINITY);
        assert!(infinite.contains("info"), "{infinite}");
    }

    #[test]
    fn lobes_that_do_not_fit_their_counts_are_named() {
        let good = scene(TWO_LOBES, 3, 5);
        let counts = |values: &[u8]| with_tensor(&good, Rows::bytes(SURFEL_LOBES[0], values.to_vec()));
        let lobes = |shape: [usize; 2], values: &[f32]| {
            with_tensor(&good, Rows::numbers(SURFEL_LOBES[1], shape.to_vec(), values))
        };
        let mut spoilt = [0.5; 36];
        spoilt[31] = f32::NAN;
        let twos = [2.0; 3];
        let as_numbers = Rows::numbers(SURFEL_LOBES[0], vec![3], &twos[..]);
        for (bytes, expected) in [
            (counts(&[2, 2, 2]), None),
            (counts(&[2, 3, 1]), Some("`surfels.colour.lobe_counts` has 3 lobes at row 1, expected at most 2")),
            (counts(&[2, 2, 1]), Some("`surfels.colour.lobe_counts` adds up to 5 lobes, expected the 6")),
            (counts(&[2, 2, 2, 0]), Some("`surfels.colour.lobe_counts` has shape [4], expected [3]")),
            (with_tensor(&good, as_numbers), Some("`surfels.colour.lobe_counts` has element type F32, expected U8")),
            (lobes([7, 6], &[0.5; 42]), Some("`surfels.colour.lobe_counts` adds up to 6 lobes, expected the 7")),
            (lobes([12, 3], &[0.5; 36]), Some("`surfels.colour.lobes` has shape [12, 3], expected [12, 6]")),
            (lobes([6, 6], &spoilt), Some("`surfels.colour.lobes` is not finite at row 5")),
            (save_bytes(&good, |_| {}, GAUSSIAN_LOBES[0]), Some("`gaussians.colour.lobe_counts` is missing")),
            (save_bytes(&good, |_| {}, GAUSSIAN_LOBES[1]), Some("`gaussians.colour.lobes` is missing")),
        ] {
            let found = read_back(&bytes).err().map(|error| error.to_string());
            match expected {
                Some(expected) => {
                    assert!(found.as_ref().is_some_and(|e| e.contains(expected)), "{found:?}: {expected}")
                }
                None => assert_eq!(found, None),
            }
        }
    }
}
