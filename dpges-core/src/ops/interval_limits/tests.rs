use super::interval_limits;
use crate::ops::fixtures;
use crate::ops::fixtures::constant;
use crate::ops::peel::Layers;
use crate::scene::MarginLookup;
use crate::testing::golden::values;
use crate::testing::random::Random;

const WIDTH: usize = 40;
const HEIGHT: usize = 30;

#[test]
fn intervals_are_those_of_the_first_layer_that_lies_behind() {
    let (layers, pixels, mut random) = (3, WIDTH * HEIGHT, Random::new(21));
    let margins = random.numbers(20, 0.0, 0.6);
    let (mut ids, mut alpha, mut depth) =
        (vec![-1i32; layers * pixels], vec![0.0; layers * pixels], vec![f64::INFINITY; layers * pixels]);
    for at in 0..pixels {
        let mut stack = random.numbers(random.clone().below(layers + 1), 1.0, 3.0);
        stack.sort_by(f64::total_cmp);
        let opaque_end = random.below(2) == 0;
        for (k, &d) in stack.iter().enumerate() {
            let opaque = opaque_end && k + 1 == stack.len();
            let slot = k * pixels + at;
            (ids[slot], depth[slot]) = (random.below(20) as i32, d);
            alpha[slot] = if opaque { 1.0 } else { random.between(0.1, 0.9) };
        }
    }
    let [alphas, depths] = [&alpha, &depth].map(|values| constant(values, [layers, HEIGHT, WIDTH]));
    let peeled = Layers { depth: depths, ..fixtures::layers(&ids, alphas) };
    let margin_tensor = constant(&margins, [20, 1]);
    let limits = [MarginLookup::Shifted, MarginLookup::Literal]
        .map(|lookup| values(&interval_limits(&peeled, &margin_tensor, lookup).unwrap()));
    for at in 0..pixels {
        let shifted: Vec<f64> = (0..layers)
            .map(|k| k * pixels + at)
            .map(|slot| if ids[slot] < 0 { f64::INFINITY } else { depth[slot] + margins[ids[slot] as usize] })
            .collect();
        let present = (0..layers).filter(|k| ids[k * pixels + at] >= 0).count();
        let closed = present == layers || (0..layers).any(|k| alpha[k * pixels + at] >= 1.0);
        for d in random.numbers(20, 0.8, 4.0).into_iter().chain(shifted.iter().copied().filter(|d| d.is_finite())) {
            let occluded = closed && d >= shifted[present - 1];
            let in_shifted = (0..layers).find(|&k| d < shifted[k]);
            let in_literal = (0..layers - 1).find(|&k| d < depth[k * pixels + at]).or(Some(layers - 1));
            for (limits, expected) in limits.iter().zip([in_shifted, in_literal]) {
                let found = (0..layers).find(|k| d < limits[k * pixels + at]);
                assert_eq!(found, expected.filter(|_| !occluded), "pixel {at}, depth {d}");
            }
        }
    }
}
