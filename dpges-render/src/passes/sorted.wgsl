// Gaussians or discs, blended back to front in the order of a list.

@group(1) @binding(0) var order: texture_2d<u32>;
@group(1) @binding(1) var firsts: texture_2d<u32>;
@group(1) @binding(2) var seconds: texture_2d<u32>;
@group(1) @binding(3) var places: texture_2d<f32>;
@group(1) @binding(4) var forms: texture_2d<u32>;
@group(1) @binding(5) var colours: texture_2d<f32>;

struct Ellipse {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat, either) colour_strength: vec4f,
    @location(1) @interpolate(flat, either) inverse: vec4f,
    @location(2) @interpolate(flat, either) centre: vec2f,
}

@vertex
fn ellipse_vertex(@builtin(vertex_index) at: u32, @builtin(instance_index) instance: u32) -> Ellipse {
    let index = textureLoad(order, texel(instance), 0).x;
    let first = textureLoad(firsts, texel(index), 0);
    var corner: Ellipse;
    if first.z == 0u {
        corner.position = NOWHERE;
        return corner;
    }
    let ellipse = ellipse_corner(first, textureLoad(seconds, texel(index), 0), at);
    corner.colour_strength = ellipse.colour_strength;
    corner.inverse = ellipse.inverse;
    corner.centre = ellipse.centre;
    corner.position = at_px(ellipse.place, 0.5);
    return corner;
}

fn blended(colour_strength: vec4f, squared: f32) -> vec4f {
    let weight = colour_strength.w * exp(-0.5 * squared);
    if weight < CUTOFF {
        discard;
    }
    return vec4f(colour_strength.rgb, 1.0) * min(weight, select(0.999, 0.99, switched(LOW_CAP)));
}

@fragment
fn ellipse(corner: Ellipse) -> @location(0) vec4f {
    return blended(corner.colour_strength, squared_distance(corner.position, corner.centre, corner.inverse));
}

@fragment
fn count_ellipse(corner: Ellipse) -> @location(0) vec4f {
    _ = blended(corner.colour_strength, squared_distance(corner.position, corner.centre, corner.inverse));
    return vec4f(0.0, 0.0, 0.0, 1.0);
}

// u, v and r·n are linear in the position; u and v vanish at the projected centre.
struct Disc {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat, either) slopes: vec4f,
    // r·n at the projected centre, its slopes in x and y, n·c
    @location(1) @interpolate(flat, either) facing: vec4f,
    // px: projected centre, centre of the low-pass filter
    @location(2) @interpolate(flat, either) centres: vec4f,
    @location(3) @interpolate(flat, either) colour_strength: vec4f,
}

// The low-pass filter is centred in the box around the disc at this radius, in σ (2DGS).
const LOW_PASS_RADIUS_SQUARED: f32 = 9.0;
// Further away than any disc reaches, px.
const NOWHERE_PX: f32 = 1e15;
const MIN_FACING: f32 = 1e-12;

// Centre and half extent in px of the box around a disc at a radius; `ok` is 0 if it reaches the camera's plane.
struct Bounds {
    centre: vec2f,
    half_extent: vec2f,
    ok: bool,
}

fn bounds_of(c: vec3f, a: vec3f, b: vec3f, squared: f32) -> Bounds {
    let determinant = squared * (a.z * a.z + b.z * b.z) - c.z * c.z;
    let slope = c.xy / c.z;
    let tilt_a = a.xy - slope * a.z;
    let tilt_b = b.xy - slope * b.z;
    let shift = squared * (tilt_a * a.z + tilt_b * b.z) / determinant;
    // half-width of the two tangents: no cancellation for a small disc
    let spread = squared * (tilt_a * tilt_a + tilt_b * tilt_b) / -determinant + shift * shift;
    return Bounds((slope + shift) * frame.lens.xy + frame.lens.zw, sqrt(max(spread, vec2f(0.0))) * frame.lens.xy, determinant < 0.0);
}

@vertex
fn disc_vertex(@builtin(vertex_index) at: u32, @builtin(instance_index) instance: u32) -> Disc {
    let index = textureLoad(order, texel(instance), 0).x;
    let place = textureLoad(places, texel(index), 0);
    let form = textureLoad(forms, texel(index), 0);
    let c = in_camera(place.xyz);
    var corner: Disc;
    if !(c.z > frame.centre_near.w) || !(place.w > CUTOFF) {
        corner.position = NOWHERE;
        return corner;
    }
    let axes = rotation(form.xy);
    let scales = scales_of(form.zw).xy;
    let u = turned(axes[0]);
    let v = turned(axes[1]);
    let n = turned(axes[2]);
    let along_u = cross(v, c) / scales.x;
    let along_v = cross(c, u) / scales.y;
    let ray = c / c.z;
    let focal = frame.lens.xy;
    let squared = 2.0 * log(place.w / CUTOFF);
    corner.slopes = vec4f(along_u.xy / focal, along_v.xy / focal);
    corner.facing = vec4f(dot(ray, n), n.xy / focal, dot(n, c));
    let filtered = bounds_of(c, u * scales.x, v * scales.y, LOW_PASS_RADIUS_SQUARED);
    let anchor = ray.xy * focal + frame.lens.zw;
    corner.centres = vec4f(anchor, select(vec2f(NOWHERE_PX), filtered.centre, filtered.ok));
    corner.colour_strength = vec4f(textureLoad(colours, texel(index), 0).rgb, place.w);

    let disc = bounds_of(c, u * scales.x, v * scales.y, squared);
    var low = vec2f(0.0);
    var high = frame.size.xy;
    if disc.ok {
        low = disc.centre - disc.half_extent;
        high = disc.centre + disc.half_extent;
        if filtered.ok {
            let radius = sqrt(0.5 * squared);
            low = min(low, filtered.centre - radius);
            high = max(high, filtered.centre + radius);
        }
        low = max(low, vec2f(0.0));
        high = min(high, frame.size.xy);
        if any(high <= low) || max(high.x - low.x, high.y - low.y) < 2.0 * frame.size.z {
            corner.position = NOWHERE;
            return corner;
        }
    }
    corner.position = at_px(mix(low, high, corner_of(at) * 0.5 + 0.5), 0.5);
    return corner;
}

fn disc_squared(corner: Disc) -> f32 {
    let d = corner.position.xy - corner.centres.xy;
    let facing = corner.facing.x + dot(corner.facing.yz, d);
    let hit = vec2f(dot(corner.slopes.xy, d), dot(corner.slopes.zw, d)) / facing;
    let on_screen = corner.position.xy - corner.centres.zw;
    if !(abs(facing) > MIN_FACING) || !(corner.facing.w / facing > frame.centre_near.w) {
        discard;
    }
    return min(dot(hit, hit), 2.0 * dot(on_screen, on_screen));
}

@fragment
fn disc(corner: Disc) -> @location(0) vec4f {
    return blended(corner.colour_strength, disc_squared(corner));
}

@fragment
fn count_disc(corner: Disc) -> @location(0) vec4f {
    _ = blended(corner.colour_strength, disc_squared(corner));
    return vec4f(0.0, 0.0, 0.0, 1.0);
}
