// One corner of the quad around the ellipse of a Gaussian, out of the words of `project.wgsl`. Offsets from the centre are
// computed from positions, not interpolated between corners, for the reason that `peel.wgsl` says.

struct EllipseCorner {
    // px
    place: vec2f,
    centre: vec2f,
    // of the two semi-axes, 1 / px
    inverse: vec4f,
    colour_strength: vec4f,
}

fn ellipse_corner(first: vec4u, second: vec4u, at: u32) -> EllipseCorner {
    let blue_strength = unpack2x16float(second.w);
    let offset = corner_of(at) * sqrt(max(2.0 * log(blue_strength.y / CUTOFF), 0.0));
    let major = bitcast<vec2f>(second.xy);
    let minor = bitcast<f32>(second.z);
    let across = normalize(vec2f(-major.y, major.x));
    let centre = bitcast<vec2f>(first.xy);
    let place = centre + offset.x * major + offset.y * minor * across;
    let inverse = vec4f(major / dot(major, major), across / minor);
    return EllipseCorner(place, centre, inverse, vec4f(unpack2x16float(first.w), blue_strength));
}

// Squared distance from the centre in σ.
fn squared_distance(position: vec4f, centre: vec2f, inverse: vec4f) -> f32 {
    let d = position.xy - centre;
    let offset = vec2f(dot(inverse.xy, d), dot(inverse.zw, d));
    return dot(offset, offset);
}
