//! Safetensors files whose bytes depend on nothing but their content.

use std::collections::{BTreeMap, HashMap};

use safetensors::{SafeTensorError, View};
use serde_json::Value;

/// Like [`safetensors::serialize`], with the entries of the header in alphabetical order: the library writes metadata
/// in the order of a hash map, which differs from process to process.
///
/// # Errors
/// The errors of [`safetensors::serialize`].
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

#[cfg(test)]
mod tests {
    use safetensors::tensor::TensorView;
    use safetensors::{Dtype, SafeTensors};

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
