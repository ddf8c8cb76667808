//! The entry of an operation on Burn's tape.

use burn::backend::Backend;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::Ops;
use burn::backend::tensor::FloatTensor;

/// Takes the gradient that arrived at a node, and registers what `backward` makes of it and of the node's state:
/// a gradient for each parent, `None` where nothing reaches it.
pub fn pass_back<B: Backend, S, const N: usize>(
    ops: Ops<S, N>,
    grads: &mut Gradients,
    backward: impl FnOnce(S, FloatTensor<B>) -> [Option<FloatTensor<B>>; N],
) {
    let grad = grads.consume::<B>(&ops.node);
    let of_parents = backward(ops.state, grad);
    for (parent, grad) in ops.parents.into_iter().zip(of_parents) {
        if let (Some(parent), Some(grad)) = (parent, grad) {
            grads.register::<B>(parent.id, grad);
        }
    }
}
