// Depths of surfels as the rasteriser interpolates them between corners, so that the depth test can come before shading.

struct Layer {
    @location(0) nearest: vec2u,
    @location(1) opacity: f32,
}

struct Core {
    @location(0) nearest: vec2u,
}

fn depth_of(corner: Corner) -> f32 {
    return corner.position.z;
}

fn layer_at(nearest: vec2u, opacity: f32, depth: f32) -> Layer {
    return Layer(nearest, opacity);
}

fn core_at(nearest: vec2u, depth: f32) -> Core {
    return Core(nearest);
}

// A corner moved across the disc would have another depth.
fn widened(corner: vec4f, u_px: vec2f, v_px: vec2f, sides: vec2f) -> vec4f {
    return corner;
}
