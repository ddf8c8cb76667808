// Ellipses of Gaussians, summed in any order. The depth test hides what lies behind the last layer.

@group(1) @binding(0) var firsts: texture_2d<u32>;
@group(1) @binding(1) var seconds: texture_2d<u32>;
@group(1) @binding(2) var intervals: texture_2d<u32>;
@group(1) @binding(3) var thirds: texture_2d<u32>;

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat, either) colour_strength: vec4f,
    @location(1) @interpolate(flat, either) inverse: vec4f,
    @location(2) @interpolate(flat, either) centre: vec2f,
    @location(3) @interpolate(flat, either) depth: f32,
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
    corner.depth = bitcast<f32>(first.z);
    corner.inverse = ellipse.inverse;
    corner.centre = ellipse.centre;
    corner.position = at_px(ellipse.place, corner.depth);
    return corner;
}

fn weight(corner: Corner) -> f32 {
    return corner.colour_strength.w * exp(-0.5 * squared_distance(corner.position, corner.centre, corner.inverse));
}

@fragment
fn one_layer(corner: Corner) -> @location(0) vec4f {
    let alpha = weight(corner);
    if alpha < CUTOFF {
        discard;
    }
    return vec4f(corner.colour_strength.rgb, 1.0) * alpha;
}

fn through(corner: Corner) -> f32 {
    let packed = bitcast<vec4f>(textureLoad(intervals, vec2u(corner.position.xy), 0));
    // in front of the first layer, of the second, behind both
    return select(select(packed.w, packed.z, corner.depth > packed.y), 1.0, corner.depth > packed.x);
}

@fragment
fn three_layers(corner: Corner) -> @location(0) vec4f {
    let alpha = weight(corner);
    if alpha < CUTOFF {
        discard;
    }
    return vec4f(corner.colour_strength.rgb, 1.0) * (alpha * through(corner));
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
    if corner.depth <= bitcast<f32>(textureLoad(intervals, at, 0).y) && corner.depth <= third.x {
        share = third.y;
    }
    return vec4f(corner.colour_strength.rgb, 1.0) * (alpha * share);
}

// Counts fragments.
@fragment
fn count(corner: Corner) -> @location(0) vec4f {
    if weight(corner) < CUTOFF {
        discard;
    }
    return vec4f(0.0, 0.0, 0.0, 1.0);
}
