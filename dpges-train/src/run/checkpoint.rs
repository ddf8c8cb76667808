//! Everything a run needs to [go on](super::Run::resume) as if it had never stopped, in one safetensors file.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use dpges_core::scene::atomic::write_atomically;
use dpges_core::scene::{SceneInfo, container};
use rand_chacha::ChaCha8Rng;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde::{Deserialize, Serialize};

use super::hash::Hash;
use super::validation::Validation;
use crate::config::{Config, StagePlan};
use crate::optimizer::ParameterRows;
use crate::refine::growth::Growth;
use crate::stage::{OWNERS, in_order, is_sharded};

const FORMAT: &str = "dpges-checkpoint";
const VERSION: &str = "6";
/// Key of the [`Hash`] of all numbers in the metadata.
const HASH: &str = "hash";
/// Prefix of the names of columns in the file.
const COLUMN: &str = "column/";
/// Suffixes of the names of an attribute's tensors.
const RAW: &str = "raw";
const MOMENTS: [&str; 2] = ["moment_1", "moment_2"];

/// Why a checkpoint cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    #[error("cannot read checkpoint {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    #[error("checkpoint {path} is not usable: {reason}; start again without --resume, or from a copy that is whole")]
    Content { path: PathBuf, reason: String },
    #[error(transparent)]
    Write(#[from] dpges_core::Error),
}

/// Where a run stands: all of its state but the rows of primitives. The metadata `progress` of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunState {
    pub config: Config,
    pub info: SceneInfo,
    pub completed_steps: usize,
    /// Index of the stage in the [plan](Self::plan).
    pub stage: usize,
    /// Width or height of the largest training view, px, by which the run was planned.
    pub longest_side: usize,
    pub validation: Validation,
    /// Growth decisions of an automatic budget; `None` before the first, and with a fixed budget.
    pub growth: Option<Growth>,
    pub rng: ChaCha8Rng,
    /// Indices of the training views still to come in this pass, last first.
    pub remaining_views: Vec<u32>,
    /// Names of all training views. A run goes on only with the dataset it began with.
    pub view_names: Vec<String>,
    /// Hashes of their cameras as they were recorded.
    pub cameras: Vec<u64>,
}

impl RunState {
    /// The stages of the run in their order.
    pub fn plan(&self) -> Vec<StagePlan> {
        self.config.plan(self.longest_side)
    }
}

/// A run between two steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    pub state: RunState,
    /// Parameters by their raw names, with their moments.
    pub attributes: HashMap<String, ParameterRows>,
    /// Further numbers by name: running statistics, the discs of an earlier stage.
    pub columns: BTreeMap<String, Vec<f32>>,
    /// `[N]` largest number of pixels of one view at which a surfel was the nearest, since the last pruning; empty in
    /// stages without surfels.
    pub max_pixels: Vec<u32>,
}

impl Checkpoint {
    pub fn config(&self) -> &Config {
        &self.state.config
    }

    pub fn completed_steps(&self) -> usize {
        self.state.completed_steps
    }

    /// Whether it was made between two stages or at the end of the run.
    pub fn stage_is_over(&self) -> bool {
        let stage = self.state.plan().get(self.state.stage).copied();
        self.state.validation.stopped() || stage.is_none_or(|stage| self.completed_steps() >= stage.end())
    }

    /// Writes the whole file or nothing.
    ///
    /// # Errors
    /// [`CheckpointError::Write`] if the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), CheckpointError> {
        Ok(write_atomically(path, |out| std::io::Write::write_all(out, &self.to_bytes()))?)
    }

    /// The part of a rank after the first: without what all ranks have alike.
    #[must_use]
    pub fn of_later_rank(mut self) -> Self {
        let has_own = self.columns.contains_key(OWNERS);
        self.attributes.retain(|name, _| has_own && is_sharded(name));
        self.columns.retain(|name, _| has_own && is_sharded(name));
        self.max_pixels = Vec::new();
        self
    }

    /// The checkpoint of the whole scene, from the parts of all ranks in their order.
    ///
    /// # Errors
    /// A message if they do not fit each other.
    pub fn join(mut parts: Vec<Self>) -> Result<Self, String> {
        let first = parts.first().ok_or("there is no part of any rank")?;
        if parts.iter().any(|part| part.state.completed_steps != first.state.completed_steps) {
            return Err("its parts are of different steps".to_owned());
        }
        let Some(owners) = first.columns.get(OWNERS) else { return Ok(parts.remove(0)) };
        let owners: Vec<u16> = owners.iter().map(|&owner| owner as u16).collect();
        // the rows of all ranks, from those `of` each
        let all = |name: &str, width: usize, of: &dyn Fn(&Self) -> Option<Vec<f32>>| {
            let of_ranks: Option<Vec<Vec<f32>>> = parts.iter().map(of).collect();
            let all = of_ranks.and_then(|of_ranks| in_order(&owners, &of_ranks, width));
            all.ok_or_else(|| format!("the parts of `{name}` do not fit each other"))
        };
        let joined = |(name, rows): (&String, &ParameterRows)| {
            let width = rows.width;
            let raw = all(name, width, &|part| Some(part.attributes.get(name)?.raw.clone()))?;
            let moment =
                |at: usize| all(name, width, &|part| Some(part.attributes.get(name)?.moments.as_ref()?[at].clone()));
            let moments = if rows.moments.is_some() { Some([moment(0)?, moment(1)?]) } else { None };
            Ok((name.clone(), ParameterRows { count: owners.len(), width, raw, moments }))
        };
        let attributes = first.attributes.iter().filter(|(name, _)| is_sharded(name)).map(joined);
        let attributes: Vec<_> = attributes.collect::<Result<_, String>>()?;
        let columns = first.columns.keys().filter(|name| is_sharded(name));
        let columns = columns.map(|name| Ok((name.clone(), all(name, 1, &|part| part.columns.get(name).cloned())?)));
        let columns: Vec<_> = columns.collect::<Result<_, String>>()?;
        let mut whole = parts.remove(0);
        whole.attributes.extend(attributes);
        whole.columns.extend(columns);
        Ok(whole)
    }

    /// The bytes of the file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut arrays: Vec<(String, [usize; 2], Vec<u8>)> = Vec::new();
        let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let mut names: Vec<&String> = self.attributes.keys().collect();
        names.sort();
        for name in names {
            let rows = &self.attributes[name];
            let shape = [rows.count, rows.width];
            arrays.push((format!("{name}/{RAW}"), shape, bytes(&rows.raw)));
            for (moment, part) in rows.moments.iter().flatten().zip(MOMENTS) {
                arrays.push((format!("{name}/{part}"), shape, bytes(moment)));
            }
        }
        let columns = self.columns.iter();
        arrays.extend(columns.map(|(name, values)| (format!("{COLUMN}{name}"), [values.len(), 1], bytes(values))));
        let pixels = self.max_pixels.iter().flat_map(|v| v.to_le_bytes()).collect();
        arrays.push(("max_pixels".into(), [self.max_pixels.len(), 1], pixels));
        let views = arrays.iter().map(|(name, shape, bytes)| {
            let dtype = if name == "max_pixels" { Dtype::U32 } else { Dtype::F32 };
            (name.as_str(), TensorView::new(dtype, shape.to_vec(), bytes).expect("bytes fit the shape"))
        });
        let state = serde_json::to_string(&self.state).expect("the state is plain data");
        let hash = hash_of(&state, arrays.iter().map(|(name, _, bytes)| (name.as_str(), &bytes[..])));
        let metadata = HashMap::from(
            [("format", FORMAT), ("version", VERSION), ("progress", state.as_str()), (HASH, hash.as_str())]
                .map(|(key, value)| (key.to_owned(), value.to_owned())),
        );
        container::serialize(views, metadata).expect("names are unique")
    }

    /// Reads a file that [`save`](Self::save) has written.
    ///
    /// # Errors
    /// [`CheckpointError`] names the file and what is wrong with it.
    pub fn load(path: &Path) -> Result<Self, CheckpointError> {
        let bytes = std::fs::read(path).map_err(|source| CheckpointError::Read { path: path.to_owned(), source })?;
        Self::from_bytes(&bytes, path)
    }

    /// From the bytes of the file at `path`.
    ///
    /// # Errors
    /// [`CheckpointError::Content`] says what is wrong with them.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, CheckpointError> {
        parse(bytes).map_err(|reason| CheckpointError::Content { path: path.to_owned(), reason })
    }
}

/// Of the text `progress`, and of arrays by name in any order.
fn hash_of<'a>(progress: &str, arrays: impl Iterator<Item = (&'a str, &'a [u8])>) -> String {
    let mut arrays: Vec<_> = arrays.collect();
    arrays.sort_unstable();
    let mut hash = Hash::default();
    hash.add(progress.as_bytes());
    for (name, bytes) in arrays {
        hash.add(name.as_bytes());
        hash.add(bytes);
    }
    format!("{:016x}", hash.value())
}

fn parse(bytes: &[u8]) -> Result<Checkpoint, String> {
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| format!("not a whole safetensors file ({e})"))?;
    let metadata = header.metadata().clone().unwrap_or_default();
    let text = |key: &str| metadata.get(key).map(String::as_str).unwrap_or("nothing");
    if (text("format"), text("version")) != (FORMAT, VERSION) {
        let (format, version) = (text("format"), text("version"));
        return Err(format!("format {format} version {version} found, {FORMAT} version {VERSION} expected"));
    }
    let state: RunState = serde_json::from_str(text("progress")).map_err(|e| format!("progress: {e}"))?;
    let file = SafeTensors::deserialize(bytes).map_err(|e| format!("not a whole safetensors file ({e})"))?;
    let arrays = file.tensors();
    if text(HASH) != hash_of(text("progress"), arrays.iter().map(|(name, view)| (name.as_str(), view.data()))) {
        return Err("its numbers are not those that were written: the file is damaged".to_owned());
    }
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
    for name in file.names().into_iter().filter_map(|name| name.strip_suffix("/raw")) {
        let ([count, width], raw) = floats(&format!("{name}/{RAW}"))?;
        let moment = |part: &str| match floats(&format!("{name}/{part}"))? {
            (shape, values) if shape == [count, width] => Ok(values),
            _ => Err(format!("moments of `{name}` do not fit its values")),
        };
        let learns = file.names().contains(&format!("{name}/{}", MOMENTS[0]).as_str());
        let moments = if learns { Some([moment(MOMENTS[0])?, moment(MOMENTS[1])?]) } else { None };
        attributes.insert(name.to_owned(), ParameterRows { count, width, raw, moments });
    }
    let mut columns = BTreeMap::new();
    for name in file.names().into_iter().filter_map(|name| name.strip_prefix(COLUMN)) {
        columns.insert(name.to_owned(), floats(&format!("{COLUMN}{name}"))?.1);
    }
    Ok(Checkpoint {
        state,
        attributes,
        columns,
        max_pixels: words("max_pixels")?.1.into_iter().map(u32::from_le_bytes).collect(),
    })
}
