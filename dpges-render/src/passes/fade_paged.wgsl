// A primitive is drawn by the factor of its page.

// log2 of `PAGE` of pages.rs.
const LOG2_PAGE: u32 = 8u;

@group(1) @binding(4) var fades: texture_2d<f32>;

fn fade_of(index: u32) -> f32 {
    return textureLoad(fades, texel(index >> LOG2_PAGE), 0).x;
}
