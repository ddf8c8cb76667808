// Ellipses of Gaussians, summed in any order. The depth test hides what lies behind the last layer.
//
// `fade_of` is that of `fade_whole` or of `fade_paged`. It changes weights once they are cut off, so that the sums of two
// Gaussians in the same place whose factors add up to 1 are those of one.

@group(1) @binding(0) var firsts: texture_2d<u32>;
@group(1) @binding(1) var seconds: texture_2d<u32>;
@group(1) @binding(2) var intervals: texture_2d<u32>;
@group(1) @binding(3) var thirds: texture_2d<u32>;

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat, either) colour_strength: vec4f,
    @location(1) @interpolate(flat, either) inverse: vec4f,
    // centre in px, depth, fade
    @location(2) @interpolate(flat, either) place: vec4f,
}

@vertex
fn vertex(@builtin(vertex_index) at: u32, @builtin(instance_index) index: u32) -> Corner {
    let first = textureLoad(firsts, texel(index), 0);
    var corner: Corner;
    if first.z == 0u {
        corner.position = NOWHERE;
        return corner;
    }
    let ellipse = ellipse_corner(first, textureLoad(seconds, texel(index), 0), at);
    corner.colour_strength = ellipse.colour_strength;
    let depth = bitcast<f32>(first.z);
    corner.inverse = ellipse.inverse;
    corner.place = vec4f(ellipse.centre, depth, fade_of(index));
    corner.position = at_px(ellipse.place, depth);
    return corner;
}

fn weight(corner: Corner) -> f32 {
    return corner.colour_strength.w * exp(-0.5 * squared_distance(corner.position, corner.place.xy, corner.inverse));
}

@fragment
fn one_layer(corner: Corner) -> @location(0) vec4f {
    let alpha = weight(corner);
    if alpha < CUTOFF {
        discard;
    }
    return vec4f(corner.colour_strength.rgb, 1.0) * (alpha * corner.place.w);
}

fn through(corner: Corner) -> f32 {
    let packed = bitcast<vec4f>(textureLoad(intervals, vec2u(corner.position.xy), 0));
    // in front of the first layer, of the second, behind both
    return select(select(packed.w, packed.z, corner.place.z > packed.y), 1.0, corner.place.z > packed.x);
}

@fragment
fn three_layers(corner: Corner) -> @location(0) vec4f {
    let alpha = weight(corner);
    if alpha < CUTOFF {
        discard;
    }
    return vec4f(corner.colour_strength.rgb, 1.0) * (alpha * corner.place.w * through(corner));
}

@fragment
fn four_layers(corner: Corner) -> @location(0) vec4f {
    let alpha = weight(corner);
    if alpha < CUTOFF {
        discard;
    }
    var share = through(corner);
    let at = vec2u(corner.position.xy);
    let third = bitcast<vec2f>(textureLoad(thirds, at, 0).xy);
    if corner.place.z <= bitcast<f32>(textureLoad(intervals, at, 0).y) && corner.place.z <= third.x {
        share = third.y;
    }
    return vec4f(corner.colour_strength.rgb, 1.0) * (alpha * corner.place.w * share);
}

// Counts fragments.
@fragment
fn count(corner: Corner) -> @location(0) vec4f {
    if weight(corner) < CUTOFF {
        discard;
    }
    return vec4f(0.0, 0.0, 0.0, 1.0);
}
