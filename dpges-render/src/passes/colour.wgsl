// The colour of a primitive from the camera, out of its packed words.

fn word(colours: texture_2d<u32>, first: u32, at: u32) -> u32 {
    return textureLoad(colours, texel(first + (at >> 2u)), 0)[at & 3u];
}

fn rgb(colours: texture_2d<u32>, first: u32, at: u32) -> vec3f {
    return vec3f(unpack2x16float(word(colours, first, at)), unpack2x16float(word(colours, first, at + 1u)).x);
}

fn octahedron(packed: u32) -> vec3f {
    let point = unpack2x16snorm(packed);
    let z = 1.0 - abs(point.x) - abs(point.y);
    let fold = max(-z, 0.0);
    return normalize(vec3f(point - select(vec2f(-fold), vec2f(fold), point >= vec2f(0.0)), z));
}

fn harmonic(at: u32, d: vec3f) -> f32 {
    let square = d * d;
    switch at {
        case 0u: { return -0.48860251190291992 * d.y; }
        case 1u: { return 0.48860251190291992 * d.z; }
        case 2u: { return -0.48860251190291992 * d.x; }
        case 3u: { return 1.0925484305920792 * d.x * d.y; }
        case 4u: { return -1.0925484305920792 * d.y * d.z; }
        case 5u: { return 0.31539156525252005 * (2.0 * square.z - square.x - square.y); }
        case 6u: { return -1.0925484305920792 * d.x * d.z; }
        case 7u: { return 0.54627421529603959 * (square.x - square.y); }
        case 8u: { return -0.59004358992664352 * d.y * (3.0 * square.x - square.y); }
        case 9u: { return 2.8906114426405538 * d.x * d.y * d.z; }
        case 10u: { return -0.45704579946446577 * d.y * (4.0 * square.z - square.x - square.y); }
        case 11u: { return 0.37317633259011546 * d.z * (2.0 * square.z - 3.0 * square.x - 3.0 * square.y); }
        case 12u: { return -0.45704579946446577 * d.x * (4.0 * square.z - square.x - square.y); }
        case 13u: { return 1.4453057213202769 * d.z * (square.x - square.y); }
        default: { return -0.59004358992664352 * d.x * (square.x - 3.0 * square.y); }
    }
}

fn colour_of(colours: texture_2d<u32>, index: u32, place: vec3f) -> vec3f {
    let first = index * frame.colour.x;
    let away = place - frame.centre_near.xyz;
    let direction = away / max(length(away), 1e-12);
    var colour = rgb(colours, first, 0u);
    if frame.colour.y == 0u {
        for (var lobe = 0u; lobe < frame.colour.z; lobe++) {
            let at = 2u + 3u * lobe;
            let strong = unpack2x16float(word(colours, first, at + 1u));
            let cosine = dot(direction, octahedron(word(colours, first, at + 2u)));
            if cosine > 0.0 {
                let lit = pow(cosine, strong.y);
                colour += vec3f(unpack2x16float(word(colours, first, at)), strong.x) * lit;
            }
        }
    } else {
        for (var at = 0u; at < frame.colour.z; at++) {
            colour += rgb(colours, first, 2u + 2u * at) * harmonic(at, direction);
        }
    }
    return select(colour, max(colour, vec3f(0.0)), switched(CLAMP_COLOURS));
}
