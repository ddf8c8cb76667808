//! The numbers of a network, and the file that holds them.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use safetensors::{Dtype, SafeTensors};

use super::network::{Network, TensorShape};

/// Version of the linear layers: those for scaled pictures.
const VERSION: &str = "0.1";
const ADVICE: &str = "tools/lpips_weights.py makes such files, see docs/guide/measure.md";

/// Why a network cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LpipsError {
    #[error("cannot read the LPIPS network {path}: {source}; {ADVICE}")]
    Io { path: PathBuf, source: std::io::Error },
    #[error("the LPIPS network {path} cannot be used: {reason}; {ADVICE}")]
    Content { path: PathBuf, reason: String },
}

/// The numbers of a network and of its linear layers.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    pub network: Network,
    /// By name; [`Network::tensors`] has their shapes.
    values: BTreeMap<String, Vec<f32>>,
}

impl Weights {
    /// The weights that `of` makes for every tensor, asked in the order of [`Network::tensors`].
    pub fn new(network: Network, mut of: impl FnMut(&TensorShape) -> Vec<f32>) -> Self {
        Self::try_new(network, |tensor| Ok(of(tensor))).expect("no tensor is refused")
    }

    /// Reads a file in the format of `docs/guide/measure.md`: safetensors with the metadata `network` and `version`, and the
    /// tensors of [`Network::tensors`] in f32, and no others.
    ///
    /// # Errors
    /// [`LpipsError`], which names the file and the tensor.
    pub fn load(path: &Path) -> Result<Self, LpipsError> {
        let bytes = std::fs::read(path).map_err(|source| LpipsError::Io { path: path.to_owned(), source })?;
        Self::read(&bytes).map_err(|reason| LpipsError::Content { path: path.to_owned(), reason })
    }

    fn read(bytes: &[u8]) -> Result<Self, String> {
        let unreadable = |error| format!("it is no safetensors file ({error})");
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(unreadable)?;
        let file = SafeTensors::deserialize(bytes).map_err(unreadable)?;
        let network = network(header.metadata().as_ref())?;
        let expected = network.tensors();
        let mut names = file.names();
        names.sort_unstable();
        if let Some(other) = names.into_iter().find(|name| !expected.iter().any(|tensor| tensor.name == *name)) {
            return Err(format!("tensor `{other}` is not one of network `{network}`"));
        }
        Self::try_new(network, |TensorShape { name, shape }| {
            let tensor = file.tensor(name).map_err(|_| format!("tensor `{name}` of network `{network}` is missing"))?;
            if tensor.shape() != shape {
                let found = tensor.shape();
                return Err(format!("tensor `{name}` has shape {found:?}, and {shape:?} in network `{network}`"));
            }
            if tensor.dtype() != Dtype::F32 {
                return Err(format!("tensor `{name}` has elements of type {:?}, expected F32", tensor.dtype()));
            }
            let values: Vec<f32> = tensor.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
            match values.iter().position(|value| !value.is_finite()) {
                Some(at) => Err(format!("tensor `{name}` holds {} at {at}, expected finite numbers", values[at])),
                None => Ok(values),
            }
        })
    }

    fn try_new(network: Network, mut of: impl FnMut(&TensorShape) -> Result<Vec<f32>, String>) -> Result<Self, String> {
        let tensors = network.tensors().into_iter().map(|tensor| {
            let values = of(&tensor)?;
            assert_eq!(values.len(), tensor.shape.iter().product::<usize>(), "{}", tensor.name);
            Ok((tensor.name, values))
        });
        Ok(Self { network, values: tensors.collect::<Result<_, String>>()? })
    }

    /// The values of the tensor `name`, row-major.
    ///
    /// # Panics
    /// If the network has no such tensor.
    pub(super) fn values(&self, name: &str) -> &[f32] {
        &self.values[name]
    }
}

/// The network that the metadata of a file names.
fn network(metadata: Option<&HashMap<String, String>>) -> Result<Network, String> {
    let of = |key: &str| metadata.and_then(|metadata| metadata.get(key)).map(String::as_str);
    let known = Network::ALL.map(Network::name).join("`, `");
    let network = match of("network") {
        Some(name) => Network::ALL
            .into_iter()
            .find(|network| network.name() == name)
            .ok_or_else(|| format!("its network is `{name}`, expected one of `{known}`"))?,
        None => return Err(format!("its metadata has no `network`, expected one of `{known}`")),
    };
    match of("version") {
        Some(VERSION) => Ok(network),
        found => Err(format!("its version of LPIPS is `{}`, expected `{VERSION}`", found.unwrap_or("unknown"))),
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::container::serialize;
    use safetensors::tensor::TensorView;

    use super::*;

    type Tensors = Vec<(String, Dtype, Vec<usize>, Vec<u8>)>;

    fn tensors() -> Tensors {
        let zeros = |tensor: TensorShape| {
            let bytes = vec![0; 4 * tensor.shape.iter().product::<usize>()];
            (tensor.name, Dtype::F32, tensor.shape, bytes)
        };
        Network::Alex.tensors().into_iter().map(zeros).collect()
    }

    fn read(tensors: &Tensors, metadata: &[(&str, &str)]) -> Result<Weights, String> {
        let views = tensors
            .iter()
            .map(|(name, dtype, shape, bytes)| (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).unwrap()));
        let metadata = metadata.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect();
        Weights::read(&serialize(views, metadata).unwrap())
    }

    const METADATA: [(&str, &str); 2] = [("network", "alex"), ("version", "0.1")];

    #[test]
    fn a_file_is_read() {
        let mut tensors = tensors();
        tensors[1].3[..4].copy_from_slice(&1.5f32.to_le_bytes());
        let weights = read(&tensors, &METADATA).unwrap();
        assert_eq!((weights.network, weights.values("features.0.bias")[0]), (Network::Alex, 1.5));
        let same = Weights::new(Network::Alex, |tensor| {
            let mut values = vec![0.0; tensor.shape.iter().product()];
            if tensor.name == "features.0.bias" {
                values[0] = 1.5;
            }
            values
        });
        assert_eq!(weights, same);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let refused = |change: &dyn Fn(&mut Tensors)| {
            let mut tensors = tensors();
            change(&mut tensors);
            read(&tensors, &METADATA).unwrap_err()
        };
        let missing = refused(&|tensors| drop(tensors.remove(2)));
        assert_eq!(missing, "tensor `features.3.weight` of network `alex` is missing");
        let shape = refused(&|tensors| tensors[1].2 = vec![8, 8]);
        assert_eq!(shape, "tensor `features.0.bias` has shape [8, 8], and [64] in network `alex`");
        let dtype = refused(&|tensors| tensors[1].1 = Dtype::I32);
        assert!(dtype.contains("`features.0.bias` has elements of type I32"), "{dtype}");
        let other = refused(&|tensors| tensors.push(("classifier.1.bias".to_owned(), Dtype::F32, vec![1], vec![0; 4])));
        assert_eq!(other, "tensor `classifier.1.bias` is not one of network `alex`");
        let nan = refused(&|tensors| tensors[1].3[4..8].copy_from_slice(&f32::NAN.to_le_bytes()));
        assert!(nan.contains("`features.0.bias` holds NaN at 1"), "{nan}");

        let described = |metadata: &[(&str, &str)]| read(&tensors(), metadata).unwrap_err();
        assert!(described(&[]).contains("no `network`, expected one of `alex`, `vgg`"));
        assert!(described(&[("network", "squeeze"), ("version", "0.1")]).contains("its network is `squeeze`"));
        assert!(described(&[("network", "alex"), ("version", "0.0")]).contains("`0.0`, expected `0.1`"));
        assert!(described(&[("network", "alex")]).contains("`unknown`"));
        assert!(described(&[("network", "vgg"), ("version", "0.1")]).contains("network `vgg`"), "of another network");
    }

    #[test]
    fn files_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("alex.safetensors");
        let absent = Weights::load(&path).unwrap_err().to_string();
        std::fs::write(&path, "no tensors").unwrap();
        let broken = Weights::load(&path).unwrap_err().to_string();
        for message in [absent, broken] {
            assert!(message.contains("alex.safetensors") && message.contains("lpips_weights.py"), "{message}");
        }
    }
}
