use super::coverage;
use crate::ops::fixtures::{constant, layers};

#[test]
fn only_the_nearest_layer_counts() {
    let layers = layers(&[2, 0, 2, -1, 1, 1, -1, 1], constant(&[0.0; 8], [2, 2, 2]));
    let found: Vec<i64> = coverage(&layers, 4).into_data().iter::<i64>().collect();
    assert_eq!(found, [1, 0, 2, 0]);
}
