// One fragment per primitive: its colour from this camera.

@group(1) @binding(0) var places: texture_2d<f32>;
@group(1) @binding(1) var colours: texture_2d<u32>;

@vertex
fn vertex(@builtin(vertex_index) at: u32) -> @builtin(position) vec4f {
    return everywhere(at, 0.0);
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let index = index_of(position);
    let place = textureLoad(places, texel(index), 0).xyz;
    return vec4f(colour_of(colours, index, place), 1.0);
}
