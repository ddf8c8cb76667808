// The nearest fragment of surfels at every pixel that is behind the previous layer, found by the depth test.
//
// A layer is (near / z as bits, index of the surfel), and its opacity. The nearest is the largest in the first, then
// the smallest in the second. `Layer` and `depth_of` are those of `depth_rasterised` or of `depth_computed`,
// `fade_of` that of `fade_whole` or of `fade_paged`: it changes the size.
//
// With continuous peeling, the cores come first: the nearest opaque fragments, as layers. The others are peeled from the
// fragments up to a little behind them, which the depth test ends.

@group(1) @binding(0) var places: texture_2d<f32>;
@group(1) @binding(1) var forms: texture_2d<u32>;
@group(1) @binding(2) var previous: texture_2d<u32>;
@group(1) @binding(3) var cores: texture_2d<u32>;

const LARGEST_LOG_SCALE: f32 = 80.0;

// Where the ray of a pixel meets the disc: u, v and r·n are linear in the position, relative to an anchor in px, which is
// the projected centre where there is one. They are not interpolated between the corners: rasterisers move corners to
// steps of up to 1/16 px.
struct Corner {
    @builtin(position) @invariant position: vec4f,
    // anchor, u and v there times r·n
    @location(0) @interpolate(flat, either) anchor: vec4f,
    // slopes of u r·n and of v r·n
    @location(1) @interpolate(flat, either) slopes: vec4f,
    // r·n at the anchor, its slopes
    @location(2) @interpolate(flat, either) facing: vec3f,
    // near / z at the anchor, and what a unit of r·n adds to it
    @location(3) @interpolate(flat, either) depths: vec2f,
    @location(4) @interpolate(flat, either) index: u32,
}

// Corners lie further out than the disc, by a share and in px, so that no step of theirs cuts it.
const WIDER: f32 = 1.01;
const WIDER_PX: f32 = 0.125;

@vertex
fn vertex(@builtin(vertex_index) at: u32, @builtin(instance_index) index: u32) -> Corner {
    return corner_of_disc(at, index, frame.surfel.y);
}

// A corner of the opaque part of a disc.
@vertex
fn core_vertex(@builtin(vertex_index) at: u32, @builtin(instance_index) index: u32) -> Corner {
    return corner_of_disc(at, index, max(frame.surfel.y - 1.0 / frame.surfel.x, 0.0));
}

// A corner of the disc up to a squared radius in σ.
fn corner_of_disc(at: u32, index: u32, squared_reach: f32) -> Corner {
    let place = textureLoad(places, texel(index), 0).xyz;
    let form = textureLoad(forms, texel(index), 0);
    let camera = in_camera(place);
    let axes = rotation(form.xy);
    let scales = exp(min(bitcast<vec2f>(form.zw), vec2f(LARGEST_LOG_SCALE))) * fade_of(index);
    let reach = sqrt(squared_reach);
    let radius = sqrt(frame.surfel.y) * max(scales.x, scales.y);
    let near = frame.centre_near.w;
    let radius_px = max(frame.lens.x, frame.lens.y) * radius / max(camera.z, near);
    let u = turned(axes[0]);
    let v = turned(axes[1]);
    let n = turned(axes[2]);
    let focal = frame.lens.xy;
    let centred = camera.z > near;
    let ray = select(vec3f(0.0, 0.0, 1.0), camera / camera.z, centred);
    let along_u = cross(v, camera) / scales.x;
    let along_v = cross(camera, u) / scales.y;
    let at_anchor = select(vec2f(dot(ray, along_u), dot(ray, along_v)), vec2f(0.0), centred);
    var corner: Corner;
    corner.index = index;
    corner.anchor = vec4f(ray.xy * focal + frame.lens.zw, at_anchor);
    corner.slopes = vec4f(along_u.xy / focal, along_v.xy / focal);
    corner.facing = vec3f(dot(ray, n), n.xy / focal);
    let per_facing = near / dot(n, camera);
    corner.depths = vec2f(select(per_facing * corner.facing.x, near / camera.z, centred), per_facing);
    let wider = WIDER_PX * max(camera.z, near) / max(focal.x, focal.y);
    let sides = (WIDER * reach * scales + wider) * corner_of(at);
    corner.position = project(camera + u * sides.x + v * sides.y);
    if centred {
        let across = focal / camera.z;
        let u_px = (u.xy - ray.xy * u.z) * across * scales.x;
        let v_px = (v.xy - ray.xy * v.z) * across * scales.y;
        corner.position = widened(corner.position, u_px, v_px, corner_of(at));
    }
    if camera.z + radius <= near || radius_px < frame.size.z {
        corner.position = NOWHERE;
    }
    return corner;
}

// Squared distance from the centre in σ.
fn squared_radius(corner: Corner) -> f32 {
    let d = corner.position.xy - corner.anchor.xy;
    let facing = corner.facing.x + dot(corner.facing.yz, d);
    let hit = corner.anchor.zw + vec2f(dot(corner.slopes.xy, d), dot(corner.slopes.zw, d));
    return dot(hit, hit) / (facing * facing);
}

fn opacity_at(squared: f32) -> f32 {
    let end = frame.surfel.y - squared;
    return min(1.0, frame.surfel.x * select(exp(-0.5 * squared), end, switched(CONTINUOUS)));
}

fn layer_of(corner: Corner, squared: f32) -> Layer {
    let opacity = opacity_at(squared);
    let mark = select(0u, OPAQUE, opacity >= 1.0);
    let depth = depth_of(corner);
    return layer_at(vec2u(bitcast<u32>(depth), corner.index | mark), opacity, depth);
}

// Also for an edge-on disc, which no ray meets.
fn outside(squared: f32) -> bool {
    return !(squared < frame.surfel.y);
}

fn is_behind_previous(corner: Corner) -> bool {
    let before = textureLoad(previous, vec2u(corner.position.xy), 0).xy;
    let depth = depth_of(corner);
    let depth_before = bitcast<f32>(before.x);
    let behind = depth < depth_before || (depth == depth_before && corner.index > (before.y & ~OPAQUE));
    return behind && before.y != NOTHING;
}

fn is_core(corner: Corner) -> bool {
    return (textureLoad(cores, vec2u(corner.position.xy), 0).y & ~OPAQUE) == corner.index;
}

@fragment
fn core(corner: Corner) -> Core {
    let squared = squared_radius(corner);
    if outside(squared) || opacity_at(squared) < 1.0 {
        discard;
    }
    let depth = depth_of(corner);
    return core_at(vec2u(bitcast<u32>(depth), corner.index | OPAQUE), depth);
}

@fragment
fn first(corner: Corner) -> Layer {
    let squared = squared_radius(corner);
    if outside(squared) {
        discard;
    }
    return layer_of(corner, squared);
}

@fragment
fn next(corner: Corner) -> Layer {
    let squared = squared_radius(corner);
    let before = textureLoad(previous, vec2u(corner.position.xy), 0).y;
    if outside(squared) || before >= OPAQUE || !is_behind_previous(corner) {
        discard;
    }
    return layer_of(corner, squared);
}

@fragment
fn first_other(corner: Corner) -> Layer {
    let squared = squared_radius(corner);
    if outside(squared) || is_core(corner) {
        discard;
    }
    return layer_of(corner, squared);
}

@fragment
fn next_other(corner: Corner) -> Layer {
    let squared = squared_radius(corner);
    if outside(squared) || is_core(corner) || !is_behind_previous(corner) {
        discard;
    }
    return layer_of(corner, squared);
}

// Before the next layer: pixels at which no other layer can be are closed at the near plane, so that the depth test
// ends what would be shaded there.
@vertex
fn close_vertex(@builtin(vertex_index) at: u32) -> @builtin(position) vec4f {
    return everywhere(at, 1.0);
}

@fragment
fn close(@builtin(position) position: vec4f) -> Layer {
    if textureLoad(previous, vec2u(position.xy), 0).y < OPAQUE {
        discard;
    }
    return layer_at(vec2u(0u), 0.0, position.z);
}

struct Start {
    @location(0) nearest: vec2u,
    @location(1) opacity: f32,
    @builtin(frag_depth) depth: f32,
}

// Before a layer that is peeled beside the cores: the depth test ends what is too far behind a core to be seen.
@vertex
fn open_vertex(@builtin(vertex_index) at: u32) -> @builtin(position) vec4f {
    return everywhere(at, 0.0);
}

// near / z up to which fragments are layers; 0 without a core.
fn end_of_layers(at: vec2u) -> f32 {
    let core = textureLoad(cores, at, 0).xy;
    if core.y == NOTHING {
        return 0.0;
    }
    let near = frame.centre_near.w;
    let margin = textureLoad(places, texel(core.y & ~OPAQUE), 0).w;
    let end = near / (near / bitcast<f32>(core.x) + frame.margins.x * margin);
    // fragments at this depth pass
    return bitcast<f32>(bitcast<u32>(end) - 1u);
}

@fragment
fn start_first(@builtin(position) position: vec4f) -> Start {
    return Start(vec2u(0u), 0.0, max(position.z, end_of_layers(vec2u(position.xy))));
}

@fragment
fn start_next(@builtin(position) position: vec4f) -> Start {
    let at = vec2u(position.xy);
    let closed = textureLoad(previous, at, 0).y == NOTHING;
    return Start(vec2u(0u), 0.0, max(position.z, select(end_of_layers(at), 1.0, closed)));
}

// Counts fragments of surfels.
@fragment
fn count(corner: Corner) -> @location(0) vec4f {
    if outside(squared_radius(corner)) {
        discard;
    }
    return vec4f(0.0, 0.0, 0.0, 1.0);
}
