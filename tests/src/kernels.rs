//! The kit of GPU kernels by itself: prefix sums, the sort, pieces of rectangles.

use burn::tensor::Device;
use dpges_core::testing::kernels::{Piece, pieces_of, prefix_sums, sorted};
use dpges_core::testing::random::Random;

fn numbers(count: usize, below: f64, seed: u64) -> Vec<u32> {
    Random::new(seed).numbers(count, 0.0, below).into_iter().map(|number| number as u32).collect()
}

/// Sums that stay at the largest number.
fn expected_sums(values: &[u32]) -> Vec<u32> {
    let sums = values.iter().scan(0u32, |sum, value| {
        *sum = sum.saturating_add(*value);
        Some(*sum)
    });
    std::iter::once(0).chain(sums).collect()
}

/// Around the 8 numbers of a unit, the 2048 of a block, and the 257 blocks where some unit adds up two of those before its
/// own; then as many as cubes add up by themselves, and one more.
pub fn prefix_sums_of_any_length(device: &Device) {
    let blocks = [1, 2, 256, 257, 258].map(|blocks| 2048 * blocks);
    let around = blocks.into_iter().flat_map(|count| [count - 1, count, count + 1]);
    for count in [0, 1, 7, 8, 9, 70_001].into_iter().chain(around).chain([1 << 24, (1 << 24) + 1]) {
        let values = numbers(count, 1000.0, 1);
        assert!(prefix_sums(&values, device) == expected_sums(&values), "{count} numbers");
    }
}

pub fn prefix_sums_stay_at_the_largest_number(device: &Device) {
    let within_a_cube = vec![u32::MAX - 2, 1, 1, 1, 7, 0];
    assert_eq!(prefix_sums(&within_a_cube, device), expected_sums(&within_a_cube));
    for count in [10_000, 2048 * 300] {
        let across_cubes = vec![1 << 20; count];
        assert!(prefix_sums(&across_cubes, device) == expected_sums(&across_cubes), "{count} numbers");
    }
}

/// Around the 1024 pairs of a cube, with digits of four and of eight bits, many pairs of one key and few.
pub fn pairs_of_any_number_are_sorted_and_keep_their_order(device: &Device) {
    for (seed, count) in (1..).zip([0, 1, 2, 1_023, 1_024, 1_025, 70_001]) {
        for bits in [1, 4, 5, 8, 9, 19, 32] {
            let keys = numbers(count, f64::from(bits).exp2(), seed);
            let mut expected: Vec<(u32, u32)> = keys.iter().copied().zip(0..).collect();
            expected.sort_by_key(|&(key, _)| key);
            let (found, places) = sorted(&keys, bits, device);
            assert!(found.into_iter().zip(places).eq(expected), "{count} keys of {bits} bits");
        }
    }
}

fn check_pieces(what: &str, rects: &[[u32; 4]], device: &Device) {
    let (pieces, starts) = pieces_of(rects, device);
    assert_eq!(starts.len(), rects.len() + 1, "{what}");
    for (owner, &[x0, x1, y0, y1]) in rects.iter().enumerate() {
        let mut end = 0;
        for piece in &pieces[starts[owner]..starts[owner + 1]] {
            assert_eq!((piece.owner, piece.pixels[0]), (owner, end), "{what}");
            assert!(piece.pixels[1] > end, "{what}: {piece:?}");
            end = piece.pixels[1];
        }
        assert_eq!(end, (x1 - x0) as usize * (y1 - y0) as usize, "{what}: the pixels of rectangle {owner}");
    }
    let used = starts[rects.len()];
    assert!(pieces[used..].iter().all(|piece| *piece == Piece { owner: 0, pixels: [0, 0] }), "{what}: what is left");
    let largest = pieces.iter().map(|piece| piece.pixels[1] - piece.pixels[0]).max().unwrap_or(0);
    let area: usize = rects.iter().map(|[x0, x1, y0, y1]| (x1 - x0) as usize * (y1 - y0) as usize).sum();
    // the work of the largest does not depend on how it is spread over the rectangles
    assert!(largest <= (area / (rects.len() / 2 + 16_000)).max(255) + 1, "{what}: {largest} px of {area} in one piece");
}

pub fn pieces_cover_every_pixel_once(device: &Device) {
    check_pieces("none", &[], device);
    check_pieces("one pixel", &[[3, 4, 5, 6]], device);
    check_pieces("no pixels", &[[3, 3, 5, 6], [0, 9, 7, 7]], device);
    check_pieces("the largest picture", &[[0, 8192, 0, 8192]], device);
    let mut random = Random::new(2);
    let mut rects: Vec<[u32; 4]> = (0..5_000)
        .map(|_| {
            let [x0, y0] = [random.below(1_900), random.below(1_000)].map(|v| v as u32);
            // a quarter has no pixels
            [x0, x0 + random.below(4) as u32 * 13, y0, y0 + 1 + random.below(70) as u32]
        })
        .collect();
    check_pieces("small ones", &rects, device);
    for at in [0, 17, 4_999] {
        rects[at] = [0, 1_920, 0, 1_080];
    }
    check_pieces("some fill the picture", &rects, device);
    let all = vec![[0, 1_920, 0, 1_080]; 20_000];
    check_pieces("all fill the picture", &all, device);
}
