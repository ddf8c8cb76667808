//! Reads from a device that go on while the host does something else.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};

use burn::tensor::{Tensor, TensorData, read_sync};

/// A transfer from a device. Dropping it waits for its arrival: CubeCL reuses the memory of the transfer whether or not
/// it has finished.
pub struct Readback<T>(Option<State<T>>);

enum State<T> {
    Begun(Pin<Box<dyn Future<Output = T> + Send>>),
    Arrived(T),
}

impl<T> Readback<T> {
    /// Begins `read`.
    pub fn begin(read: impl Future<Output = T> + Send + 'static) -> Self {
        let mut read: Pin<Box<dyn Future<Output = T> + Send>> = Box::pin(read);
        // a future begins when it is first polled
        match read.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(found) => Self(Some(State::Arrived(found))),
            Poll::Pending => Self(Some(State::Begun(read))),
        }
    }

    /// Whether it arrived as it began, as it does on a CPU.
    pub fn has_arrived(&self) -> bool {
        matches!(self.0, Some(State::Arrived(_)))
    }

    /// Waits until it has arrived.
    pub fn arrived(mut self) -> T {
        match self.0.take().expect("it is taken once") {
            State::Begun(read) => read_sync(read),
            State::Arrived(found) => found,
        }
    }
}

impl<T> Drop for Readback<T> {
    fn drop(&mut self) {
        if let Some(State::Begun(read)) = self.0.take() {
            read_sync(read);
        }
    }
}

/// Begins to read `numbers`, `[n]` each, which arrive together, one after the other. They do not wait for what is handed to the
/// device afterwards, as those of Burn's `into_data_async` do: on a GPU it begins to read when its data is first looked at. The
/// error is the device's message.
pub fn begin_readback(numbers: Vec<Tensor<1>>) -> Readback<Result<TensorData, String>> {
    #[cfg(feature = "gpu")]
    if let Some(readback) = on_a_gpu::begin_readback(&numbers) {
        return readback;
    }
    Readback::begin(async {
        let mut found: Vec<f32> = Vec::new();
        for tensor in numbers {
            found.extend(tensor.into_data_async().await.map_err(|error| error.to_string())?.iter::<f32>());
        }
        let count = found.len();
        Ok(TensorData::new(found, [count]))
    })
}

#[cfg(feature = "gpu")]
mod on_a_gpu {
    use burn::backend::{BackendTensor, DispatchTensorKind, TensorMetadata};
    use burn::tensor::{Tensor, TensorData};
    use burn_cubecl::tensor::CubeTensor;

    use super::Readback;
    use crate::gpu::launch::floats;

    /// `None` if `numbers` are on no GPU, or on a tape.
    pub fn begin_readback(numbers: &[Tensor<1>]) -> Option<Readback<Result<TensorData, String>>> {
        let on_a_gpu = |numbers: &Tensor<1>| match numbers.clone().into_dispatch().kind {
            DispatchTensorKind::Cube(BackendTensor::Float(numbers)) => Some(floats(numbers)),
            _ => None,
        };
        let numbers: Vec<CubeTensor> = numbers.iter().map(on_a_gpu).collect::<Option<_>>()?;
        let client = numbers.first()?.client.clone();
        Some(Readback::begin(async move {
            let read = client.read_async(numbers.iter().map(|tensor| tensor.handle.clone()).collect()).await;
            let mut found: Vec<f32> = Vec::new();
            for (bytes, tensor) in read.map_err(|error| error.to_string())?.iter().zip(&numbers) {
                let values = bytes.chunks_exact(size_of::<f32>()).map(bytemuck::pod_read_unaligned::<f32>);
                found.extend(values.take(tensor.shape().num_elements()));
            }
            let count = found.len();
            Ok(TensorData::new(found, [count]))
        }))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Sender, channel};

    use super::*;

    /// Arrives when it is asked for the third time, and tells `asked` the number each time.
    fn slow(asked: Sender<u32>) -> Readback<u32> {
        let mut times = 0;
        Readback::begin(std::future::poll_fn(move |context| {
            times += 1;
            asked.send(times).unwrap();
            context.waker().wake_by_ref();
            if times == 3 { Poll::Ready(times) } else { Poll::Pending }
        }))
    }

    #[test]
    fn a_read_begins_at_once_and_arrives_later() {
        let there = Readback::begin(async { 3 });
        assert!(there.has_arrived());
        assert_eq!(there.arrived(), 3);
        let (sender, asked) = channel();
        let later = slow(sender);
        assert_eq!(asked.try_iter().collect::<Vec<_>>(), [1]);
        assert!(!later.has_arrived());
        assert_eq!(later.arrived(), 3);
    }

    #[test]
    fn what_nobody_wants_any_more_arrives_nevertheless() {
        let (sender, asked) = channel();
        drop(slow(sender));
        assert_eq!(asked.try_iter().collect::<Vec<_>>(), [1, 2, 3]);
    }

    #[cfg(any(feature = "ndarray", feature = "flex"))]
    #[test]
    fn numbers_of_a_cpu_are_there() {
        let numbers = |values: &[f32]| Tensor::<1>::from_data(values, &crate::backend::device::cpu());
        let readback = begin_readback(vec![numbers(&[1.5, -2.0]), numbers(&[3.0])]);
        assert!(readback.has_arrived());
        assert_eq!(readback.arrived().unwrap().iter::<f32>().collect::<Vec<_>>(), [1.5, -2.0, 3.0]);
    }
}
