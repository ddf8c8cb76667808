//! From bytes and folders to an index and its cells.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use super::{INDEX, Index, Part};
use crate::error::{Error, Result};
use crate::scene::SceneData;

impl Index {
    /// Reads `bytes` of an index; errors name it `name`.
    ///
    /// # Errors
    /// [`Error::SceneFile`] if it is no index, of another version, or says what cannot be.
    pub fn from_bytes(bytes: &[u8], name: &str) -> Result<Self> {
        let wrong = |reason: String| Error::SceneFile {
            path: name.into(),
            reason: format!("not the index of a scene in levels of detail: {reason}; export it again"),
        };
        let index: Self = serde_json::from_slice(bytes).map_err(|error| wrong(error.to_string()))?;
        index.check().map_err(wrong)?;
        Ok(Self { place: Path::new(name).parent().unwrap_or(Path::new("")).to_owned(), ..index })
    }

    /// Reads the index of `folder`, and looks whether its files are there and long enough.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file that cannot be read, those of [`from_bytes`](Self::from_bytes), and
    /// [`Error::SceneFile`] naming the file that is too short.
    pub fn open(folder: &Path) -> Result<Self> {
        let path = folder.join(INDEX);
        let bytes = std::fs::read(&path).map_err(unreadable(&path))?;
        let index = Self::from_bytes(&bytes, &path.to_string_lossy())?;
        let mut files: Vec<(&str, u64)> = Vec::new();
        for part in index.parts() {
            let end = part.offset + part.bytes;
            match files.iter_mut().find(|(name, _)| *name == part.file) {
                Some((_, most)) => *most = end.max(*most),
                None => files.push((&part.file, end)),
            }
        }
        for (name, needed) in files {
            let path = folder.join(name);
            let found = std::fs::metadata(&path).map_err(unreadable(&path))?.len();
            if found < needed {
                let reason = format!("has {found} bytes, and the index expects {needed}: copy or export it again");
                return Err(Error::SceneFile { path, reason });
            }
        }
        Ok(index)
    }

    /// The bytes of a part of this index, of `folder`.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file.
    pub fn read_part(folder: &Path, part: &Part) -> Result<Vec<u8>> {
        let path = folder.join(&part.file);
        read_range(&path, part).map_err(unreadable(&path))
    }

    /// The scene of a cell from its `bytes`: only the primitives, the environment is in the sky.
    ///
    /// # Errors
    /// [`Error::SceneFile`] naming the pack file and the cell if it is no scene file, or not the one that the index says.
    ///
    /// # Panics
    /// If there is no such cell.
    pub fn cell(&self, cell: usize, bytes: &[u8]) -> Result<SceneData> {
        let of = &self.cells[cell];
        self.scene(&of.part, bytes, [of.surfels, of.gaussians], &format!("cell {cell}"))
    }

    /// The sky from its `bytes`.
    ///
    /// # Errors
    /// [`Error::SceneFile`] naming the file if it is no scene file, or one with primitives.
    pub fn sky(&self, part: &Part, bytes: &[u8]) -> Result<SceneData> {
        self.scene(part, bytes, [0, 0], "the sky")
    }

    fn scene(&self, part: &Part, bytes: &[u8], expected: [usize; 2], what: &str) -> Result<SceneData> {
        let wrong = |reason: String| Error::SceneFile {
            path: self.place.join(&part.file),
            reason: format!("{what} ({} bytes from {} on): {reason}; copy or export it again", part.bytes, part.offset),
        };
        let scene = SceneData::from_bytes(bytes, &part.file).map_err(|error| match error {
            Error::SceneFile { reason, .. } => wrong(reason),
            other => other,
        })?;
        let found = [scene.surfels.len(), scene.gaussians.len()];
        if found != expected {
            let told = |[surfels, gaussians]: [usize; 2]| format!("{surfels} surfels and {gaussians} Gaussians");
            return Err(wrong(format!("it has {}, the index says {}", told(found), told(expected))));
        }
        if scene.info != self.settings {
            return Err(wrong("its settings are not those of the index".to_owned()));
        }
        Ok(scene)
    }
}

fn unreadable(path: &Path) -> impl FnOnce(io::Error) -> Error {
    move |source| Error::Io { action: "cannot read", path: path.to_owned(), source }
}

fn read_range(path: &Path, part: &Part) -> io::Result<Vec<u8>> {
    let mut file = File::open(path)?;
    file.seek(SeekFrom::Start(part.offset))?;
    let mut bytes = Vec::new();
    file.take(part.bytes).read_to_end(&mut bytes)?;
    if bytes.len() as u64 == part.bytes { Ok(bytes) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
}
