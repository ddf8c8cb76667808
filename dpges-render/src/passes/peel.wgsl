// The nearest fragment of surfels at every pixel that is behind the previous layer, found by the depth test.
//
// A layer is (near / z as bits, index of the surfel), and its opacity. The nearest is the largest in the first, then
// the smallest in the second. OPAQUE marks a fragment behind which there is nothing, and pixels without a fragment.

@group(1) @binding(0) var places: texture_2d<f32>;
@group(1) @binding(1) var forms: texture_2d<u32>;
@group(1) @binding(2) var previous: texture_2d<u32>;

const OPAQUE: u32 = 0x80000000u;
const LARGEST_LOG_SCALE: f32 = 80.0;

struct Corner {
    @builtin(position) @invariant position: vec4f,
    // in σ
    @location(0) uv: vec2f,
    @location(1) @interpolate(flat, either) index: u32,
}

struct Layer {
    @location(0) nearest: vec2u,
    @location(1) opacity: f32,
}

@vertex
fn vertex(@builtin(vertex_index) at: u32, @builtin(instance_index) index: u32) -> Corner {
    let place = textureLoad(places, texel(index), 0).xyz;
    let form = textureLoad(forms, texel(index), 0);
    let camera = in_camera(place);
    let axes = rotation(form.xy);
    let scales = exp(min(bitcast<vec2f>(form.zw), vec2f(LARGEST_LOG_SCALE)));
    let reach = sqrt(frame.surfel.y);
    let radius = reach * max(scales.x, scales.y);
    let near = frame.centre_near.w;
    let radius_px = max(frame.lens.x, frame.lens.y) * radius / max(camera.z, near);
    var corner: Corner;
    corner.index = index;
    corner.uv = corner_of(at) * reach;
    let offset = axes[0] * (scales.x * corner.uv.x) + axes[1] * (scales.y * corner.uv.y);
    corner.position = project(camera + turned(offset));
    if camera.z + radius <= near || radius_px < frame.size.z {
        corner.position = NOWHERE;
    }
    return corner;
}

fn layer_of(corner: Corner) -> Layer {
    let squared = dot(corner.uv, corner.uv);
    let opacity = min(1.0, frame.surfel.x * exp(-0.5 * squared));
    let mark = select(0u, OPAQUE, opacity >= 1.0);
    return Layer(vec2u(bitcast<u32>(corner.position.z), corner.index | mark), opacity);
}

fn outside(corner: Corner) -> bool {
    return dot(corner.uv, corner.uv) > frame.surfel.y;
}

@fragment
fn first(corner: Corner) -> Layer {
    if outside(corner) {
        discard;
    }
    return layer_of(corner);
}

@fragment
fn next(corner: Corner) -> Layer {
    let before = textureLoad(previous, vec2u(corner.position.xy), 0).xy;
    let depth = corner.position.z;
    let depth_before = bitcast<f32>(before.x);
    let behind = depth < depth_before || (depth == depth_before && corner.index > (before.y & ~OPAQUE));
    if outside(corner) || !behind || before.y >= OPAQUE {
        discard;
    }
    return layer_of(corner);
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
    return Layer(vec2u(0u), 0.0);
}

// Counts fragments of surfels.
@fragment
fn count(corner: Corner) -> @location(0) vec4f {
    if outside(corner) {
        discard;
    }
    return vec4f(0.0, 0.0, 0.0, 1.0);
}
