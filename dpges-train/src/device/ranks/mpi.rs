//! Ranks that are processes of MPI.

use dpges_core::ranks::Ranks;
use mpi::Threading;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives};

/// Bytes that one call sends at most: MPI counts in 32 bits.
const LARGEST_CALL: usize = 1 << 30;

/// MPI in this process, until it is dropped.
pub struct Session(Universe);

/// A process of the job.
#[derive(Clone, Copy, Debug)]
pub struct Process {
    rank: usize,
    count: usize,
}

impl Session {
    pub fn start() -> Self {
        let (universe, _) = mpi::initialize_with_threading(Threading::Serialized).expect("MPI is started once");
        Self(universe)
    }

    pub fn ranks(&self) -> Process {
        let world = self.0.world();
        Process { rank: world.rank() as usize, count: world.size() as usize }
    }

    pub fn local_rank(&self) -> usize {
        let world = self.0.world();
        world.split_shared(world.rank()).rank() as usize
    }

    /// Ends all processes of the job.
    pub fn abort(code: u8) -> ! {
        SimpleCommunicator::world().abort(i32::from(code))
    }
}

impl Ranks for Process {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.count
    }

    /// A reduce-scatter, in which every rank gets its part of all others and adds them up in their order, then an all-gather.
    fn join(&self, sums: &mut [f32]) {
        let world = SimpleCommunicator::world();
        for sums in sums.chunks_mut(LARGEST_CALL / size_of::<f32>()) {
            let part = sums.len().div_ceil(self.count);
            let mut padded = sums.to_vec();
            padded.resize(part * self.count, 0.0);
            let mut of_ranks = vec![0.0f32; part * self.count];
            world.all_to_all_into(&padded[..], &mut of_ranks[..]);
            let mut own = vec![0.0f32; part];
            for found in of_ranks.chunks_exact(part.max(1)) {
                own.iter_mut().zip(found).for_each(|(sum, number)| *sum += number);
            }
            world.all_gather_into(&own[..], &mut padded[..]);
            sums.copy_from_slice(&padded[..sums.len()]);
        }
    }

    fn gather(&self, own: &[u8]) -> Vec<Vec<u8>> {
        let world = SimpleCommunicator::world();
        let mut lengths = vec![0u64; self.count];
        world.all_gather_into(&(own.len() as u64), &mut lengths[..]);
        let longest = lengths.iter().copied().max().unwrap_or(0) as usize;
        let mut of_ranks: Vec<Vec<u8>> = lengths.iter().map(|&length| Vec::with_capacity(length as usize)).collect();
        // all ranks in rounds, since a call counts the bytes of all of them
        let most = LARGEST_CALL / self.count;
        for from in (0..longest).step_by(most) {
            let within = |length: usize| length.clamp(from, from + most) - from;
            let counts: Vec<i32> = lengths.iter().map(|&length| within(length as usize) as i32).collect();
            let starts: Vec<i32> =
                counts.iter().scan(0, |end, count| Some(std::mem::replace(end, *end + count))).collect();
            let mut received = vec![0u8; counts.iter().map(|&count| count as usize).sum()];
            let start = from.min(own.len());
            let part = &own[start..start + within(own.len())];
            world.all_gather_varcount_into(part, &mut PartitionMut::new(&mut received[..], &counts[..], &starts[..]));
            for ((all, &start), &count) in of_ranks.iter_mut().zip(&starts).zip(&counts) {
                all.extend(&received[start as usize..(start + count) as usize]);
            }
        }
        of_ranks
    }
}
