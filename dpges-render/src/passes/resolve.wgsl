// The layers of a pixel: their picture, and what Gaussians need to know of them.

@group(1) @binding(0) var places: texture_2d<f32>;
@group(1) @binding(1) var colours: texture_2d<f32>;
@group(1) @binding(2) var cores: texture_2d<u32>;
@group(1) @binding(3) var layer_1: texture_2d<u32>;
@group(1) @binding(4) var layer_2: texture_2d<u32>;
@group(1) @binding(5) var layer_3: texture_2d<u32>;
@group(1) @binding(6) var layer_4: texture_2d<u32>;
@group(1) @binding(7) var layer_5: texture_2d<u32>;
@group(1) @binding(8) var opacity_1: texture_2d<f32>;
@group(1) @binding(9) var opacity_2: texture_2d<f32>;
@group(1) @binding(10) var opacity_3: texture_2d<f32>;
@group(1) @binding(11) var opacity_4: texture_2d<f32>;
@group(1) @binding(12) var opacity_5: texture_2d<f32>;

const MAX_LAYERS: u32 = 5u;

struct Resolved {
    // C_s, T_K
    @location(0) surfels: vec4f,
    // The tests of Gaussians, see `splat.wgsl`
    @location(1) intervals: vec4u,
    // T_1 to T_4 as 16-bit fractions
    @location(2) through: vec2u,
    // near / depth behind which Gaussians are hidden
    @builtin(frag_depth) closed_at: f32,
}

// The layers of a pixel, nearest first.
struct Stack {
    count: u32,
    opacity: array<f32, MAX_LAYERS>,
    depth: array<f32, MAX_LAYERS>,
    margin: array<f32, MAX_LAYERS>,
    colour: array<vec3f, MAX_LAYERS>,
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
        case 3u: { return textureLoad(layer_4, at, 0).xy; }
        default: { return textureLoad(layer_5, at, 0).xy; }
    }
}

fn opacity(k: u32, at: vec2u) -> f32 {
    switch k {
        case 0u: { return textureLoad(opacity_1, at, 0).x; }
        case 1u: { return textureLoad(opacity_2, at, 0).x; }
        case 2u: { return textureLoad(opacity_3, at, 0).x; }
        case 3u: { return textureLoad(opacity_4, at, 0).x; }
        default: { return textureLoad(opacity_5, at, 0).x; }
    }
}

fn push(stack: ptr<function, Stack>, nearest: vec2u, opacity: f32) {
    let index = nearest.y & ~OPAQUE;
    let k = (*stack).count;
    (*stack).opacity[k] = select(opacity, 1.0, nearest.y >= OPAQUE);
    (*stack).depth[k] = frame.centre_near.w / bitcast<f32>(nearest.x);
    (*stack).margin[k] = textureLoad(places, texel(index), 0).w;
    (*stack).colour[k] = textureLoad(colours, texel(index), 0).rgb;
    (*stack).count = k + 1u;
}

// The core, if there is one, is beside the layers that were peeled.
fn layers_at(at: vec2u) -> Stack {
    var stack: Stack;
    var core = select(vec2u(0u, NOTHING), textureLoad(cores, at, 0).xy, switched(CONTINUOUS));
    for (var k = 0u; k < frame.counts.z && stack.count < frame.counts.z; k++) {
        let nearest = layer(k, at);
        // a layer that is missing is infinitely far
        let is_after = bitcast<f32>(nearest.x) < bitcast<f32>(core.x)
            || (nearest.x == core.x && (nearest.y & ~OPAQUE) > (core.y & ~OPAQUE));
        if core.y != NOTHING && is_after {
            push(&stack, core, 1.0);
            core.y = NOTHING;
        }
        if nearest.y == NOTHING {
            break;
        }
        push(&stack, nearest, opacity(k, at));
    }
    return stack;
}

// Share of layer i that is behind layer j, which is not after it.
fn behind_share(stack: ptr<function, Stack>, i: u32, j: u32) -> f32 {
    let reach = frame.margins.x * min((*stack).margin[i], (*stack).margin[j]);
    let distance = (*stack).depth[i] - (*stack).depth[j];
    return select(1.0, 0.5 + 0.5 * distance / reach, distance < reach);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> Resolved {
    var stack = layers_at(vec2u(position.xy));
    let near = frame.centre_near.w;
    let continuous = switched(CONTINUOUS);
    var weights: array<f32, MAX_LAYERS>;
    var throughs: array<f32, MAX_LAYERS>;
    var through = 1.0;
    var core = stack.count;
    for (var i = 0u; i < stack.count; i++) {
        let opacity = stack.opacity[i];
        var seen = opacity;
        for (var j = 0u; j < i; j++) {
            let share = behind_share(&stack, i, j);
            seen *= 1.0 - stack.opacity[j] * share;
            weights[j] *= 1.0 - opacity * (1.0 - share);
        }
        weights[i] = seen;
        if opacity >= 1.0 {
            core = min(core, i);
        }
        through *= 1.0 - opacity;
        throughs[i] = through;
    }
    var total = 0.0;
    var colour = vec3f(0.0);
    var margin = 0.0;
    for (var i = 0u; i < stack.count; i++) {
        total += weights[i];
        colour += stack.colour[i] * weights[i];
        margin += stack.margin[i] * weights[i];
    }
    let inverse = select(0.0, 1.0 / total, total > 0.0);
    colour *= (1.0 - through) * inverse;
    margin *= inverse;
    for (var k = stack.count; k < MAX_LAYERS; k++) {
        throughs[k] = through;
    }

    // depths at which Gaussians are wholly behind the layers
    var ends: array<f32, MAX_LAYERS>;
    var closed = core < stack.count;
    if continuous {
        for (var k = 0u; k < stack.count; k++) {
            ends[k] = stack.depth[min(k, core)] + margin * (1.0 + 0.5 * frame.margins.y);
        }
    } else {
        closed = closed || stack.count == frame.counts.z;
        var reached = 0.0;
        for (var k = 0u; k < stack.count; k++) {
            let shifted = stack.depth[k] + stack.margin[k];
            reached = max(reached, select(shifted, stack.depth[k], switched(LITERAL_LOOKUP) && k + 1u < frame.counts.z));
            ends[k] = reached;
        }
        if closed {
            let last = stack.depth[stack.count - 1u] + stack.margin[stack.count - 1u];
            for (var k = 0u; k < stack.count; k++) {
                ends[k] = min(ends[k], last);
            }
        }
    }
    let last = max(stack.count, 1u) - 1u;
    var resolved: Resolved;
    resolved.surfels = vec4f(colour + through * behind(position.xy), through);
    resolved.closed_at = select(0.0, near / ends[last], closed);
    resolved.through = vec2u(pack2x16unorm(vec2f(throughs[0], throughs[1])), pack2x16unorm(vec2f(throughs[2], throughs[3])));
    for (var k = stack.count; k < MAX_LAYERS; k++) {
        // nothing is behind a layer that is missing
        ends[k] = select(FARTHEST, ends[last], closed);
    }
    if continuous {
        let slope = 1.0 / max(frame.margins.y * margin, SHORTEST_RAMP);
        var offsets: array<f32, 4>;
        for (var k = 0u; k < 4u; k++) {
            offsets[k] = min((ends[k + 1u] - ends[0]) * slope, LARGEST_HALF);
        }
        let packed = vec2u(pack2x16float(vec2f(offsets[0], offsets[1])), pack2x16float(vec2f(offsets[2], offsets[3])));
        resolved.intervals = vec4u(bitcast<u32>(ends[0]), bitcast<u32>(slope), packed);
    } else {
        resolved.intervals = bitcast<vec4u>(vec4f(ends[0], ends[1], ends[2], ends[3]));
    }
    return resolved;
}
