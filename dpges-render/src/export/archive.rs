//! Files in one zip archive, not compressed.

use std::io::{Cursor, Read, Write};

use zip::result::ZipResult;
use zip::write::FileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Every file begins at a multiple of so many bytes, as USDZ asks for.
const ALIGNMENT: u16 = 64;
/// A file that is longer when it is inflated is none of ours, nor of anybody's splats.
const LONGEST: u64 = 1 << 32;

/// The bytes of an archive of files, each a name and its bytes, below 4 GiB together.
pub fn stored<'a>(files: impl IntoIterator<Item = (&'a str, &'a [u8])>) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    let options = FileOptions::default().compression_method(CompressionMethod::Stored);
    let write = || -> ZipResult<Vec<u8>> {
        for (name, bytes) in files {
            writer.start_file_aligned(name, options, ALIGNMENT)?;
            writer.write_all(bytes)?;
        }
        Ok(writer.finish()?.into_inner())
    };
    write().expect("memory takes all that is written")
}

/// Files of an archive, by name.
pub struct Archive<'a>(ZipArchive<Cursor<&'a [u8]>>);

impl<'a> Archive<'a> {
    pub fn new(bytes: &'a [u8]) -> Result<Self, String> {
        ZipArchive::new(Cursor::new(bytes)).map(Self).map_err(|error| format!("it is a damaged zip archive ({error})"))
    }

    /// The bytes of a file.
    pub fn file(&mut self, name: &str) -> Result<Vec<u8>, String> {
        let wrong = |error: String| format!("its file `{name}` cannot be read ({error})");
        let file = self.0.by_name(name).map_err(|error| wrong(error.to_string()))?;
        let mut bytes = Vec::new();
        file.take(LONGEST).read_to_end(&mut bytes).map_err(|error| wrong(error.to_string()))?;
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_stored_aligned_and_come_back() {
        let long: Vec<u8> = (0..=255).cycle().take(777).collect();
        let bytes = stored([("a.usda", &b"#usda 1.0"[..]), ("b.bin", &long), ("empty", &[])]);
        let mut archive = ZipArchive::new(Cursor::new(&bytes)).unwrap();
        for at in 0..3 {
            let file = archive.by_index(at).unwrap();
            assert_eq!((file.compression(), file.data_start() % 64), (CompressionMethod::Stored, 0), "{}", file.name());
        }
        // sizes stand before the data, for readers that go from file to file
        assert_eq!(bytes[18..26], [9, 0, 0, 0, 9, 0, 0, 0]);
        let mut archive = Archive::new(&bytes).unwrap();
        assert_eq!((archive.file("b.bin"), archive.file("empty")), (Ok(long), Ok(Vec::new())));
        assert!(archive.file("c").unwrap_err().contains("`c`"));
        assert!(Archive::new(&bytes[..bytes.len() - 9]).is_err());
        let mut broken = bytes.clone();
        broken[300] ^= 1;
        assert!(Archive::new(&broken).unwrap().file("b.bin").unwrap_err().contains("b.bin"));
    }
}
