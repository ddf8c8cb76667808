//! Operations on Burn's tape.

use std::fmt::Debug;
use std::marker::PhantomData;
use std::sync::{Arc, Mutex, PoisonError};

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, TensorMetadata};

use super::kept::Kept;

/// The state that a node of the tape with N parents keeps for the backward pass.
pub trait BackwardState<B: Backend, const N: usize>: Clone + Debug + Send + 'static {
    /// Makes the gradients of the parents from that of the node; `None` where nothing reaches a parent.
    fn backward(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; N];
}

#[derive(Debug)]
struct Node<W>(PhantomData<W>);

impl<B: Backend, W: BackwardState<B, N>, const N: usize> Backward<B, N> for Node<W> {
    type State = W;

    fn backward(self, ops: Ops<W, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let of_parents = ops.state.backward(grad);
        for (parent, grad) in ops.parents.into_iter().zip(of_parents) {
            if let (Some(parent), Some(grad)) = (parent, grad) {
                grads.register::<B>(parent.id, grad);
            }
        }
    }
}

/// A node with the output of `forward`, which may keep something if there is a backward pass.
pub fn on_tape<B: Backend, S: CheckpointStrategy, W: BackwardState<B, N>, const N: usize>(
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

/// The state that an operation with M outputs and N parents keeps for the backward pass.
pub trait BackwardOfAll<B: Backend, const N: usize, const M: usize>: Clone + Debug + Send + 'static {
    /// The parents, of which shape, element type and device are needed.
    fn parents(&self) -> [&FloatTensor<B>; N];

    /// Makes the gradients of the parents from those of the outputs, `None` where none arrived; `None` where nothing reaches a
    /// parent.
    fn backward_from(self, grads: [Option<FloatTensor<B>>; M]) -> [Option<FloatTensor<B>>; N];
}

/// The gradients that have arrived for the outputs of a call.
type Arrived<B, const M: usize> = Arc<Mutex<[Option<FloatTensor<B>>; M]>>;

/// Keeps the gradient of an output for the node of the call.
#[derive(Clone, Debug)]
struct Output<B: Backend, const M: usize> {
    number: usize,
    arrived: Arrived<B, M>,
}

impl<B: Backend, const M: usize> BackwardState<B, 1> for Output<B, M> {
    fn backward(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 1] {
        self.arrived.lock().unwrap_or_else(PoisonError::into_inner)[self.number] = Some(grad);
        [None]
    }
}

/// Goes back from all outputs of a call at once.
#[derive(Debug)]
struct Call<W, const M: usize>(PhantomData<W>);

impl<B: Backend, W: BackwardOfAll<B, N, M>, const N: usize, const M: usize> Backward<B, N> for Call<W, M> {
    type State = (W, Arrived<B, M>);

    fn backward(self, ops: Ops<Self::State, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let (state, arrived) = ops.state;
        let none = [const { None }; M];
        let of_outputs = std::mem::replace(&mut *arrived.lock().unwrap_or_else(PoisonError::into_inner), none);
        let likes = state.parents().map(Clone::clone);
        let found = state.backward_from(of_outputs);
        for ((parent, grad), like) in ops.parents.into_iter().zip(found).zip(likes) {
            if let Some(parent) = parent {
                // the tape expects a gradient for all that is on it
                let zeros = || B::float_zeros(like.shape(), &like.device(), like.dtype().into());
                grads.register::<B>(parent.id, grad.unwrap_or_else(zeros));
            }
        }
    }
}

/// Nodes with the `outputs` of one call. They keep the gradients that arrive for them, and have one parent, which goes back
/// from all of them: a loss of several outputs is one way back, not one for each.
pub fn all_on_tape<B: Backend, S: CheckpointStrategy, W: BackwardOfAll<B, N, M>, const N: usize, const M: usize>(
    parents: [NodeGuard; N],
    outputs: [FloatTensor<B>; M],
    state: W,
) -> [FloatTensor<Autodiff<B, S>>; M] {
    let arrived: Arrived<B, M> = Arc::new(Mutex::new([const { None }; M]));
    // its value is of no use, its place on the tape is
    let value = outputs[M - 1].clone();
    let call = match Backward::<B, N>::prepare::<S>(Call::<W, M>(PhantomData), parents).compute_bound().stateful() {
        OpsKind::Tracked(prep) => prep.finish((state, arrived.clone()), value),
        OpsKind::UnTracked(prep) => prep.finish(value),
    };
    let mut number = 0;
    outputs.map(|value| {
        let (node, output) = (call.clone().into_parts().1, Output { number, arrived: arrived.clone() });
        number += 1;
        on_tape::<B, S, _, _>([node], |_| (value, output))
    })
}
