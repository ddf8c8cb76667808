//! The sharded checkpoint of a run on several ranks: a file for each, and a manifest that names them.
//!
//! A rank writes its file; once all have, the first writes the manifest, in which the files before stay named. So a kill at any
//! moment leaves a generation that is whole. The files of rank 0 hold all but the Gaussians of other ranks.

use std::io::Write;
use std::path::{Path, PathBuf};

use dpges_core::Error;
use dpges_core::ranks::Ranks;
use dpges_core::scene::atomic::write_atomically;
use serde::{Deserialize, Serialize};

use super::checkpoint::{Checkpoint, CheckpointError};
use super::folder::{RunFolder, read_json, remove, write_json};
use super::hash::Hash;

/// Checkpoints that are kept.
const GENERATIONS: usize = 2;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Manifest {
    /// The newest first.
    generations: Vec<Generation>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Generation {
    /// One more than that of the generation before.
    number: u64,
    step: usize,
    /// The files of the ranks, in the order of these.
    shards: Vec<Shard>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Shard {
    file: String,
    /// FNV-1a of its bytes, 16 digits.
    hash: String,
}

/// Saves the `checkpoint` of this rank in `folder`, in place of that of another number of ranks. All `ranks` do so together; one
/// alone writes a single file.
pub fn save(checkpoint: Checkpoint, folder: &RunFolder, ranks: &dyn Ranks) -> Result<(), CheckpointError> {
    if ranks.is_alone() {
        checkpoint.save(&folder.checkpoint())?;
        remove(&folder.manifest())?;
        return Ok(remove_others(folder, &Manifest::default())?);
    }
    let mut manifest = if folder.manifest().is_file() { read_json(&folder.manifest())? } else { Manifest::default() };
    let last = manifest.generations.first().map_or(0, |generation| generation.number);
    let number = ranks.gather_numbers(&[last]).concat()[0] + 1;
    let file = |rank: usize| format!("checkpoint_{number:04}_{rank}_of_{}.safetensors", ranks.count());
    let step = checkpoint.completed_steps();
    let part = if ranks.is_first() { checkpoint } else { checkpoint.of_later_rank() };
    let bytes = part.to_bytes();
    write_atomically(&folder.path().join(file(ranks.rank())), |out| out.write_all(&bytes))?;
    // by then every rank has written its own
    let hashes = ranks.gather_numbers(&[Hash::of(&bytes)]).concat();
    if ranks.is_first() {
        let shard = |(rank, hash): (usize, &u64)| Shard { file: file(rank), hash: digits(*hash) };
        let shards = hashes.iter().enumerate().map(shard).collect();
        manifest.generations.insert(0, Generation { number, step, shards });
        manifest.generations.truncate(GENERATIONS);
        write_json(&folder.manifest(), &manifest)?;
        remove(&folder.checkpoint())?;
        remove_others(folder, &manifest)?;
    }
    Ok(())
}

/// The checkpoint in `folder` with the Gaussians of all ranks, whatever their number was.
pub fn load(folder: &RunFolder) -> Result<Checkpoint, CheckpointError> {
    if !folder.manifest().is_file() {
        return Checkpoint::load(&folder.checkpoint());
    }
    let sharded = load_generation(folder);
    if !folder.checkpoint().is_file() {
        return sharded;
    }
    // a kill came between one kind and the removal of the other
    match (Checkpoint::load(&folder.checkpoint()), sharded) {
        (Ok(single), Ok(sharded)) if sharded.completed_steps() > single.completed_steps() => Ok(sharded),
        (Err(_), Ok(sharded)) => Ok(sharded),
        (single, _) => single,
    }
}

/// The newest generation that is whole.
fn load_generation(folder: &RunFolder) -> Result<Checkpoint, CheckpointError> {
    let Manifest { generations } = read_json(&folder.manifest())?;
    let mut wrong = Vec::new();
    for Generation { step, shards, .. } in generations {
        match shards.iter().map(|shard| load_shard(folder.path(), shard)).collect::<Result<Vec<_>, _>>() {
            Ok(parts) => {
                let joined = Checkpoint::join(parts);
                return joined.map_err(|reason| CheckpointError::Content { path: folder.manifest(), reason });
            }
            Err(error) => {
                tracing::warn!("the checkpoint of step {step} is not whole: {error}");
                wrong.push(format!("step {step}: {error}"));
            }
        }
    }
    let reason = format!("no generation is whole: {}", wrong.join("; "));
    Err(CheckpointError::Content { path: folder.manifest(), reason })
}

fn load_shard(folder: &Path, Shard { file, hash }: &Shard) -> Result<Checkpoint, CheckpointError> {
    let path = folder.join(file);
    let bytes = std::fs::read(&path).map_err(|source| CheckpointError::Read { path: path.clone(), source })?;
    let found = digits(Hash::of(&bytes));
    if found != *hash {
        return Err(CheckpointError::Content { path, reason: format!("its hash is {found}, expected {hash}") });
    }
    Checkpoint::from_bytes(&bytes, &path)
}

/// Removes the files of ranks that `manifest` does not name.
fn remove_others(folder: &RunFolder, manifest: &Manifest) -> Result<(), Error> {
    let named: Vec<_> = manifest.generations.iter().flat_map(|generation| &generation.shards).collect();
    let is_named = |path: &PathBuf| named.iter().any(|shard| path.file_name() == Some(shard.file.as_ref()));
    folder.shards().iter().filter(|path| !is_named(path)).try_for_each(|path| remove(path))
}

fn digits(hash: u64) -> String {
    format!("{hash:016x}")
}
