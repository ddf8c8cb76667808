// From sums to a picture: normalisation, or one of the displays.

@group(1) @binding(0) var surfels: texture_2d<f32>;
@group(1) @binding(1) var sums: texture_2d<f32>;
@group(1) @binding(2) var opacity_1: texture_2d<f32>;
@group(1) @binding(3) var layer_1: texture_2d<u32>;
@group(1) @binding(4) var layer_2: texture_2d<u32>;
@group(1) @binding(5) var layer_3: texture_2d<u32>;
@group(1) @binding(6) var layer_4: texture_2d<u32>;
@group(1) @binding(7) var layer_5: texture_2d<u32>;
@group(1) @binding(8) var cores: texture_2d<u32>;
@group(1) @binding(9) var forms: texture_2d<u32>;

// Fragments at the end of the ramp of overdraw.
const MOST_FRAGMENTS: f32 = 64.0;

@vertex
fn vertex(@builtin(vertex_index) at: u32) -> @builtin(position) vec4f {
    return everywhere(at, 0.0);
}

// Viridis at eighths.
fn ramp(value: f32) -> vec3f {
    var stops = array<vec3f, 9>(
        vec3f(68.0, 1.0, 84.0), vec3f(71.0, 45.0, 123.0), vec3f(59.0, 82.0, 139.0),
        vec3f(44.0, 114.0, 142.0), vec3f(33.0, 145.0, 140.0), vec3f(40.0, 174.0, 128.0),
        vec3f(94.0, 201.0, 98.0), vec3f(173.0, 220.0, 48.0), vec3f(253.0, 231.0, 37.0),
    );
    let position = clamp(value, 0.0, 1.0) * 8.0;
    let below = min(u32(position), 7u);
    return mix(stops[below], stops[below + 1u], position - f32(below)) / 255.0;
}

fn normal_of(nearest: vec2u, px: vec2f) -> vec3f {
    let normal = rotation(textureLoad(forms, texel(nearest.y & ~OPAQUE), 0).xy)[2];
    let ray = vec3f((px - frame.lens.zw) / frame.lens.xy, 1.0);
    return select(normal, -normal, dot(turned(normal), ray) > 0.0);
}

fn shown(position: vec4f) -> vec3f {
    let at = vec2u(position.xy);
    let surfel = textureLoad(surfels, at, 0);
    let sum = textureLoad(sums, at, 0);
    let core = select(vec2u(0u, NOTHING), textureLoad(cores, at, 0).xy, switched(CONTINUOUS));
    let first = textureLoad(layer_1, at, 0).xy;
    // what is missing is infinitely far
    let nearest = select(first, core, bitcast<f32>(core.x) > bitcast<f32>(first.x));
    let empty = nearest.y == NOTHING;
    switch frame.counts.w {
        case 1u: { return surfel.rgb; }
        case 2u: { return sum.rgb / (1.0 + sum.a); }
        case 3u: {
            let through = select(1.0 - textureLoad(opacity_1, at, 0).x, 0.0, !empty && nearest.y >= OPAQUE);
            return vec3f(through);
        }
        case 4u: {
            let depth = frame.centre_near.w / bitcast<f32>(nearest.x);
            let share = (depth - frame.surfel.z) / max(frame.surfel.w - frame.surfel.z, 1e-30);
            return select(ramp(share), vec3f(0.0), empty);
        }
        case 5u: { return select(0.5 + 0.5 * normal_of(nearest, position.xy), vec3f(0.5), empty); }
        case 6u: {
            var present = 0.0;
            present += select(0.0, 1.0, core.y != NOTHING);
            present += select(0.0, 1.0, first.y != NOTHING);
            present += select(0.0, 1.0, textureLoad(layer_2, at, 0).y != NOTHING);
            present += select(0.0, 1.0, textureLoad(layer_3, at, 0).y != NOTHING);
            present += select(0.0, 1.0, textureLoad(layer_4, at, 0).y != NOTHING);
            present += select(0.0, 1.0, textureLoad(layer_5, at, 0).y != NOTHING);
            return ramp(present / f32(frame.counts.z));
        }
        default: { return ramp(sum.a / MOST_FRAGMENTS); }
    }
}

// The number that an sRGB target stores as `value`.
fn linear(value: vec3f) -> vec3f {
    let bounded = clamp(value, vec3f(0.0), vec3f(1.0));
    return select(pow((bounded + 0.055) / 1.055, vec3f(2.4)), bounded / 12.92, bounded <= vec3f(0.04045));
}

@fragment
fn image(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let at = vec2u(position.xy);
    let sum = textureLoad(sums, at, 0);
    let colour = (textureLoad(surfels, at, 0).rgb + sum.rgb) / (1.0 + sum.a);
    return vec4f(select(colour, linear(colour), switched(ENCODE_SRGB)), 1.0);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let colour = shown(position);
    return vec4f(select(colour, linear(colour), switched(ENCODE_SRGB)), 1.0);
}

// A scene of blended Gaussians: in front of what lies behind it.
@fragment
fn blended(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let sum = textureLoad(sums, vec2u(position.xy), 0);
    var colour = sum.rgb + (1.0 - sum.a) * behind(position.xy);
    switch frame.counts.w {
        case 2u: { colour = sum.rgb; }
        case 3u: { colour = vec3f(1.0 - sum.a); }
        case 7u: { colour = ramp(sum.a / MOST_FRAGMENTS); }
        default: {}
    }
    return vec4f(select(colour, linear(colour), switched(ENCODE_SRGB)), 1.0);
}
