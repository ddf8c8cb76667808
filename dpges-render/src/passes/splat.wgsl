// Ellipses of Gaussians, summed in any order. The depth test hides what lies behind the last layer.
//
// `fade_of` is that of `fade_whole` or of `fade_paged`. It changes weights once they are cut off, so that the sums of two
// Gaussians in the same place whose factors add up to 1 are those of one.

@group(1) @binding(0) var firsts: texture_2d<u32>;
@group(1) @binding(1) var seconds: texture_2d<u32>;
@group(1) @binding(2) var intervals: texture_2d<u32>;
@group(1) @binding(3) var throughs: texture_2d<u32>;

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat, either) colour_strength: vec4f,
    @location(1) @interpolate(flat, either) inverse: vec4f,
    // centre in px, depth in world units, fade
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
    corner.place = vec4f(ellipse.centre, frame.centre_near.w / depth, fade_of(index));
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

// T_1 to T_4.
fn through(at: vec2u) -> vec4f {
    let packed = textureLoad(throughs, at, 0).xy;
    return vec4f(unpack2x16unorm(packed.x), unpack2x16unorm(packed.y));
}

// What reaches the eye of a Gaussian: T of each interval times its share there. The end of the first ramp and the slope of
// all are followed by how far the other ends lie behind the first, in lengths of a ramp.
fn faded_share(corner: Corner) -> f32 {
    let at = vec2u(corner.position.xy);
    let tests = textureLoad(intervals, at, 0);
    let behind = (corner.place.z - bitcast<f32>(tests.x)) * bitcast<f32>(tests.y);
    if behind <= -1.0 {
        return 1.0;
    }
    let ends = vec4f(unpack2x16float(tests.z), unpack2x16float(tests.w));
    let first = saturate(-behind);
    let before = saturate(ends - behind);
    return first + dot(through(at), before - vec4f(first, before.xyz));
}

@fragment
fn faded(corner: Corner) -> @location(0) vec4f {
    let alpha = weight(corner);
    if alpha < CUTOFF {
        discard;
    }
    return vec4f(corner.colour_strength.rgb, 1.0) * (alpha * corner.place.w * faded_share(corner));
}

// T of the interval of a Gaussian, whose ends are depths.
@fragment
fn stepped(corner: Corner) -> @location(0) vec4f {
    let alpha = weight(corner);
    if alpha < CUTOFF {
        discard;
    }
    let at = vec2u(corner.position.xy);
    let passed = vec4f(corner.place.z) >= bitcast<vec4f>(textureLoad(intervals, at, 0));
    let behind = through(at);
    var share = select(1.0, behind.x, passed.x);
    share = select(share, behind.y, passed.y);
    share = select(share, behind.z, passed.z);
    share = select(share, behind.w, passed.w);
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
