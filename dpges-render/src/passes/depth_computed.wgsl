// Depths of surfels as every fragment computes its own: near / z is linear in the position on the screen.

struct Layer {
    @location(0) nearest: vec2u,
    @location(1) opacity: f32,
    @builtin(frag_depth) depth: f32,
}

struct Core {
    @location(0) nearest: vec2u,
    @builtin(frag_depth) depth: f32,
}

fn depth_of(corner: Corner) -> f32 {
    let d = corner.position.xy - corner.anchor.xy;
    return clamp(corner.depths.x + corner.depths.y * dot(corner.facing.yz, d), 0.0, 1.0);
}

fn layer_at(nearest: vec2u, opacity: f32, depth: f32) -> Layer {
    return Layer(nearest, opacity, depth);
}

fn core_at(nearest: vec2u, depth: f32) -> Core {
    return Core(nearest, depth);
}

// Quads of discs that are seen edge-on are at least twice as wide, px: no step of a corner then misses a fragment.
const HALF_WIDTH_PX: f32 = 0.25;

// A corner moved outwards across the longer axis of the disc on the screen. `sides` are its signs along the axes.
fn widened(corner: vec4f, u_px: vec2f, v_px: vec2f, sides: vec2f) -> vec4f {
    let longer = select(v_px, u_px, dot(u_px, u_px) >= dot(v_px, v_px));
    let across = vec2f(-longer.y, longer.x) / max(length(longer), 1e-30);
    let side = sign(dot(sides.x * u_px + sides.y * v_px, across));
    let moved = 2.0 * HALF_WIDTH_PX * side * across / frame.size.xy * corner.w;
    return vec4f(corner.x + moved.x, corner.y - moved.y, corner.zw);
}
