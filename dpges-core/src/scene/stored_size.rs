//! Sizes of the parts of a scene file.

use safetensors::SafeTensors;

use super::container::{lobe_names, unreadable};
use super::schema::{Columns, ENVIRONMENT, Width};
use super::{GaussianData, SceneData, SurfelData};
use crate::error::{Error, Result};

impl SceneData {
    /// Bytes of every attribute, and of the environment, in the `bytes` of a scene file, compressed or not; errors name
    /// the file `name`. The header takes what is left.
    ///
    /// # Errors
    /// [`Error::SceneFile`] if it is no safetensors file.
    pub fn stored_sizes(bytes: &[u8], name: &str) -> Result<Vec<(&'static str, usize)>> {
        let wrong = |reason| Error::SceneFile { path: name.into(), reason };
        let file = SafeTensors::deserialize(bytes).map_err(unreadable(bytes)).map_err(wrong)?;
        let size = |name: &str| file.tensor(name).map_or(0, |tensor| tensor.data().len());
        let extra = GaussianData::OPTIONAL.iter().filter(|attribute| file.tensor(attribute.name).is_ok());
        let attributes =
            SurfelData::ATTRIBUTES.iter().chain(GaussianData::ATTRIBUTES).chain(extra).chain([&ENVIRONMENT]);
        let sizes = attributes.map(|attribute| {
            let lobes = if attribute.width == Width::Detail { lobe_names(attribute).map(size).iter().sum() } else { 0 };
            (attribute.name, size(attribute.name) + lobes)
        });
        Ok(sizes.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{ColourModel, EnvironmentData, Quality};
    use crate::testing::scenes::numbered;

    #[test]
    fn every_byte_but_those_of_the_header_is_counted() {
        let scene = numbered(ColourModel::SphericalBeta { lobes: 2 }, [3, 5], |_, _| 0.5);
        let scene = SceneData { environment: Some(EnvironmentData::neutral(1)), ..scene };
        let file = tempfile::NamedTempFile::new().unwrap();
        scene.save(file.path()).unwrap();
        let plain = std::fs::read(file.path()).unwrap();
        let sizes = SceneData::stored_sizes(&plain, "plain").unwrap();
        let size = |name: &str| sizes.iter().find(|(of, _)| *of == name).unwrap().1;
        assert_eq!((size("surfels.positions"), size("gaussians.log_scales"), size("environment")), (36, 60, 48));
        assert_eq!((size("surfels.colour.detail"), size("gaussians.colour.detail")), (3 + 3 * 48, 5 + 5 * 48));
        for bytes in [plain, scene.to_compressed(&Quality::LOW, "small".as_ref()).unwrap()] {
            let (header, _) = SafeTensors::read_metadata(&bytes).unwrap();
            let total: usize = SceneData::stored_sizes(&bytes, "some").unwrap().iter().map(|(_, size)| size).sum();
            assert_eq!(total + size_of::<u64>() + header, bytes.len());
        }
        assert!(SceneData::stored_sizes(b"ply", "some").unwrap_err().to_string().contains("some"));
    }
}
