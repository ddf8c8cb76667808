//! Results of a forward kernel that its way back needs again.

use std::any::Any;
use std::sync::{Arc, OnceLock};

/// A place for what a kernel keeps, if there is a backward pass. Kernels that compute it again leave it empty. Clones share the place.
#[derive(Clone, Debug, Default)]
pub struct Kept(Option<Arc<OnceLock<Arc<dyn Any + Send + Sync>>>>);

impl Kept {
    /// A place for an operation on the tape; [`Kept::default`] is none.
    pub fn wanted() -> Self {
        Self(Some(Arc::default()))
    }

    /// Keeps `value`, if it is wanted.
    pub fn put<V: Any + Send + Sync>(&self, value: V) {
        if let Some(place) = &self.0 {
            // a second forward pass of the same operation has the same value
            let _ = place.set(Arc::new(value));
        }
    }

    /// Returns the kept value. Calls `make` if no value of type V was kept.
    pub fn get_or<V: Any + Send + Sync>(&self, make: impl FnOnce() -> V) -> Arc<V> {
        let kept = self.0.as_ref().and_then(|place| Arc::clone(place.get()?).downcast().ok());
        kept.unwrap_or_else(|| Arc::new(make()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_wanted_is_kept() {
        let (nowhere, place) = (Kept::default(), Kept::wanted());
        nowhere.put(7_u32);
        assert_eq!(*nowhere.get_or(|| 1_u32), 1);
        assert_eq!(*place.get_or(|| 1_u32), 1);
        place.clone().put(7_u32);
        assert_eq!(*place.get_or(|| 1_u32), 7);
        assert_eq!(*place.get_or(|| 1.0_f32), 1.0, "of another type");
    }
}
