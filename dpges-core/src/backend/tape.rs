//! Operations on Burn's tape.

use std::fmt::Debug;
use std::marker::PhantomData;

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend};

use super::kept::Kept;

/// The state that a node of the tape with N parents keeps for the way back.
pub trait WayBack<B: Backend, const N: usize>: Clone + Debug + Send + 'static {
    /// Makes the gradients of the parents from that of the node; `None` where nothing reaches a parent.
    fn go_back(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; N];
}

#[derive(Debug)]
struct Node<W>(PhantomData<W>);

impl<B: Backend, W: WayBack<B, N>, const N: usize> Backward<B, N> for Node<W> {
    type State = W;

    fn backward(self, ops: Ops<W, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let of_parents = ops.state.go_back(grad);
        for (parent, grad) in ops.parents.into_iter().zip(of_parents) {
            if let (Some(parent), Some(grad)) = (parent, grad) {
                grads.register::<B>(parent.id, grad);
            }
        }
    }
}

/// A node with the output of `forward`, which may keep something if there is a way back.
pub fn on_tape<B: Backend, S: CheckpointStrategy, W: WayBack<B, N>, const N: usize>(
    parents: [NodeGuard; N],
    forward: impl FnOnce(Kept) -> (FloatTensor<B>, W),
) -> FloatTensor<Autodiff<B, S>> {
    match Backward::<B, N>::prepare::<S>(Node::<W>(PhantomData), parents).compute_bound().stateful() {
        OpsKind::Tracked(prep) => {
            let (output, state) = forward(Kept::wanted());
            prep.finish(state, output)
        }
        OpsKind::UnTracked(prep) => prep.finish(forward(Kept::default()).0),
    }
}
