//! Pictures of 8-bit values by a formula, which `tests/reference/test_pictures.py` has too.

/// [3 × `height` × `width`] with the values `of(channel, row, column)`, modulo 256, as shares of 255.
pub fn picture(width: usize, height: usize, of: impl Fn(usize, usize, usize) -> usize) -> Vec<f32> {
    let at = |i: usize| (i / (width * height), i / width % height, i % width);
    (0..3 * width * height).map(at).map(|(c, y, x)| (of(c, y, x) % 256) as f32 / 255.0).collect()
}

/// Discs on a ramp.
pub fn discs(c: usize, y: usize, x: usize) -> usize {
    if (x % 24).abs_diff(12).pow(2) + (y % 24).abs_diff(12).pow(2) < 60 {
        60 + 70 * c
    } else {
        (x + 2 * y + 40 * c) % 256
    }
}

/// The discs, a little to the left.
pub fn moved(c: usize, y: usize, x: usize) -> usize {
    discs(c, y, x + 1)
}

pub fn noise(c: usize, y: usize, x: usize) -> usize {
    (x * 7919 + y * 104_729 + c * 1_299_709 + x * y * 31) % 251
}

/// The discs with some noise.
pub fn noisy(c: usize, y: usize, x: usize) -> usize {
    (7 * discs(c, y, x) + noise(c, y, x)) / 8
}

/// The discs in other colours.
pub fn tinted(c: usize, y: usize, x: usize) -> usize {
    discs(c, y, x) * (8 - c) / 8
}
