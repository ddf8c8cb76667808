// The background and the environment.

const Y0: f32 = 0.28209479177387814;

// The background at a position in px, with the environment if the scene has one.
fn behind(px: vec2f) -> vec3f {
    let coefficients = u32(frame.background.w);
    if coefficients == 0u {
        return frame.background.rgb;
    }
    let ray = vec3f((px - frame.lens.zw) / frame.lens.xy, 1.0);
    let direction = normalize(frame.row_x.xyz * ray.x + frame.row_y.xyz * ray.y + frame.row_z.xyz * ray.z);
    var colour = frame.background.rgb + frame.environment[0].rgb * Y0;
    for (var at = 1u; at < coefficients; at++) {
        colour += frame.environment[at].rgb * harmonic(at - 1u, direction);
    }
    return colour;
}
