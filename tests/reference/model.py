"""Specification of the DP-GES forward model and its losses, in float64 NumPy.

The code is dense and slow on purpose: it evaluates every primitive at every pixel. Nothing is tiled,
culled or approximated. Automatic differentiation of these functions (`autograd`) is the ground truth
for the hand-written kernels, forward and backward. Images of a few thousand pixels with a few hundred
primitives take seconds.

Conventions
-----------
* Cameras have OpenCV axes: x right, y down, z forward. `rotation` [3, 3] and `translation` [3] map world
  to camera: x_camera = rotation @ x_world + translation. Pixel (column i, row j) is sampled at
  (i + 0.5, j + 0.5).
* Quaternions are (w, x, y, z) and stored unnormalised.
* Scales are stored as natural logarithms. The opacity of a Gaussian is stored as it is and used as
  max(0, opacity). It may exceed 1.
* Images are [H, W, C] in display-referred values and are not clamped. Colours may be negative or
  exceed 1.
* The viewing direction of a primitive carries no gradient to its position.

docs/method/method.md of `dpges-core` explains the formulas and names their sources.
"""

from __future__ import annotations

from typing import NamedTuple

import autograd.numpy as np
from autograd.tracer import getval as stop_gradient

CUTOFF = 1.0 / 255.0  # a fragment of a smaller value does not exist
SURFEL_MODULATION = 30.0  # w
LAYER_COUNT = 5  # K
ORDER = 0.1  # depth within which two surfels have no certain order, in margins of the finer one
RAMP = 0.2  # depth over which the test of a Gaussian falls from 1 to 0, in margins of the pixel
LOW_PASS = 0.1  # px^2, added to the projected covariance of a Gaussian
PLAIN_LOW_PASS = 0.3  # px^2, of weighted sums (3DGS)
MIN_COMPENSATION_SQUARED = 2.5e-5
SCALE_LOSS_LINEAR_FROM = 20.0
SH_C0 = 0.28209479177387814


class Camera(NamedTuple):
    rotation: np.ndarray  # [3, 3] world to camera
    translation: np.ndarray  # [3]
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    near: float = 0.01


class Colour(NamedTuple):
    """A base colour and L spherical Beta lobes per primitive."""

    base: np.ndarray  # [N, 3] zeroth-order coefficient k0; contributes 0.5 + SH_C0 * k0
    lobes: np.ndarray  # [N, L, 6] raw (r, g, b, theta, phi, beta)


class Surfels(NamedTuple):
    positions: np.ndarray  # [N, 3]
    quaternions: np.ndarray  # [N, 4]
    log_scales: np.ndarray  # [N, 2]
    colour: Colour
    margins: np.ndarray  # [N] depth margin epsilon, carries no gradient


class Gaussians(NamedTuple):
    positions: np.ndarray  # [M, 3]
    quaternions: np.ndarray  # [M, 4]
    log_scales: np.ndarray  # [M, 3]
    opacities: np.ndarray  # [M] linear, used as max(0, opacity)
    colour: Colour


class SummedGaussians(NamedTuple):
    """Gaussians of a weighted sum: colours and a factor of the opacity by spherical harmonics of degree 3."""

    positions: np.ndarray  # [M, 3]
    quaternions: np.ndarray  # [M, 4]
    log_scales: np.ndarray  # [M, 3]
    opacities: np.ndarray  # [M] linear, used as max(0, opacity)
    opacity_base: np.ndarray  # [M, 1] zeroth-order coefficient of the factor
    opacity_detail: np.ndarray  # [M, 15] its higher coefficients
    colour_base: np.ndarray  # [M, 3] as `Colour.base`
    colour_detail: np.ndarray  # [M, 15, 3] higher coefficients of the colour


class Layers(NamedTuple):
    """K surfel fragments of every pixel, nearest first."""

    ids: np.ndarray  # [H, W, K] integers, -1 where there is no layer
    alpha: np.ndarray  # [H, W, K], 0 where there is no layer
    depth: np.ndarray  # [H, W, K] camera-space z, +inf where there is no layer
    colour: np.ndarray  # [H, W, K, 3]
    normal: np.ndarray  # [H, W, K, 3] world axes, towards the camera
    margin: np.ndarray  # [H, W, K]


class Render(NamedTuple):
    image: np.ndarray  # [H, W, 3] C
    surfel_image: np.ndarray  # [H, W, 3] C_s
    weights: np.ndarray  # [H, W, K] w_i
    transmittance: np.ndarray  # [H, W, K + 1] T_0 = 1 .. T_K
    gaussian_colour: np.ndarray  # [H, W, 3] C_G
    gaussian_weight: np.ndarray  # [H, W] W_G
    surfel_depth: np.ndarray  # [H, W] sum_i w_i D_i
    surfel_normal: np.ndarray  # [H, W, 3] sum_i w_i N_i
    layers: Layers


def rotation_matrices(quaternions):
    """[N, 4] unnormalised (w, x, y, z) to [N, 3, 3]. A zero quaternion gives the identity."""
    squared = np.sum(quaternions**2, axis=-1, keepdims=True)
    defined = squared > 1e-24
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    unit = np.where(defined, quaternions / np.sqrt(np.where(defined, squared, 1.0)), identity)
    w, x, y, z = (unit[:, i] for i in range(4))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def camera_centre(camera):
    return -camera.rotation.T @ camera.translation


def pixel_grid(camera):
    """Centres of the pixels, row-major: x and y, each [H * W]."""
    y, x = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    return x.reshape(-1), y.reshape(-1)


def evaluate_colour(colour, positions, centre):
    """[N, 3] colour seen from `centre`: 0.5 + C0 k0 + sum_l softplus(rgb_l) max(0, d . mu_l)^(4 exp(beta_l)).

    d is the unit vector from `centre` to the primitive. It carries no gradient. The softplus has sharpness
    10 ln 2, so that a raw lobe colour of 0 means 0.1.
    """
    offset = stop_gradient(positions) - centre
    direction = offset / np.maximum(np.sqrt(np.sum(offset**2, -1, keepdims=True)), 1e-12)
    sharpness = 10.0 * np.log(2.0)
    rgb = np.logaddexp(0.0, sharpness * colour.lobes[..., :3]) / sharpness
    theta, phi, beta = (colour.lobes[..., i] for i in (3, 4, 5))
    axis = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    cosine = np.einsum("nla,na->nl", axis, direction)
    lit = cosine > 0.0
    lobe = np.where(lit, np.where(lit, cosine, 1.0) ** (4.0 * np.exp(beta)), 0.0)
    return 0.5 + SH_C0 * colour.base + np.einsum("nl,nlc->nc", lobe, rgb)


def surfel_fragments(surfels, camera, modulation, footprint, peeling):
    """Opacity and depth of every surfel at every pixel, each [H * W, N]. Opacity is 0 where there is no fragment.

    `footprint` "kernel" ends a surfel where G < 1/255 (3.33 sigma), "opacity" where w G < 1/255. If `peeling` is
    "continuous", opacity falls from 1 where w G = 1 to 0 there, evenly with the squared distance from the centre; else it
    is min(1, w G).
    """
    axes = np.einsum("ab,nbc->nac", camera.rotation, rotation_matrices(surfels.quaternions))
    tangent_u, tangent_v, normal = axes[..., 0], axes[..., 1], axes[..., 2]
    centre = surfels.positions @ camera.rotation.T + camera.translation
    x, y = pixel_grid(camera)
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    facing = rays @ normal.T
    defined = np.abs(facing) > 1e-12
    depth = np.sum(normal * centre, -1)[None, :] / np.where(defined, facing, 1.0)
    hit = depth[..., None] * rays[:, None, :] - centre[None]
    scales = np.exp(surfels.log_scales)
    u = np.sum(hit * tangent_u, -1) / scales[:, 0]
    v = np.sum(hit * tangent_v, -1) / scales[:, 1]
    squared = u * u + v * v
    end = -2.0 * np.log({"kernel": CUTOFF, "opacity": CUTOFF / modulation}[footprint])
    core = 2.0 * np.log(modulation)
    if peeling != "continuous":
        rim = modulation * np.exp(-0.5 * squared)
    elif core < end:
        rim = (end - squared) / (end - core)
    else:
        rim = np.where(squared < end, 1.0, 0.0)
    alpha = np.where(rim < 1.0, rim, 1.0)
    exists = defined & (depth > camera.near) & (squared < end)
    return np.where(exists, alpha, 0.0), depth


def nearest(is_core, depth, margin, layer_count, peeling):
    """Whether each fragment of a pixel is a layer, [P, N], for fragments in the order of (depth, index); absent ones are at infinity.

    "nearest" and "literal": the `layer_count` nearest, none behind a core, which is an opaque fragment. "continuous": the
    nearest core, and the `layer_count` - 1 nearest of those that lie before it or so little behind it that their order is
    not certain; without a core the `layer_count` - 1 nearest.
    """
    before = np.cumsum(is_core, -1) - is_core == 0
    present = np.isfinite(depth)
    if peeling != "continuous":
        return present & before & (np.cumsum(present, -1) <= layer_count)
    first = is_core & before
    has_core = np.any(is_core, -1, keepdims=True)
    end = np.sum(np.where(first, depth + ORDER * margin, 0.0), -1, keepdims=True)
    other = present & ~first & (~has_core | (depth <= end))
    return first | (other & (np.cumsum(other, -1) < layer_count))


def peel(surfels, camera, layer_count=LAYER_COUNT, modulation=SURFEL_MODULATION, footprint="kernel", peeling="continuous"):
    """The layers of each pixel, ordered by (depth, surfel index): see `nearest`."""
    alpha, depth = surfel_fragments(surfels, camera, modulation, footprint, peeling)
    pixels, count = alpha.shape
    margins = stop_gradient(surfels.margins)
    if count < layer_count:
        missing = np.zeros((pixels, layer_count - count))
        alpha, depth = np.concatenate([alpha, missing], 1), np.concatenate([depth, missing], 1)
        margins = np.concatenate([margins, missing[0]])
    key = np.where(stop_gradient(alpha) > 0.0, stop_gradient(depth), np.inf)
    order = np.argsort(key, axis=-1, kind="stable")
    of_pixel = np.arange(pixels)[:, None]
    is_core = stop_gradient(alpha)[of_pixel, order] >= 1.0
    is_layer = nearest(is_core, key[of_pixel, order], margins[order], layer_count, peeling)
    place = np.argsort(~is_layer, axis=-1, kind="stable")[:, :layer_count]
    present = is_layer[of_pixel, place]
    order = order[of_pixel, place]
    row = np.where(present, order, count)  # row `count` of `with_zero_row` is zero

    def with_zero_row(values):
        return np.concatenate([values, np.zeros((1, *values.shape[1:]))])

    centre = camera_centre(camera)
    colours = evaluate_colour(surfels.colour, surfels.positions, centre)
    normals = rotation_matrices(surfels.quaternions)[..., 2]
    away = np.sum(normals * (surfels.positions - centre), -1, keepdims=True) > 0
    normals = np.where(away, -normals, normals)
    shape = (camera.height, camera.width, layer_count)
    return Layers(
        ids=np.where(present, order, -1).reshape(shape),
        alpha=np.where(present, alpha[of_pixel, order], 0.0).reshape(shape),
        depth=np.where(present, depth[of_pixel, order], np.inf).reshape(shape),
        colour=with_zero_row(colours)[row].reshape((*shape, 3)),
        normal=with_zero_row(normals)[row].reshape((*shape, 3)),
        margin=with_zero_row(stop_gradient(surfels.margins))[row].reshape(shape),
    )


def behind_share(layers, i, j):
    """[H, W] share of layer i that lies behind layer j: 0 or 1, or between where they are closer than `ORDER` margins."""
    reach = ORDER * np.minimum(layers.margin[..., i], layers.margin[..., j])
    both = (layers.ids[..., i] >= 0) & (layers.ids[..., j] >= 0)
    # an absent layer is at infinity
    distance = np.where(both, layers.depth[..., i], 0.0) - np.where(both, layers.depth[..., j], 0.0)
    is_close = both & (np.abs(stop_gradient(distance)) < reach)
    return np.where(is_close, 0.5 + distance / np.where(is_close, 2.0 * reach, 1.0), 1.0 if i > j else 0.0)


def visibility(layers, peeling):
    """Weights of the layers in the surfel image [H, W, K], transmittances [H, W, K + 1], and the depths between which the
    test of a Gaussian against each layer falls from 1 to 0, each [H, W, K], without gradient.

    "continuous": a layer weighs its opacity times what is left by the others, each as far as it is before it; these products
    are scaled so that they add up to 1 - T_K. A Gaussian is tested with one margin for all layers of a pixel, the mean of
    theirs by weight.
    """
    layer_count = layers.alpha.shape[-1]
    opacities = [layers.alpha[..., k] for k in range(layer_count)]
    through = [np.ones(layers.alpha.shape[:-1])]
    for opacity in opacities:
        through.append(through[-1] * (1.0 - opacity))
    present = layers.ids >= 0
    opaque = stop_gradient(layers.alpha) >= 1.0
    if peeling == "continuous":
        weights = []
        for i in range(layer_count):
            seen = opacities[i]
            for j in range(layer_count):
                if j != i:
                    seen = seen * (1.0 - opacities[j] * behind_share(layers, i, j))
            weights.append(seen)
        total = sum(weights)
        scale = (1.0 - through[-1]) / np.where(stop_gradient(total) > 0.0, total, 1.0)
        weights = [weight * scale for weight in weights]
        by_weight = stop_gradient(np.stack(weights, -1))
        total = np.sum(by_weight, -1, keepdims=True)
        margin = np.sum(by_weight * layers.margin, -1, keepdims=True) / np.where(total > 0.0, total, 1.0)
        ends = stop_gradient(layers.depth) + margin
        half = 0.5 * RAMP * np.broadcast_to(margin, ends.shape)
        cap = np.min(np.where(opaque, ends, np.inf), -1, keepdims=True)
    else:
        weights = [opacities[k] * through[k] for k in range(layer_count)]
        shifted = stop_gradient(layers.depth) + layers.margin
        ends = shifted
        if peeling == "literal":
            # only the cap ends the last interval
            ends = np.concatenate([stop_gradient(layers.depth)[..., :-1], np.full((*shifted.shape[:-1], 1), np.inf)], -1)
        ends = np.stack([np.max(ends[..., : k + 1], -1) for k in range(layer_count)], -1)
        half = np.zeros(ends.shape)
        closed = present[..., -1:] | np.any(opaque, -1, keepdims=True)
        last = np.take_along_axis(shifted, np.maximum(np.sum(present, -1, keepdims=True) - 1, 0), -1)
        cap = np.where(closed, last, np.inf)
    ends = np.minimum(ends, cap)
    return np.stack(weights, -1), np.stack(through, -1), ends - half, ends + half


def project(gaussians, camera, low_pass=LOW_PASS):
    """EWA projection, with `low_pass` px^2 added to the covariance.

    Returns means [M, 2] px, conics [M, 3] (a, b, c of a dx^2 + 2 b dx dy + c dy^2), depths [M],
    compensations [M] and valid [M]. The low-pass filter widens a Gaussian; the compensation, the square root
    of the ratio of the determinants, dims it accordingly.
    """
    centre = gaussians.positions @ camera.rotation.T + camera.translation
    x, y, z = centre[:, 0], centre[:, 1], centre[:, 2]
    valid = z > camera.near
    z = np.where(valid, z, 1.0)
    means = np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], -1)
    margin_x = 0.15 * camera.width / camera.fx
    margin_y = 0.15 * camera.height / camera.fy
    tx = z * np.clip(x / z, -camera.cx / camera.fx - margin_x, (camera.width - camera.cx) / camera.fx + margin_x)
    ty = z * np.clip(y / z, -camera.cy / camera.fy - margin_y, (camera.height - camera.cy) / camera.fy + margin_y)
    zero = np.zeros(z.shape)
    jacobian = np.stack(
        [
            np.stack([camera.fx / z, zero, -camera.fx * tx / z**2], -1),
            np.stack([zero, camera.fy / z, -camera.fy * ty / z**2], -1),
        ],
        -2,
    )
    factor = rotation_matrices(gaussians.quaternions) * np.exp(gaussians.log_scales)[:, None, :]
    half = np.einsum("mab,mbc->mac", np.einsum("mab,bc->mac", jacobian, camera.rotation), factor)
    covariance = np.einsum("mad,mbd->mab", half, half)
    a, b, c = covariance[:, 0, 0] + low_pass, covariance[:, 0, 1], covariance[:, 1, 1] + low_pass
    determinant = a * c - b * b
    # det(half half^T) as a sum of squared 2x2 minors: never negative, no cancellation
    p, q = half[:, 0, :], half[:, 1, :]
    minors = [p[:, i] * q[:, j] - p[:, j] * q[:, i] for i, j in ((1, 2), (2, 0), (0, 1))]
    ratio = sum(minor**2 for minor in minors) / determinant
    compensations = np.sqrt(np.where(ratio > MIN_COMPENSATION_SQUARED, ratio, MIN_COMPENSATION_SQUARED))
    conics = np.stack([c, -b, a], -1) / determinant[:, None]
    return means, conics, centre[:, 2], compensations, valid


def gaussian_fragments(gaussians, camera):
    """Weights of every Gaussian at every pixel [H * W, M], 0 below the cutoff, and depths [M]."""
    means, conics, depths, compensations, valid = project(gaussians, camera)
    x, y = pixel_grid(camera)
    dx, dy = x[:, None] - means[:, 0], y[:, None] - means[:, 1]
    power = -0.5 * (conics[:, 0] * dx * dx + 2 * conics[:, 1] * dx * dy + conics[:, 2] * dy * dy)
    weight = np.maximum(gaussians.opacities, 0.0) * compensations * np.exp(power)
    return np.where(valid & (weight >= CUTOFF), weight, 0.0), depths


def splat(gaussians, camera, starts, ends):
    """Order-free sums per depth interval: [H, W, K, 4] of (sum c alpha, sum alpha).

    The share of a Gaussian that is before a layer is 1 where the depth d of its centre is below `starts`, 0 where it is not
    below `ends`, and falls linearly between. Each interval gets the difference of two neighbouring shares.
    """
    weights, depths = gaussian_fragments(gaussians, camera)
    layer_count = ends.shape[-1]
    depths = stop_gradient(depths)[None, :]
    colours = evaluate_colour(gaussians.colour, gaussians.positions, camera_centre(camera))
    payload = np.concatenate([colours, np.ones((colours.shape[0], 1))], -1)
    sums, share_before = [], np.zeros((ends.shape[0] * ends.shape[1], 1))
    for k in range(layer_count):
        start, end = (limit[..., k].reshape(-1, 1) for limit in (starts, ends))
        is_ramp = np.isfinite(end) & (end > start)
        ramp = np.where(is_ramp, end, 1.0) - np.where(is_ramp, start, 0.0)
        share = np.where(depths < start, 1.0, np.where(depths < end, (np.where(is_ramp, end, 0.0) - depths) / ramp, 0.0))
        sums.append((weights * (share - share_before)) @ payload)
        share_before = share
    return np.stack(sums, 1).reshape((camera.height, camera.width, layer_count, 4))


def harmonics(direction):
    """[..., 16] spherical harmonics of degree 0 to 3 of unit vectors [..., 3] (3DGS)."""
    x, y, z = (direction[..., i] for i in range(3))
    xx, yy, zz = x * x, y * y, z * z
    values = [
        SH_C0 * np.ones(x.shape),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2.0 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3.0 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4.0 * zz - xx - yy),
        0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.4570457994644658 * x * (4.0 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3.0 * yy),
    ]
    return np.stack(values, -1)


def environment_image(coefficients, camera):
    """[H, W, 3] sum_k c_k Y_k(v), where v is the world direction of a pixel's ray, for coefficients [C, 3]."""
    x, y = pixel_grid(camera)
    in_camera = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(x.shape)], -1)
    direction = in_camera @ camera.rotation
    direction = direction / np.sqrt(np.sum(direction**2, -1, keepdims=True))
    values = harmonics(direction)[:, : coefficients.shape[0]] @ coefficients
    return values.reshape((camera.height, camera.width, 3))


def composite(layers, weights, transmittance, sums, background, detach_transmittance=False):
    """Blends the layers by their weights, weighs the Gaussian sums by transmittance, and normalises.

    `background` is one colour [3] or one for every pixel [H, W, 3].

    `detach_transmittance` stops the gradient from the Gaussians to the surfels (ablation).
    """
    surfel_image = np.einsum("hwk,hwkc->hwc", weights, layers.colour) + transmittance[..., -1:] * background
    gate = stop_gradient(transmittance) if detach_transmittance else transmittance
    total = np.einsum("hwk,hwkc->hwc", gate[..., :-1], sums)
    gaussian_colour, gaussian_weight = total[..., :3], total[..., 3]
    image = (surfel_image + gaussian_colour) / (1.0 + gaussian_weight[..., None])
    depth = np.where(layers.ids >= 0, layers.depth, 0.0)
    return Render(
        image=image,
        surfel_image=surfel_image,
        weights=weights,
        transmittance=transmittance,
        gaussian_colour=gaussian_colour,
        gaussian_weight=gaussian_weight,
        surfel_depth=np.sum(weights * depth, -1),
        surfel_normal=np.einsum("hwk,hwkc->hwc", weights, layers.normal),
        layers=layers,
    )


def render(
    surfels,
    gaussians,
    camera,
    background,
    layer_count=LAYER_COUNT,
    modulation=SURFEL_MODULATION,
    footprint="kernel",
    peeling="continuous",
    detach_transmittance=False,
    environment=None,
):
    """`peeling` "continuous" is the model of dpges, "nearest" that of the paper, "literal" the same with the comparison that it
    prints: a Gaussian then counts as before a layer if it is before its bare depth."""
    layers = peel(surfels, camera, layer_count, modulation, footprint, peeling)
    weights, transmittance, starts, ends = visibility(layers, peeling)
    if environment is not None:
        background = background + environment_image(environment, camera)
    sums = splat(gaussians, camera, starts, ends)
    return composite(layers, weights, transmittance, sums, background, detach_transmittance)


def render_summed(gaussians, camera, background, weight, sigma, beta, background_weight):
    """[H, W, 3] image and [H, W] alpha of Gaussians that are summed in any order (weighted sums):

        C = (w_b C_b + sum_i a_i w(d_i) c_i) / (w_b + sum_i a_i w(d_i)),

    a_i = max(0, o_i) max(0, v_i(direction)) G_i. `weight` w(d) is "dir": 1, "exp": exp(-sigma d^beta), or "lc":
    max(0, 1 - d / sigma). The low-pass filter is 0.3 px^2 without compensation, colours below 0 count as 0 (3DGS), and a
    product a_i w(d_i) below 1/255 does not exist.
    """
    means, conics, depths, _, valid = project(gaussians, camera, low_pass=PLAIN_LOW_PASS)
    x, y = pixel_grid(camera)
    dx, dy = x[:, None] - means[:, 0], y[:, None] - means[:, 1]
    power = -0.5 * (conics[:, 0] * dx * dx + 2 * conics[:, 1] * dx * dy + conics[:, 2] * dy * dy)
    offset = stop_gradient(gaussians.positions) - camera_centre(camera)
    values = harmonics(offset / np.maximum(np.sqrt(np.sum(offset**2, -1, keepdims=True)), 1e-12))
    factor = SH_C0 * gaussians.opacity_base[:, 0] + np.sum(values[:, 1:] * gaussians.opacity_detail, -1)
    colour = 0.5 + SH_C0 * gaussians.colour_base + np.einsum("mk,mkc->mc", values[:, 1:], gaussians.colour_detail)
    seen = np.where(valid, depths, 1.0)
    of_depth = {
        "dir": lambda: np.ones(seen.shape),
        "exp": lambda: np.exp(-sigma * seen**beta),
        "lc": lambda: np.maximum(0.0, 1.0 - seen / sigma),
    }[weight]()
    strength = np.maximum(gaussians.opacities, 0.0) * np.maximum(factor, 0.0) * of_depth
    alpha = strength * np.exp(power)
    alpha = np.where(valid & (alpha >= CUTOFF), alpha, 0.0)
    total = np.sum(alpha, -1) + background_weight
    image = (alpha @ np.maximum(colour, 0.0) + background_weight * background) / total[:, None]
    shape = (camera.height, camera.width)
    return image.reshape((*shape, 3)), (np.sum(alpha, -1) / total).reshape(shape)


# --- losses -------------------------------------------------------------------


def blur_matrix(size):
    """[size, size] 11-tap Gaussian window with sigma 1.5 and zero padding."""
    taps = np.exp(-((np.arange(11) - 5.0) ** 2) / (2 * 1.5**2))
    taps = taps / taps.sum()
    offset = np.arange(size)[None, :] - np.arange(size)[:, None] + 5
    return np.where((offset >= 0) & (offset < 11), taps[np.clip(offset, 0, 10)], 0.0)


def ssim(a, b):
    """Mean SSIM of two [H, W, C] images in [0, 1]: 11x11 Gaussian window, zero padding, C1 = 0.01^2, C2 = 0.03^2."""
    rows, columns = blur_matrix(a.shape[0]), blur_matrix(a.shape[1])

    def blur(image):
        return np.einsum("xw,ywc->yxc", columns, np.einsum("yh,hwc->ywc", rows, image))

    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2
    covariance = blur(a * b) - mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    luminance = (2 * mean_a * mean_b + c1) / (mean_a**2 + mean_b**2 + c1)
    return np.mean(luminance * (2 * covariance + c2) / (var_a + var_b + c2))


def rgb_loss(image, target):
    return 0.8 * np.mean(np.abs(image - target)) + 0.2 * (1.0 - ssim(image, target))


def surfel_loss(surfel_image, target):
    return np.mean(np.abs(surfel_image - target))


def scale_loss(log_scales):
    """Mean of exp(x), where x is the mean of a surfel's two scales divided by the mean scale of all surfels.

    The mean over all surfels carries no gradient. Beyond x = 20 the tangent continues exp, so that one huge
    surfel neither overflows nor loses its gradient.
    """
    scales = np.exp(log_scales)
    x = np.mean(scales / np.mean(stop_gradient(scales)), -1)
    clamped = np.minimum(x, SCALE_LOSS_LINEAR_FROM)
    return np.mean(np.exp(clamped) * (1.0 + x - clamped))


def transmittance_loss(result):
    """(1 - T_K)^2 averaged over all pixels. Pixels covered by fewer than two layers contribute nothing."""
    covered = np.sum(result.layers.ids >= 0, -1) >= 2
    return np.mean(np.where(covered, (1.0 - result.transmittance[..., -1]) ** 2, 0.0))


def total_loss(surfels, gaussians, camera, target, background, lambda_s=0.01, lambda_scale=1e-5, lambda_t=0.08, **options):
    """The sum of all losses; without surfels the photometric loss alone."""
    result = render(surfels, gaussians, camera, background, **options)
    if surfels.positions.shape[0] == 0:
        return rgb_loss(result.image, target)
    return (
        rgb_loss(result.image, target)
        + lambda_s * surfel_loss(result.surfel_image, target)
        + lambda_scale * scale_loss(surfels.log_scales)
        + lambda_t * transmittance_loss(result)
    )
