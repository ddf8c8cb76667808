// The layers of a pixel: their picture, and what Gaussians need to know of them.

@group(1) @binding(0) var places: texture_2d<f32>;
@group(1) @binding(1) var colours: texture_2d<f32>;
@group(1) @binding(2) var layer_1: texture_2d<u32>;
@group(1) @binding(3) var layer_2: texture_2d<u32>;
@group(1) @binding(4) var layer_3: texture_2d<u32>;
@group(1) @binding(5) var layer_4: texture_2d<u32>;
@group(1) @binding(6) var opacity_1: texture_2d<f32>;
@group(1) @binding(7) var opacity_2: texture_2d<f32>;
@group(1) @binding(8) var opacity_3: texture_2d<f32>;
@group(1) @binding(9) var opacity_4: texture_2d<f32>;

struct Resolved {
    // C_s, T_K
    @location(0) surfels: vec4f,
    // Ends of the first two intervals as near / depth, T_1, T_2, as bits
    @location(1) intervals: vec4u,
    // End of the third, T_3, as bits
    @location(2) third: vec2u,
    // near / depth behind which Gaussians are hidden
    @builtin(frag_depth) closed_at: f32,
}

@vertex
fn vertex(@builtin(vertex_index) at: u32) -> @builtin(position) vec4f {
    return everywhere(at, 0.0);
}

fn layer(k: u32, at: vec2u) -> vec2u {
    switch k {
        case 0u: { return textureLoad(layer_1, at, 0).xy; }
        case 1u: { return textureLoad(layer_2, at, 0).xy; }
        case 2u: { return textureLoad(layer_3, at, 0).xy; }
        default: { return textureLoad(layer_4, at, 0).xy; }
    }
}

fn opacity(k: u32, at: vec2u) -> f32 {
    switch k {
        case 0u: { return textureLoad(opacity_1, at, 0).x; }
        case 1u: { return textureLoad(opacity_2, at, 0).x; }
        case 2u: { return textureLoad(opacity_3, at, 0).x; }
        default: { return textureLoad(opacity_4, at, 0).x; }
    }
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> Resolved {
    let at = vec2u(position.xy);
    let near = frame.centre_near.w;
    let layers = frame.counts.z;
    var colour = vec3f(0.0);
    var through = 1.0;
    var throughs = vec4f(1.0);
    // as near / depth: the smaller, the further; 0 is infinitely far
    var ends = vec4f(0.0);
    var reached = 1e30;
    var last = 0.0;
    var closed = false;
    var present = 0u;
    for (var k = 0u; k < layers; k++) {
        let nearest = layer(k, at);
        if nearest.y == NOTHING {
            break;
        }
        let index = nearest.y & ~OPAQUE;
        let alpha = select(opacity(k, at), 1.0, nearest.y >= OPAQUE);
        colour += textureLoad(colours, texel(index), 0).rgb * (alpha * through);
        through *= 1.0 - alpha;
        throughs[k] = through;
        let bare = bitcast<f32>(nearest.x);
        last = near / (near / bare + textureLoad(places, texel(index), 0).w);
        var end = last;
        if switched(LITERAL_LOOKUP) {
            // only what hides ends the last interval
            end = select(bare, 0.0, k + 1u == layers);
        }
        reached = min(reached, end);
        ends[k] = reached;
        closed = closed || nearest.y >= OPAQUE;
        present = k + 1u;
    }
    for (var k = present; k < 4u; k++) {
        throughs[k] = through;
    }
    let closed_at = select(0.0, last, closed || present == layers);
    ends = max(ends, vec4f(closed_at));

    var resolved: Resolved;
    resolved.surfels = vec4f(colour + through * behind(position.xy), through);
    resolved.intervals = bitcast<vec4u>(vec4f(ends.xy, throughs.xy));
    resolved.third = bitcast<vec2u>(vec2f(ends.z, throughs.z));
    resolved.closed_at = closed_at;
    return resolved;
}
