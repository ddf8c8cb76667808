// One fragment per Gaussian: the ellipse that it projects to (EWA) and its colour, in eight words.
//
// first: centre in px, near / z or 0 if nothing of it is visible, red and green as halves.
// second: major semi-axis of one σ in px, length of the minor one, blue and strength as halves.

@group(1) @binding(0) var places: texture_2d<f32>;
@group(1) @binding(1) var forms: texture_2d<u32>;
@group(1) @binding(2) var colours: texture_2d<u32>;

// Added to the diagonal of the projected covariance, px² (GES, 3DGS).
const COMPENSATED_LOW_PASS: f32 = 0.1;
const PLAIN_LOW_PASS: f32 = 0.3;
// Lower bound of the squared factor by which the low-pass filter dims a Gaussian (GES).
const MIN_COMPENSATION_SQUARED: f32 = 2.5e-5;
// The Jacobian is evaluated at most this fraction of the image size outside the image (3DGS).
const JACOBIAN_MARGIN: f32 = 0.15;

struct Record {
    @location(0) first: vec4u,
    @location(1) second: vec4u,
}

@vertex
fn vertex(@builtin(vertex_index) at: u32) -> @builtin(position) vec4f {
    return everywhere(at, 0.0);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> Record {
    let index = index_of(position);
    var record = Record(vec4u(0u), vec4u(0u));
    let place = textureLoad(places, texel(index), 0);
    let camera = in_camera(place.xyz);
    let z = camera.z;
    if index >= frame.counts.y || !(z > frame.centre_near.w) || !(place.w >= CUTOFF) {
        return record;
    }
    let form = textureLoad(forms, texel(index), 0);
    let margin = JACOBIAN_MARGIN * frame.size.xy / frame.lens.xy;
    let lowest = -frame.lens.zw / frame.lens.xy - margin;
    let highest = (frame.size.xy - frame.lens.zw) / frame.lens.xy + margin;
    let slope = clamp(camera.xy / z, lowest, highest);
    let axes = rotation(form.xy);
    let scales = scales_of(form.zw);
    let across = (frame.row_x.xyz - frame.row_z.xyz * slope.x) * (frame.lens.x / z);
    let down = (frame.row_y.xyz - frame.row_z.xyz * slope.y) * (frame.lens.y / z);
    let half_x = (across * axes) * scales;
    let half_y = (down * axes) * scales;
    let plain = (frame.colour.w & PLAIN_FILTER) != 0u;
    let low_pass = select(COMPENSATED_LOW_PASS, PLAIN_LOW_PASS, plain);
    let a = dot(half_x, half_x) + low_pass;
    let b = dot(half_x, half_y);
    let c = dot(half_y, half_y) + low_pass;
    let minors = cross(half_x, half_y);
    let unfiltered = dot(minors, minors);
    let determinant = unfiltered + low_pass * (a + c - low_pass);
    let dimmed = sqrt(max(unfiltered / determinant, MIN_COMPENSATION_SQUARED));
    let compensation = select(dimmed, 1.0, plain);
    let strength = place.w * compensation;
    if !(strength >= CUTOFF) || !(determinant > 0.0) || !(determinant < 3e38) {
        return record;
    }

    let centre = frame.lens.xy * camera.xy / z + frame.lens.zw;
    let reach = sqrt(2.0 * log(strength / CUTOFF));
    let extent = reach * sqrt(vec2f(a, c));
    if any(centre + extent < vec2f(0.0)) || any(centre - extent > frame.size.xy) || max(extent.x, extent.y) < frame.size.z {
        return record;
    }
    let difference = 0.5 * (a - c);
    let largest = 0.5 * (a + c) + sqrt(difference * difference + b * b);
    // of the two forms of the eigenvector, that which does not cancel
    var direction = select(vec2f(b, largest - a), vec2f(largest - c, b), difference >= 0.0);
    let length_squared = dot(direction, direction);
    direction = select(vec2f(1.0, 0.0), direction * inverseSqrt(length_squared), length_squared > 0.0);
    let major = direction * sqrt(largest);
    let minor = sqrt(determinant / largest);

    let colour = colour_of(colours, index, place.xyz);
    record.first = vec4u(bitcast<vec2u>(centre), bitcast<u32>(frame.centre_near.w / z), pack2x16float(colour.xy));
    record.second = vec4u(bitcast<vec2u>(major), bitcast<u32>(minor), pack2x16float(vec2f(colour.z, min(strength, 65504.0))));
    return record;
}
