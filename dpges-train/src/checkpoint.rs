//! Everything a run needs to go on as if it had never stopped, in one safetensors file.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use dpges_core::atomic::write_atomically;
use dpges_core::scene::SceneInfo;
use dpges_core::tensor_file;
use rand_chacha::ChaCha8Rng;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

use crate::config::Config;
use crate::optimizer::AttributeRows;
use crate::refine::growth::Growth;
use crate::trainer::Validation;

const FORMAT: &str = "dpges-checkpoint";
const VERSION: &str = "2";
/// What the names of columns begin with in the file.
const COLUMN: &str = "column/";

#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    #[error("cannot read checkpoint {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    #[error("checkpoint {path} is not usable: {reason}; start again without --resume, or from a copy that is whole")]
    Content { path: PathBuf, reason: String },
    #[error(transparent)]
    Write(#[from] dpges_core::Error),
}

/// State of a run that is not made of rows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    pub config: Config,
    pub info: SceneInfo,
    pub completed_steps: usize,
    /// Index of the stage in the plan of the configuration.
    pub stage: usize,
    pub validation: Validation,
    pub growth: Option<Growth>,
    pub rng: ChaCha8Rng,
    /// Training views still to come in this pass, last first.
    pub remaining_views: Vec<u32>,
    /// Names of all training views: a run goes on only with the dataset it began with.
    pub view_names: Vec<String>,
}

/// A run between two steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    pub progress: Progress,
    /// Attributes by name, with their moments.
    pub attributes: HashMap<String, AttributeRows>,
    /// Further numbers by name: margins, running statistics, results of earlier stages.
    pub columns: BTreeMap<String, Vec<f32>>,
    /// `[N]` most pixels at which each surfel was the nearest in one view since the last pruning.
    pub max_pixels: Vec<u32>,
}

impl Checkpoint {
    pub fn config(&self) -> &Config {
        &self.progress.config
    }

    pub fn completed_steps(&self) -> usize {
        self.progress.completed_steps
    }

    /// Whether it was made between two stages, or at the end.
    pub fn stage_is_over(&self) -> bool {
        let stage = self.config().plan().get(self.progress.stage).copied();
        self.progress.validation.stopped() || stage.is_none_or(|stage| self.completed_steps() >= stage.end())
    }

    /// Writes the file at once or not at all.
    ///
    /// # Errors
    /// [`CheckpointError::Write`] if the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), CheckpointError> {
        let mut arrays: Vec<(String, [usize; 2], Vec<u8>)> = Vec::new();
        let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let mut names: Vec<&String> = self.attributes.keys().collect();
        names.sort();
        for name in names {
            let rows = &self.attributes[name];
            let shape = [rows.count, rows.width];
            let parts = [("value", &rows.value), ("moment_1", &rows.moments[0]), ("moment_2", &rows.moments[1])];
            arrays.extend(parts.map(|(part, values)| (format!("{name}/{part}"), shape, bytes(values))));
        }
        let columns = self.columns.iter();
        arrays.extend(columns.map(|(name, values)| (format!("{COLUMN}{name}"), [values.len(), 1], bytes(values))));
        let pixels = self.max_pixels.iter().flat_map(|v| v.to_le_bytes()).collect();
        arrays.push(("max_pixels".into(), [self.max_pixels.len(), 1], pixels));
        let views = arrays.iter().map(|(name, shape, bytes)| {
            let dtype = if name == "max_pixels" { Dtype::U32 } else { Dtype::F32 };
            (name.as_str(), TensorView::new(dtype, shape.to_vec(), bytes).expect("bytes fit the shape"))
        });
        let progress = serde_json::to_string(&self.progress).expect("progress is plain data");
        let metadata = HashMap::from(
            [("format", FORMAT), ("version", VERSION), ("progress", progress.as_str())]
                .map(|(key, value)| (key.to_owned(), value.to_owned())),
        );
        let file = tensor_file::serialize(views, metadata).expect("names are unique");
        Ok(write_atomically(path, |out| std::io::Write::write_all(out, &file))?)
    }

    /// # Errors
    /// [`CheckpointError`] naming the file and what is wrong with it.
    pub fn load(path: &Path) -> Result<Self, CheckpointError> {
        let bytes = std::fs::read(path).map_err(|source| CheckpointError::Read { path: path.to_owned(), source })?;
        parse(&bytes).map_err(|reason| CheckpointError::Content { path: path.to_owned(), reason })
    }
}

fn parse(bytes: &[u8]) -> Result<Checkpoint, String> {
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| format!("not a whole safetensors file ({e})"))?;
    let metadata = header.metadata().clone().unwrap_or_default();
    let text = |key: &str| metadata.get(key).map(String::as_str).unwrap_or("nothing");
    if (text("format"), text("version")) != (FORMAT, VERSION) {
        let (format, version) = (text("format"), text("version"));
        return Err(format!("format {format} version {version} found, {FORMAT} version {VERSION} expected"));
    }
    let progress: Progress = serde_json::from_str(text("progress")).map_err(|e| format!("progress: {e}"))?;
    let file = SafeTensors::deserialize(bytes).map_err(|e| format!("not a whole safetensors file ({e})"))?;
    let words = |name: &str| -> Result<([usize; 2], Vec<[u8; 4]>), String> {
        let view = file.tensor(name).map_err(|_| format!("tensor `{name}` is missing"))?;
        let shape = <[usize; 2]>::try_from(view.shape())
            .map_err(|_| format!("tensor `{name}` has shape {:?}", view.shape()))?;
        Ok((shape, view.data().as_chunks().0.to_vec()))
    };
    let floats = |name: &str| -> Result<([usize; 2], Vec<f32>), String> {
        let (shape, words) = words(name)?;
        let values: Vec<f32> = words.into_iter().map(f32::from_le_bytes).collect();
        match values.iter().find(|value| !value.is_finite()) {
            Some(value) => Err(format!("tensor `{name}` holds {value}")),
            None => Ok((shape, values)),
        }
    };
    let mut attributes = HashMap::new();
    for name in file.names().into_iter().filter_map(|name| name.strip_suffix("/value")) {
        let ([count, width], value) = floats(&format!("{name}/value"))?;
        let (first, moment_1) = floats(&format!("{name}/moment_1"))?;
        let (second, moment_2) = floats(&format!("{name}/moment_2"))?;
        if first != [count, width] || second != [count, width] {
            return Err(format!("moments of `{name}` do not fit its values"));
        }
        attributes.insert(name.to_owned(), AttributeRows { count, width, value, moments: [moment_1, moment_2] });
    }
    let mut columns = BTreeMap::new();
    for name in file.names().into_iter().filter_map(|name| name.strip_prefix(COLUMN)) {
        columns.insert(name.to_owned(), floats(&format!("{COLUMN}{name}"))?.1);
    }
    Ok(Checkpoint {
        progress,
        attributes,
        columns,
        max_pixels: words("max_pixels")?.1.into_iter().map(u32::from_le_bytes).collect(),
    })
}
