"""Specification of Gaussians that rays meet without a projection, blended as a core and a tail (HTGS), in float64 NumPy.

Rays are whitened one by one: o + t d becomes S^-1 R^T (o - mu) + t S^-1 R^T d, and r^2 is the least squared distance from the
origin. Which fragments are the core carries no gradient. Everything else is as in `model.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import autograd.numpy as np
import numpy
from autograd.tracer import getval as stop_gradient

import model

CORE = 16
CORE_ALPHA = 0.05
MAX_ALPHA = 0.9999
MIN_TRANSMITTANCE = 1e-4
TRANSPARENCIES = ["hybrid", "nearest", "sorted", "tail"]


class Blended(NamedTuple):
    image: np.ndarray  # [H, W, 3]
    alpha: np.ndarray  # [H, W]
    depth: np.ndarray  # [H, W] sum of w z, z where alpha is largest along the ray


class Rounding(NamedTuple):
    """Errors of a computation in less than float64, to see whether a core depends on them."""

    depths: numpy.random.Generator | None = None
    size: float = 0.0
    least: float = 1.0  # factor of the least alphas


def fragments(gaussians, camera, rounding):
    """Alpha and z at every pixel, [H * W, M]; alpha is 0 where there is no fragment."""
    axes = model.rotation_matrices(gaussians.quaternions)
    scales = np.exp(gaussians.log_scales)
    x, y = model.pixel_grid(camera)
    along = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], 1) @ camera.rotation
    direction = np.einsum("pa,mac->pmc", along, axes) / scales
    origin = np.einsum("ma,mac->mc", model.camera_centre(camera) - gaussians.positions, axes) / scales
    depths = -np.sum(origin * direction, 2) / np.sum(direction**2, 2)
    squared = np.sum((origin + depths[..., None] * direction) ** 2, 2)
    weights = np.maximum(gaussians.opacities, 0.0) * np.exp(-0.5 * squared)
    fixed = [stop_gradient(value) for value in (gaussians.positions, gaussians.opacities, axes, scales)]
    positions, opacities, axes, scales = fixed
    centres = positions @ camera.rotation.T + camera.translation
    radii = numpy.sqrt(2.0 * numpy.log(numpy.maximum(opacities / model.CUTOFF, 1.0)))
    ahead = numpy.linalg.norm(numpy.einsum("a,mac->mc", camera.rotation[2], axes) * scales, axis=1)
    exists = centres[:, 2] - radii * ahead > camera.near
    alpha = np.where(weights < MAX_ALPHA, weights, MAX_ALPHA)
    return np.where(exists & (weights >= model.CUTOFF * rounding.least), alpha, 0.0), depths, centres[:, 2]


def pick(values, order):
    """The columns `order` [P, K] of `values` [P, M]; column M is 0."""
    padded = np.concatenate([values, np.zeros((values.shape[0], 1))], 1)
    return padded[numpy.arange(values.shape[0])[:, None], order]


def cores(alpha, depths, transparency, rounding):
    """[P, K] the Gaussians that have an order in each pixel, nearest first, then M."""
    pixels, count = alpha.shape
    if transparency == "tail":
        return numpy.full((pixels, 1), count)
    errors = rounding.depths.uniform(-1.0, 1.0, depths.shape) if rounding.depths else 0.0
    keys = numpy.where(alpha >= CORE_ALPHA * rounding.least, depths * (1.0 + errors * rounding.size), numpy.inf)
    order = numpy.argsort(keys, 1, kind="stable")
    order = numpy.where(numpy.isinf(numpy.take_along_axis(keys, order, 1)), count, order)
    return order[:, :CORE]


def weights_of(alpha, depths, centre_depths, transparency, rounding):
    """Weights of all fragments [P, M]."""
    fixed = stop_gradient(alpha)
    pixels, count = fixed.shape
    if transparency == "sorted":
        order = numpy.broadcast_to(numpy.argsort(centre_depths, kind="stable"), (pixels, count))
    else:
        order = cores(fixed, stop_gradient(depths), transparency, rounding)
    core = pick(alpha, order)
    behind = numpy.cumprod(1.0 - stop_gradient(core), 1)
    stays = numpy.logical_and.accumulate(behind >= MIN_TRANSMITTANCE, 1)
    # the fragment that ends a pixel is blended
    stays = numpy.concatenate([numpy.ones((pixels, 1), bool), stays[:, :-1]], 1)
    core = np.where(stays, core, 0.0)
    through = [np.ones(pixels)]
    for k in range(core.shape[1]):
        through.append(through[-1] * (1.0 - core[:, k]))
    covered = core * np.stack(through[:-1], 1)
    places = numpy.zeros((pixels, core.shape[1], count + 1))
    numpy.put_along_axis(places, order[..., None], 1.0, 2)
    weights = np.einsum("pk,pkm->pm", covered, places[..., :count])
    if transparency in ("hybrid", "tail"):
        in_core = places[..., :count].any(1)
        tail = np.where(in_core, 0.0, alpha)
        total = np.sum(tail, 1)
        hidden = 1.0 - np.exp(np.sum(np.log(1.0 - tail), 1))
        goes_on = (behind[:, -1] >= MIN_TRANSMITTANCE) & (stop_gradient(total) > 0.0)
        share = np.where(goes_on, through[-1] * hidden / np.where(goes_on, total, 1.0), 0.0)
        weights = weights + share[:, None] * tail
    return weights


def render(gaussians, camera, background, transparency, rounding=Rounding()):
    alpha, depths, centre_depths = fragments(gaussians, camera, rounding)
    weights = weights_of(alpha, depths, centre_depths, transparency, rounding)
    colours = np.maximum(model.evaluate_colour(gaussians.colour, gaussians.positions, model.camera_centre(camera)), 0.0)
    total = np.sum(weights, 1)
    image = weights @ colours + (1.0 - total)[:, None] * background
    shape = (camera.height, camera.width)
    depth = np.sum(np.where(stop_gradient(weights) > 0.0, weights * depths, 0.0), 1)
    return Blended(image.reshape((*shape, 3)), total.reshape(shape), depth.reshape(shape))


def is_robust(gaussians, camera, background, transparency, of_depths=2e-6, of_least=1e-5, trials=3):
    """Whether rounding leaves the core alone, or changes nothing that is seen."""
    exact = render(gaussians, camera, background, transparency).image
    for trial in range(trials):
        rng = numpy.random.default_rng(trial)
        rounding = Rounding(rng, of_depths, (1.0, 1.0 - of_least, 1.0 + of_least)[trial % 3])
        again = render(gaussians, camera, background, transparency, rounding).image
        if not numpy.allclose(again, exact, rtol=0.0, atol=1e-12):
            return False
    return True
