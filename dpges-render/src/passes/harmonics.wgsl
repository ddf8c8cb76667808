// Spherical harmonics above degree 0: `at` 0 to 14 for Y1 to Y15.
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
