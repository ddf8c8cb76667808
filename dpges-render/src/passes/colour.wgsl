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
