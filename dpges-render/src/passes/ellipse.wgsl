// One corner of the quad around the ellipse of a Gaussian, out of the words of `project.wgsl`.

struct EllipseCorner {
    // px
    place: vec2f,
    // from the centre, in σ
    offset: vec2f,
    colour_strength: vec4f,
}

fn ellipse_corner(first: vec4u, second: vec4u, at: u32) -> EllipseCorner {
    let blue_strength = unpack2x16float(second.w);
    let offset = corner_of(at) * sqrt(max(2.0 * log(blue_strength.y / CUTOFF), 0.0));
    let major = bitcast<vec2f>(second.xy);
    let minor = normalize(vec2f(-major.y, major.x)) * bitcast<f32>(second.z);
    let place = bitcast<vec2f>(first.xy) + offset.x * major + offset.y * minor;
    return EllipseCorner(place, offset, vec4f(unpack2x16float(first.w), blue_strength));
}
