//! The ranks of the job that this process belongs to: started by `mpirun` or `srun`, or alone.

#[cfg(feature = "mpi")]
mod mpi;

use std::sync::Arc;

use dpges_core::ranks::{Alone, Ranks};

use super::DeviceName;
#[cfg(feature = "gpu")]
use super::adapter_name::AdapterName;

/// Variables with the number of a process and their count: of Open MPI, of MPICH, of Slurm.
const LAUNCHERS: [[&str; 2]; 3] = [
    ["OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"],
    ["PMI_RANK", "PMI_SIZE"],
    ["SLURM_PROCID", "SLURM_STEP_NUM_TASKS"],
];

/// A process of a job, by its environment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Launched {
    pub rank: usize,
    pub count: usize,
}

/// Why a process cannot be a rank of its job.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    #[error(
        "this is process {rank} of {count} that an MPI launcher has started, and this dpges was built without MPI: build it \
         with `cargo build --release -p dpges --features mpi`, or start it without `mpirun`"
    )]
    NoMpi { rank: usize, count: usize },
    #[error(
        "the launcher has started {count} processes, and MPI finds {found}: start dpges with the `mpirun` of the MPI library \
         that it was built with"
    )]
    OtherMpi { count: usize, found: usize },
}

/// The job of this process. MPI ends with it.
pub struct Job {
    pub ranks: Arc<dyn Ranks>,
    /// Number of this rank among those on the same machine; `None` of a rank alone.
    local: Option<usize>,
    #[cfg(feature = "mpi")]
    _mpi: Option<mpi::Session>,
}

/// The number of this process and their count, as the launcher has put them into the environment; `None` of a process alone.
pub fn launched() -> Option<Launched> {
    let number = |name: &str| std::env::var(name).ok()?.parse::<usize>().ok();
    let by = |[rank, count]: [&str; 2]| Some(Launched { rank: number(rank)?, count: number(count)? });
    LAUNCHERS.into_iter().find_map(by).filter(|launched| launched.count > 1)
}

impl Job {
    /// Joins the job; once in a process.
    ///
    /// # Errors
    /// [`JobError`] says what to do.
    pub fn join() -> Result<Self, JobError> {
        match launched() {
            None => Ok(Self {
                ranks: Arc::new(Alone),
                local: None,
                #[cfg(feature = "mpi")]
                _mpi: None,
            }),
            Some(launched) => Self::of(launched),
        }
    }

    #[cfg(feature = "mpi")]
    fn of(Launched { count, .. }: Launched) -> Result<Self, JobError> {
        let session = mpi::Session::start();
        let ranks: Arc<dyn Ranks> = Arc::new(session.ranks());
        if ranks.count() != count {
            return Err(JobError::OtherMpi { count, found: ranks.count() });
        }
        Ok(Self { ranks, local: Some(session.local_rank()), _mpi: Some(session) })
    }

    #[cfg(not(feature = "mpi"))]
    fn of(Launched { rank, count }: Launched) -> Result<Self, JobError> {
        Err(JobError::NoMpi { rank, count })
    }

    /// The device of this rank where the job runs on `device`: among those on one machine every rank has an adapter of its own.
    /// An adapter whose number somebody has `named` is that of all.
    pub fn device(&self, device: DeviceName, named: bool) -> DeviceName {
        match (self.local, device) {
            #[cfg(feature = "gpu")]
            (Some(local), DeviceName::Gpu(name)) => DeviceName::Gpu(of_local(name, local, named)),
            _ => device,
        }
    }

    /// Ends the processes of all ranks with `code`, if there are others.
    pub fn end_others(&self, code: u8) {
        if !self.ranks.is_alone() {
            #[cfg(feature = "mpi")]
            mpi::Session::abort(code);
            #[cfg(not(feature = "mpi"))]
            unreachable!("there are no other ranks without MPI, exit code {code}");
        }
    }
}

#[cfg(feature = "gpu")]
fn of_local(name: AdapterName, local: usize, named: bool) -> AdapterName {
    match name {
        AdapterName::Best => AdapterName::Number(local),
        AdapterName::OfKind(kind) => AdapterName::NumberOfKind(kind, local),
        AdapterName::Number(_) if !named => AdapterName::Number(local),
        AdapterName::NumberOfKind(kind, _) if !named => AdapterName::NumberOfKind(kind, local),
        AdapterName::Number(_) | AdapterName::NumberOfKind(..) | AdapterName::OfApi(_) => name,
    }
}

#[cfg(all(test, feature = "gpu"))]
mod tests {
    use super::*;

    #[test]
    fn ranks_of_a_machine_have_adapters_of_their_own() {
        let of = |text: &str, named| of_local(AdapterName::parse(text).unwrap(), 2, named).to_string();
        for (asked, automatic, named) in [
            ("wgpu", "wgpu:2", "wgpu:2"),
            ("wgpu:0", "wgpu:2", "wgpu:0"),
            ("discrete", "discrete:2", "discrete:2"),
            ("discrete:1", "discrete:2", "discrete:1"),
            ("vulkan", "vulkan", "vulkan"),
        ] {
            assert_eq!((of(asked, false).as_str(), of(asked, true).as_str()), (automatic, named), "{asked}");
        }
    }
}
