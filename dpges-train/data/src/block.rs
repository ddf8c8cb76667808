//! A block of a large capture, as the run that trains it reads it: where it lies, which views show it, what is around it.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use dpges_core::Error;
use serde::{Deserialize, Serialize};

use super::{Dataset, View};

/// A box with sides along the axes of the world, in the coordinates of a [`Dataset`]. A side may be open.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// World units, inclusive; `None` where the box has no end.
    pub min: [Option<f32>; 3],
    /// World units, exclusive; `None` where the box has no end.
    pub max: [Option<f32>; 3],
}

impl FromStr for Bounds {
    type Err = String;

    /// Six numbers: the least of each axis, then the largest.
    fn from_str(text: &str) -> Result<Self, String> {
        let parse = |number: &str| number.trim().parse::<f32>().ok().filter(|number| number.is_finite());
        let numbers: Option<Vec<f32>> = text.split(',').map(parse).collect();
        match numbers.as_deref() {
            Some(&[x0, y0, z0, x1, y1, z1]) if x0 < x1 && y0 < y1 && z0 < z1 => {
                Ok(Self { min: [x0, y0, z0].map(Some), max: [x1, y1, z1].map(Some) })
            }
            _ => Err("this is no box: write the least x, y and z, then the largest, as in -1,-1,0,1,1,2".to_owned()),
        }
    }
}

impl Bounds {
    /// The whole world.
    pub const ALL: Self = Self { min: [None; 3], max: [None; 3] };

    pub fn contains(&self, position: [f32; 3]) -> bool {
        (0..3).all(|axis| {
            self.min[axis].is_none_or(|min| position[axis] >= min)
                && self.max[axis].is_none_or(|max| position[axis] < max)
        })
    }

    /// Of `positions` [n × 3], the rows that lie within, ascending.
    pub fn rows_within(&self, positions: &[f32]) -> Vec<usize> {
        let (positions, _) = positions.as_chunks::<3>();
        (0..positions.len()).filter(|&row| self.contains(positions[row])).collect()
    }

    /// The two parts below and from `at` along `axis`.
    pub fn split(&self, axis: usize, at: f32) -> [Self; 2] {
        let (mut below, mut above) = (*self, *self);
        (below.max[axis], above.min[axis]) = (Some(at), Some(at));
        [below, above]
    }

    /// With closed sides moved outwards by `by` along each axis.
    pub fn grown(&self, by: [f32; 3]) -> Self {
        let moved = |sides: [Option<f32>; 3], sign: f32| {
            std::array::from_fn(|axis| sides[axis].map(|side| side + sign * by[axis]))
        };
        Self { min: moved(self.min, -1.0), max: moved(self.max, 1.0) }
    }
}

/// The content of the file that `train.block` names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Block {
    /// Where Gaussians may be added.
    pub bounds: Bounds,
    /// Names of the views that show the block, held-out ones too.
    pub views: Vec<String>,
    /// Scene file that is drawn with the block and is no part of it, relative to the folder of this file.
    pub surroundings: PathBuf,
}

impl Block {
    /// Reads it; `surroundings` is a path from here then.
    ///
    /// # Errors
    /// [`Error::Io`] naming `path`.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let read = || -> std::io::Result<Self> { Ok(serde_json::from_slice(&std::fs::read(path)?)?) };
        let mut block =
            read().map_err(|source| Error::Io { action: "cannot read block", path: path.to_owned(), source })?;
        block.surroundings = path.parent().unwrap_or(path).join(&block.surroundings);
        Ok(block)
    }
}

impl Dataset {
    /// Leaves out the views that `keeps` does not want. Points that only those saw remain, with no view that sees them.
    pub fn keep_views(&mut self, keeps: impl Fn(&View) -> bool) {
        self.points.seen_by.keep_views(self.train.iter().map(&keeps));
        for views in [&mut self.train, &mut self.test, &mut self.validation] {
            views.retain(&keeps);
        }
    }

    /// Leaves out the views that do not show `block`.
    ///
    /// # Errors
    /// A message if a view is missing.
    pub fn keep_block(&mut self, block: &Block) -> Result<(), String> {
        let wanted: HashSet<&str> = block.views.iter().map(String::as_str).collect();
        self.keep_views(|view| wanted.contains(&*view.name));
        let found = self.train.len() + self.test.len() + self.validation.len();
        if found == wanted.len() && !self.train.is_empty() {
            return Ok(());
        }
        Err(format!(
            "of its {} views {found} are in the dataset, {} of them to train on",
            wanted.len(),
            self.train.len()
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BuiltinOptions, builtin};

    #[test]
    fn parts_of_a_split_box_have_no_point_in_common_and_none_between_them() {
        let [below, above] = Bounds::ALL.split(1, 2.0);
        let [low, high] = above.split(0, -1.0);
        for point in [[0.0, 2.0, 0.0], [0.0, 1.999, 5.0], [-1.0, 3.0, 0.0], [-1.5, 2.0, 9.0]] {
            assert_eq!([below, low, high].iter().filter(|part| part.contains(point)).count(), 1, "{point:?}");
        }
        let grown = high.grown([1.0, 0.5, 9.0]);
        assert_eq!((grown.min, grown.max), ([Some(-2.0), Some(1.5), None], [None; 3]));
        assert_eq!(below.rows_within(&[0.0, 2.0, 0.0, 7.0, 1.0, 0.0]), [1]);
    }

    #[test]
    fn a_dataset_of_a_block_has_its_views_alone() {
        let options =
            BuiltinOptions { width: 4, height: 4, train_views: 4, test_views: 2, points: 0, ..Default::default() };
        let mut dataset = builtin(&options);
        dataset.points.seen_by = [vec![0, 1, 3], vec![0]].into_iter().collect();
        let names = [&dataset.train[1], &dataset.train[3], &dataset.test[0]].map(|view| view.name.clone());
        let block = |views: &[String]| Block {
            bounds: Bounds::ALL,
            views: views.to_vec(),
            surroundings: "outside.safetensors".into(),
        };
        let whole = dataset.clone();
        dataset.keep_block(&block(&names)).unwrap();
        let found: Vec<&String> = dataset.train.iter().chain(&dataset.test).map(|view| &view.name).collect();
        assert_eq!(found, names.each_ref());
        assert_eq!(dataset.points.seen_by, [vec![0, 1], vec![]].into_iter().collect());
        let error = |views: &[String]| whole.clone().keep_block(&block(views)).unwrap_err();
        assert!(error(&[names[0].clone(), "absent".into()]).contains("of its 2 views 1"));
        assert!(error(&names[2..]).contains("0 of them to train on"));
    }
}
