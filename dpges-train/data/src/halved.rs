//! A dataset at half of its resolution, which is learnt from in less time.

use rayon::prelude::*;

use super::{Dataset, View};

impl Dataset {
    /// The dataset with training views of half the width and height, rounded up. The others stay as they are, and those of which
    /// no pixel would count.
    ///
    /// # Errors
    /// Those of [`View::picture`], of a view with a depth map.
    pub fn halved(&self) -> dpges_core::Result<Self> {
        let train = self.train.par_iter().map(View::halved).collect::<dpges_core::Result<Vec<_>>>()?;
        let bytes =
            train.iter().filter(|view| view.photograph.is_kept()).map(|view| view.photograph.size_bytes()).sum();
        Ok(Self { train, spare_memory: self.spare_memory.saturating_sub(bytes), ..self.clone() })
    }

    /// Width or height of the largest training view, px.
    pub fn longest_side(&self) -> usize {
        self.train.iter().map(|view| view.camera.width.max(view.camera.height)).max().unwrap_or(0)
    }
}

impl View {
    fn halved(&self) -> dpges_core::Result<Self> {
        let [width, height] = [self.camera.width, self.camera.height].map(|side| side.div_ceil(2));
        let camera = self.camera.resized(width, height);
        let photograph = self.photograph.smaller(width, height);
        // a pixel counts if all pixels that it is made of do
        if photograph.ignored_pixels().is_some() && photograph.picture()?.ignored_pixels() == width * height {
            return Ok(self.clone());
        }
        let depth = match &self.depth {
            Some(map) => Some(map.seen_by(&camera, &self.camera, &*photograph.picture()?)),
            None => None,
        };
        Ok(Self { camera, photograph, depth, ..self.clone() })
    }
}

#[cfg(test)]
mod tests {
    use crate::{BuiltinOptions, DepthKind, DepthMap, builtin};

    #[test]
    fn training_views_become_smaller_and_no_others() {
        let options = BuiltinOptions { width: 9, height: 6, train_views: 3, test_views: 1, ..Default::default() };
        let mut full = builtin(&options);
        let depths: Vec<f32> = (0..54).map(|pixel| 1.0 + pixel as f32).collect();
        full.train[0].depth = Some(DepthMap::from_depths(DepthKind::Metric, &depths));
        full.spare_memory = 100;
        let half = full.halved().unwrap();
        assert_eq!((full.longest_side(), half.longest_side(), half.test[0].camera.width), (9, 5, 9));
        for (small, large) in half.train.iter().zip(&full.train) {
            let expected = (*large.picture().unwrap()).clone().downscaled(5, 3);
            assert_eq!(*small.picture().unwrap(), expected);
            assert_eq!(small.camera, large.camera.resized(5, 3));
        }
        // three of 45 bytes
        assert_eq!(half.spare_memory, 0);
        let map = half.train[0].depth.as_ref().unwrap();
        // a pixel of the middle takes the depth that lies there
        assert!((map.value(7).unwrap() - f64::from(depths[3 * 9 + 4])).abs() < 0.01, "{:?}", map.value(7));
    }
}
