//! Sharding: which rank has which Gaussians of a scene.
//!
//! Refinement decides on the columns of all Gaussians, which it gathers, with random numbers that all ranks draw alike: every rank
//! comes to the same edit of the whole scene, and applies what concerns its own Gaussians. Gaussians that stay keep their rank; new
//! ones go one by one to the rank that has the fewest.

use std::sync::Arc;

use burn::tensor::Tensor;
use dpges_core::ranks::Ranks;
use dpges_core::scene::GaussianData;
use dpges_core::scene::schema::Columns;

use crate::optimizer::ParameterRows;
use crate::refine::GaussianEdit;

/// The ranks of the Gaussians of a scene.
#[derive(Clone, Debug)]
pub struct Sharding {
    pub ranks: Arc<dyn Ranks>,
    /// [all] rank of each.
    owners: Vec<u16>,
}

impl Sharding {
    /// Shards `count` Gaussians over the ranks, one by one.
    pub fn new(count: usize, ranks: Arc<dyn Ranks>) -> Self {
        let owners = (0..count).map(|row| (row % ranks.count()) as u16).collect();
        Self { ranks, owners }
    }

    /// `count` Gaussians, sharded as `column` says if it was written by as many ranks as there are now, or else anew.
    ///
    /// # Errors
    /// A message if the column has another length.
    pub fn from_column(column: Option<Vec<f32>>, count: usize, ranks: Arc<dyn Ranks>) -> Result<Self, String> {
        let Some(column) = column else { return Ok(Self::new(count, ranks)) };
        if column.len() != count {
            return Err(format!("column `{OWNERS}` has {} numbers, expected {count}", column.len()));
        }
        let owners: Vec<u16> = column.into_iter().map(|owner| owner as u16).collect();
        // a run that goes on with another number of ranks shards its Gaussians anew
        let before = owners.iter().max().map_or(0, |&last| usize::from(last) + 1);
        Ok(if before == ranks.count() { Self { ranks, owners } } else { Self::new(count, ranks) })
    }

    /// The column that [`from_column`](Self::from_column) takes; `None` for a rank alone.
    pub fn column(&self) -> Option<(&'static str, Vec<f32>)> {
        let column = || self.owners.iter().map(|&owner| f32::from(owner)).collect();
        (!self.ranks.is_alone()).then(|| (OWNERS, column()))
    }

    /// Number of Gaussians of all ranks.
    pub fn len(&self) -> usize {
        self.owners.len()
    }

    pub fn is_empty(&self) -> bool {
        self.owners.is_empty()
    }

    /// Rows of the Gaussians of this rank among all.
    pub fn own(&self) -> Vec<usize> {
        let rank = self.rank();
        (0..self.len()).filter(|&row| self.owners[row] == rank).collect()
    }

    fn rank(&self) -> u16 {
        self.ranks.rank() as u16
    }

    /// The rows of this rank among `all` rows `[n × width]`.
    pub fn own_of(&self, all: &[f32], width: usize) -> Vec<f32> {
        if self.ranks.is_alone() {
            return all.to_vec();
        }
        self.own().into_iter().flat_map(|row| &all[row * width..][..width]).copied().collect()
    }

    /// The rows of this rank among the parameters of all Gaussians.
    pub fn own_rows(&self, all: &ParameterRows) -> Result<ParameterRows, String> {
        if all.count != self.len() {
            return Err(format!("{} rows of a parameter do not fit {} Gaussians", all.count, self.len()));
        }
        let own = |values: &Vec<f32>| self.own_of(values, all.width);
        let moments = all.moments.as_ref().map(|moments| moments.each_ref().map(own));
        Ok(ParameterRows { count: self.own().len(), width: all.width, raw: own(&all.raw), moments })
    }

    /// The rows `[n × width]` of all Gaussians, in their order, from the `own` of each rank.
    pub fn all_of(&self, own: Vec<f32>, width: usize) -> Vec<f32> {
        if self.ranks.is_alone() {
            return own;
        }
        in_order(&self.owners, &self.ranks.gather_numbers(&own), width).expect("every rank has its Gaussians")
    }

    /// All Gaussians, in their order, from the `own` of each rank.
    pub fn all_data(&self, own: GaussianData) -> GaussianData {
        if self.ranks.is_alone() {
            return own;
        }
        let model = own.model();
        own.map_ref(|attribute, rows| self.all_of(rows.clone(), attribute.width.under(model)))
    }

    /// The mean over all Gaussians of the `own` numbers [n, w] of each rank, `[1]`.
    pub fn mean(&self, own: Tensor<2>) -> Tensor<1> {
        if self.ranks.is_alone() {
            return own.mean();
        }
        let [rows, width] = own.dims();
        let sum = if rows == 0 { Tensor::zeros([1], (&own.device(), own.dtype())) } else { own.sum() };
        // the sum over all, not a mean of means: ranks have different numbers of Gaussians
        self.ranks.joined(sum) / (self.len() * width) as f64
    }

    /// Applies an edit of all Gaussians. Returns the edit of the own ones.
    pub fn edit(&mut self, edit: &GaussianEdit) -> GaussianEdit {
        if self.ranks.is_alone() {
            self.owners = vec![0; edit.keep.len() + edit.added.len()];
            return edit.clone();
        }
        let rank = self.rank();
        let own = self.own();
        let kept = |row: &usize| self.owners[*row] == rank;
        let place = |row: usize| own.binary_search(&row).expect("it is an own one");
        let keep = edit.keep.iter().copied().filter(kept).map(place).collect();
        self.owners = edit.keep.iter().map(|&row| self.owners[row]).collect();
        let mut counts = vec![0usize; self.ranks.count()];
        self.owners.iter().for_each(|&owner| counts[usize::from(owner)] += 1);
        let mut added = Vec::new();
        for row in 0..edit.added.len() {
            // every rank shards all new ones, each to the first rank with the fewest: all agree without a message
            let fewest = (0..counts.len()).min_by_key(|&rank| counts[rank]).expect("there are ranks");
            counts[fewest] += 1;
            self.owners.push(fewest as u16);
            if fewest == usize::from(rank) {
                added.push(row);
            }
        }
        GaussianEdit { keep, added: edit.added.select(&added) }
    }
}

/// The rows of all ranks in the order of `owners`, from those `of_ranks`; `None` if they do not fit each other.
pub fn in_order(owners: &[u16], of_ranks: &[Vec<f32>], width: usize) -> Option<Vec<f32>> {
    if width == 0 {
        return Some(Vec::new());
    }
    let mut rows: Vec<_> = of_ranks.iter().map(|rows| rows.chunks_exact(width)).collect();
    let mut all = Vec::with_capacity(owners.len() * width);
    for &owner in owners {
        all.extend(rows.get_mut(usize::from(owner))?.next()?);
    }
    // the last rows belong to no rank
    (all.len() == of_ranks.iter().map(Vec::len).sum::<usize>()).then_some(all)
}

/// Name of the column in a checkpoint.
pub const OWNERS: &str = "owners";

#[cfg(test)]
mod tests {
    use dpges_core::scene::ColourModel;
    use dpges_core::testing::ranks::on_ranks;

    use super::*;

    const MODEL: ColourModel = ColourModel::SphericalBeta { lobes: 1 };

    /// Gaussians whose opacity is their number.
    fn numbered(numbers: std::ops::Range<usize>) -> GaussianData {
        let mut gaussians = GaussianData::neutral(MODEL, numbers.len());
        gaussians.opacities = numbers.map(|number| number as f32).collect();
        gaussians
    }

    #[test]
    fn edits_of_all_are_edits_of_every_rank() {
        let before = numbered(0..11);
        let edit = GaussianEdit { keep: vec![0, 3, 4, 6, 9, 10], added: numbered(20..27) };
        let expected = edit.apply(&before);
        for count in [1, 2, 3, 4] {
            let parts = on_ranks(count, |ranks| {
                let mut sharding = Sharding::new(before.len(), ranks);
                let own = before.select(&sharding.own());
                assert_eq!(sharding.all_data(own.clone()), before);
                let own = sharding.edit(&edit).apply(&own);
                assert_eq!(own, expected.select(&sharding.own()));
                assert_eq!(sharding.own_of(&expected.opacities, 1), own.opacities);
                (sharding.all_data(own.clone()), own.len())
            });
            let fewest = parts.iter().map(|part| part.1).min().unwrap();
            for (all, own) in parts {
                assert_eq!(all, expected);
                assert!(own <= fewest + 1, "{own} of {} on one of {count} ranks", expected.len());
            }
        }
    }

    #[test]
    fn columns_of_as_many_ranks_are_taken_up_again() {
        on_ranks(2, |ranks| {
            let mut sharding = Sharding::new(4, ranks.clone());
            sharding.edit(&GaussianEdit { keep: vec![1, 2, 3], added: numbered(0..0) });
            let (_, column) = sharding.column().unwrap();
            let again = Sharding::from_column(Some(column.clone()), 3, ranks.clone()).unwrap();
            assert_eq!(again.owners, [1, 0, 1]);
            let of_three = Sharding::from_column(Some(vec![0.0, 1.0, 2.0]), 3, ranks.clone()).unwrap();
            assert_eq!(of_three.owners, [0, 1, 0]);
            assert!(Sharding::from_column(Some(column), 5, ranks).unwrap_err().contains("owners"));
        });
    }
}
