//! Safetensors files: tensors of numbers or bytes by name, whose bytes depend on nothing but their content.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensorError, SafeTensors, View};
use serde_json::Value;

use super::SceneData;
use super::schema::{Attribute, ENVIRONMENT};

/// Like [`safetensors::serialize`], with the entries of the header in alphabetical order: the library writes metadata
/// in the order of a hash map, which differs from process to process.
pub fn serialize<V: View>(
    tensors: impl IntoIterator<Item = (impl AsRef<str> + Ord + std::fmt::Display, V)>,
    metadata: HashMap<String, String>,
) -> Result<Vec<u8>, SafeTensorError> {
    let mut bytes = safetensors::serialize(tensors, Some(metadata))?;
    let (length, rest) = bytes.split_at_mut(size_of::<u64>());
    let length = u64::from_le_bytes(length.try_into().expect("eight bytes")) as usize;
    let header: BTreeMap<String, BTreeMap<String, Value>> = serde_json::from_slice(&rest[..length])?;
    let mut sorted = serde_json::to_vec(&header)?;
    sorted.resize(length, b' ');
    rest[..length].copy_from_slice(&sorted);
    Ok(bytes)
}

/// The file of a scene: `tensors`, the environment where there is one, and metadata.
pub(super) fn scene_file<'a>(
    scene: &'a SceneData,
    mut tensors: Vec<Rows<'a>>,
    [format, version]: [&str; 2],
    more: Option<(&str, String)>,
) -> Result<Vec<u8>, String> {
    tensors.extend(environment(scene));
    let info = serde_json::to_string(&scene.info).map_err(|error| error.to_string())?;
    let own = [("format", format.to_owned()), ("version", version.to_owned()), ("info", info)];
    let metadata = own.into_iter().chain(more).map(|(key, value)| (key.to_owned(), value)).collect();
    serialize(tensors.into_iter().map(|tensor| (tensor.name, tensor)), metadata).map_err(|error| error.to_string())
}

pub(super) fn environment(scene: &SceneData) -> Option<Rows<'_>> {
    let environment = scene.environment.as_ref()?;
    Some(Rows::numbers(ENVIRONMENT.name, vec![environment.len(), 3], &environment.coefficients[..]))
}

/// One tensor of the file: its name, the shape it must have, its values row-major.
pub(super) struct Rows<'a> {
    pub name: &'static str,
    shape: Vec<usize>,
    values: Values<'a>,
}

enum Values<'a> {
    Numbers(Cow<'a, [f32]>),
    Bytes(Vec<u8>),
}

impl View for Rows<'_> {
    fn dtype(&self) -> Dtype {
        match self.values {
            Values::Numbers(_) => Dtype::F32,
            Values::Bytes(_) => Dtype::U8,
        }
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        match &self.values {
            Values::Numbers(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>().into(),
            Values::Bytes(bytes) => bytes.into(),
        }
    }

    fn data_len(&self) -> usize {
        match &self.values {
            Values::Numbers(values) => size_of::<f32>() * values.len(),
            Values::Bytes(bytes) => bytes.len(),
        }
    }
}

impl<'a> Rows<'a> {
    pub fn numbers(name: &'static str, shape: Vec<usize>, values: impl Into<Cow<'a, [f32]>>) -> Self {
        Self { name, shape, values: Values::Numbers(values.into()) }
    }

    pub fn bytes(name: &'static str, bytes: Vec<u8>) -> Self {
        Self { name, shape: vec![bytes.len()], values: Values::Bytes(bytes) }
    }
}

/// Names of the tensors that hold lobes: how many each primitive has, and their numbers.
pub(super) const SURFEL_LOBES: [&str; 2] = ["surfels.colour.lobe_counts", "surfels.colour.lobes"];
pub(super) const GAUSSIAN_LOBES: [&str; 2] = ["gaussians.colour.lobe_counts", "gaussians.colour.lobes"];

/// The tensors that stand in place of `detail`.
pub(super) fn lobe_names(detail: &Attribute) -> [&'static str; 2] {
    if detail.name.starts_with("surfels") { SURFEL_LOBES } else { GAUSSIAN_LOBES }
}

/// Words for a file of `bytes` that safetensors do not read.
pub(super) fn unreadable(bytes: &[u8]) -> impl FnOnce(SafeTensorError) -> String {
    let instead = match bytes.trim_ascii_start() {
        [] => Some("the file is empty: write or fetch it again"),
        text if text.starts_with(b"version https://git-lfs") => {
            Some("a pointer of Git LFS stands in place of the file: `git lfs pull` fetches it")
        }
        [b'<', ..] => Some("a web page stands in place of the file: fetch it again"),
        _ => None,
    };
    move |error| instead.map_or_else(|| format!("not a safetensors file, or truncated: {error}"), str::to_owned)
}

/// The first side of a tensor.
pub(super) fn row_count(file: &SafeTensors, name: &str) -> Result<usize, String> {
    let tensor = file.tensor(name).map_err(|_| format!("tensor `{name}` is missing"))?;
    Ok(tensor.shape().first().copied().unwrap_or(0))
}

pub(super) fn read(file: &SafeTensors, name: &str, shape: &[usize]) -> Result<Vec<f32>, String> {
    let (numbers, _) = bytes(file, name, Dtype::F32, shape)?.as_chunks::<4>();
    Ok(numbers.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect())
}

/// The bytes of a tensor of bytes of any shape.
pub(super) fn payload<'a>(file: &SafeTensors<'a>, name: &str) -> Result<&'a [u8], String> {
    Ok(tensor(file, name, Dtype::U8)?.data())
}

fn tensor<'a>(file: &SafeTensors<'a>, name: &str, dtype: Dtype) -> Result<TensorView<'a>, String> {
    let tensor = file.tensor(name).map_err(|_| format!("tensor `{name}` is missing"))?;
    if tensor.dtype() != dtype {
        return Err(format!("tensor `{name}` has element type {:?}, expected {dtype:?}", tensor.dtype()));
    }
    Ok(tensor)
}

pub(super) fn bytes<'a>(file: &SafeTensors<'a>, name: &str, dtype: Dtype, shape: &[usize]) -> Result<&'a [u8], String> {
    let tensor = tensor(file, name, dtype)?;
    if tensor.shape() != shape {
        return Err(format!("tensor `{name}` has shape {:?}, expected {shape:?}", tensor.shape()));
    }
    Ok(tensor.data())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_content_gives_equal_bytes() {
        let metadata = || ["a", "b", "c", "d"].map(|key| (key.to_owned(), format!("\"{key}\"")));
        let data = [1, 2, 3, 4];
        let tensors = || ["y", "x"].map(|name| (name, TensorView::new(Dtype::U8, vec![2, 2], &data).unwrap()));
        let file = || serialize(tensors(), HashMap::from(metadata())).unwrap();
        let first = file();
        assert!((0..20).all(|_| file() == first));
        assert_eq!(SafeTensors::deserialize(&first).unwrap().tensor("x").unwrap().data(), data);
        let (_, header) = SafeTensors::read_metadata(&first).unwrap();
        assert_eq!(header.metadata().as_ref().unwrap()["c"], "\"c\"");
    }
}
