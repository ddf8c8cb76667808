// A primitive is drawn by the factor of its page, and a merged Gaussian less the nearer it is.

// log2 of `PAGE` of pages.rs.
const LOG2_PAGE: u32 = 8u;

@group(1) @binding(4) var fades: texture_2d<f32>;

fn fade_of(index: u32) -> f32 {
    return textureLoad(fades, texel(index >> LOG2_PAGE), 0).x;
}

// Merged Gaussians are wide: one whose centre passes the near plane would at once be missing from much of the picture. From twice
// the near plane on they are whole.
fn gaussian_fade_of(index: u32, depth: f32) -> f32 {
    let fade = textureLoad(fades, texel(index >> LOG2_PAGE), 0).xy;
    return fade.x * mix(1.0, min(1.0, 1.0 / depth - 1.0), fade.y);
}
