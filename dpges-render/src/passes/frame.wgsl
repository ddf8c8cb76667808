// Uniforms that all passes of a frame share.

struct Frame {
    // Rows of camera_from_world: rotation, translation.
    row_x: vec4f,
    row_y: vec4f,
    row_z: vec4f,
    // fx, fy, cx, cy in px
    lens: vec4f,
    // Camera centre in world units, near plane.
    centre_near: vec4f,
    // Width and height in px, smallest radius in px, texture width of a grid as a power of two.
    size: vec4f,
    // Red, green, blue, number of coefficients of the environment.
    background: vec4f,
    // Steepness of a surfel's rim: how much opacity falls per σ², or w; squared radius in σ²; depths at the ends of the
    // colour ramp.
    surfel: vec4f,
    // Depths within which two surfels have no certain order, 0 in strict order, and over which a Gaussian fades behind a layer,
    // in margins.
    margins: vec4f,
    // Surfels, Gaussians, K, display.
    counts: vec4u,
    // Texels per colour, kind of colour (0 lobes, 1 harmonics), lobes or coefficients, switches.
    colour: vec4u,
    // Coefficients of the environment: red, green, blue.
    environment: array<vec4f, 16>,
}

const LITERAL_LOOKUP: u32 = 1u;
// Rims end at 0, layers mix, Gaussians fade.
const CONTINUOUS: u32 = 32u;
const CLAMP_COLOURS: u32 = 2u;
const ENCODE_SRGB: u32 = 4u;
const PLAIN_FILTER: u32 = 8u;
// A fragment of blended Gaussians covers at most 0.99 of a pixel, else 0.999.
const LOW_CAP: u32 = 16u;

const CUTOFF: f32 = 1.0 / 255.0;
// Behind every clip volume: what is placed here is never rasterised.
const NOWHERE = vec4f(2.0, 2.0, 2.0, 1.0);

@group(0) @binding(0) var<uniform> frame: Frame;

fn switched(on: u32) -> bool {
    return (frame.colour.w & on) != 0u;
}

// Where a grid has texel `index`.
fn texel(index: u32) -> vec2u {
    let log2_width = u32(frame.size.w);
    return vec2u(index & ((1u << log2_width) - 1u), index >> log2_width);
}

// The index of the texel that a fragment of a grid fills.
fn index_of(position: vec4f) -> u32 {
    return (u32(position.y) << u32(frame.size.w)) + u32(position.x);
}

// Two triangles as a strip: the corners of the square from −1 to 1.
fn corner_of(vertex: u32) -> vec2f {
    return vec2f(f32(vertex & 1u), f32(vertex >> 1u)) * 2.0 - 1.0;
}

// One triangle that covers everything, at `depth`.
fn everywhere(vertex: u32, depth: f32) -> vec4f {
    return vec4f(f32(vertex & 1u) * 4.0 - 1.0, f32(vertex >> 1u) * 4.0 - 1.0, depth, 1.0);
}

fn in_camera(world: vec3f) -> vec3f {
    let at = vec4f(world, 1.0);
    return vec3f(dot(frame.row_x, at), dot(frame.row_y, at), dot(frame.row_z, at));
}

// Rotates a direction from world to camera axes.
fn turned(world: vec3f) -> vec3f {
    return vec3f(dot(frame.row_x.xyz, world), dot(frame.row_y.xyz, world), dot(frame.row_z.xyz, world));
}

// Clip position of a point at a position in px; depth is near / z: 1 at the near plane, 0 infinitely far away.
fn at_px(px: vec2f, depth: f32) -> vec4f {
    let unit = px / frame.size.xy * 2.0 - 1.0;
    return vec4f(unit.x, -unit.y, depth, 1.0);
}

fn project(camera: vec3f) -> vec4f {
    let px = frame.lens.xy * camera.xy + frame.lens.zw * camera.z;
    let unit = px / frame.size.xy * 2.0 - camera.z;
    return vec4f(unit.x, -unit.y, frame.centre_near.w, camera.z);
}

// Columns of the rotation of a packed quaternion.
fn rotation(packed: vec2u) -> mat3x3f {
    let q = normalize(vec4f(unpack2x16snorm(packed.x), unpack2x16snorm(packed.y)));
    let w = q.x;
    let v = q.yzw;
    let twice = 2.0 * v;
    return mat3x3f(
        vec3f(1.0 - twice.y * v.y - twice.z * v.z, twice.x * v.y + twice.z * w, twice.x * v.z - twice.y * w),
        vec3f(twice.x * v.y - twice.z * w, 1.0 - twice.x * v.x - twice.z * v.z, twice.y * v.z + twice.x * w),
        vec3f(twice.x * v.z + twice.y * w, twice.y * v.z - twice.x * w, 1.0 - twice.x * v.x - twice.y * v.y),
    );
}

// Scales of a Gaussian from packed log-scales.
fn scales_of(words: vec2u) -> vec3f {
    let steps = vec3u(words.x & 0x1fffffu, (words.x >> 21u) | ((words.y & 0x3ffu) << 11u), (words.y >> 10u) & 0x1fffffu);
    return exp(vec3f(steps) / 2097151.0 * 64.0 - 32.0);
}
