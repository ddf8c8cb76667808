"""Specification of Gaussians that are blended in the order of each pixel's own ray (StopThePop), in float64 NumPy.

Alpha and blending are those of 3DGS: EWA with 0.3 px^2 and no compensation. The order is made by queues, one after the
other, of a block of 4 x 4 px, of a quad of 2 x 2 px and of the pixel, out of the list of the tile of 16 x 16 px. It carries
no gradient. Everything else is as in `model.py`.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

import autograd.numpy as np
import numpy
from autograd.tracer import getval as stop_gradient

import model

LOW_PASS = 0.3
MAX_ALPHA = 0.99
MIN_TRANSMITTANCE = 1e-4
MIN_SCALE = 2.5e-4  # over the distance from the camera (StopThePop: 1e-3 world units)
TILE, BLOCK, QUAD = 16, 4, 2
BLOCK_QUEUE, QUAD_QUEUE, PIXEL_QUEUE = 64, 8, 4


class Blended(NamedTuple):
    image: np.ndarray  # [H, W, 3]
    alpha: np.ndarray  # [H, W]
    depth: np.ndarray  # [H, W] sum of alpha T z, z of the centre


class Rounding(NamedTuple):
    """Errors of a computation in less than float64, to see whether an order depends on them."""

    keys: numpy.random.Generator | None = None
    size: float = 0.0
    reach: float = 1.0  # factor of the least alpha in a block


class Queue:
    """At most `capacity` values in the order of their keys; equal keys in the order in which they came."""

    def __init__(self, capacity):
        self.capacity, self.keys, self.values = capacity, [], []

    def push(self, key, value):
        """What leaves, if the queue is full: a list of at most one."""
        leaving = [self.pop()] if len(self.keys) == self.capacity else []
        at = bisect_right(self.keys, key)
        self.keys.insert(at, key)
        self.values.insert(at, value)
        return leaving

    def pop(self):
        self.keys.pop(0)
        return self.values.pop(0)

    def drain(self):
        while self.keys:
            yield self.pop()


class Sight:
    """What decides the order of the Gaussians `rows`, all of it plain numbers."""

    def __init__(self, gaussians, rows, camera, means, conics, strengths, rounding):
        self.camera, self.rounding = camera, rounding
        self.means, self.conics, self.strengths = (stop_gradient(values)[rows] for values in (means, conics, strengths))
        rotation = stop_gradient(model.rotation_matrices(gaussians.quaternions))[rows]
        self.offset = stop_gradient(gaussians.positions)[rows] - model.camera_centre(camera)
        least = MIN_SCALE * numpy.sqrt(numpy.sum(self.offset**2, axis=1, keepdims=True))
        scales = numpy.maximum(numpy.exp(stop_gradient(gaussians.log_scales)[rows]), least)
        self.inverse = numpy.einsum("mac,mc,mbc->mab", rotation, scales**-2, rotation)

    def ray(self, x, y):
        camera = self.camera
        along = camera.rotation.T @ numpy.array([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0])
        return along / numpy.sqrt(numpy.sum(along**2))

    def depth(self, i, ray):
        """t* of Gaussian i."""
        towards = self.inverse[i] @ ray
        depth = towards @ self.offset[i] / (towards @ ray)
        error = self.rounding.keys.uniform(-1.0, 1.0) if self.rounding.keys else 0.0
        return depth * (1.0 + error * self.rounding.size)

    def largest(self, i, column, row, size):
        """Where alpha of Gaussian i is largest between the pixel centres of a square, and that alpha."""
        mean, (a, b, c) = self.means[i], self.conics[i]
        low = numpy.array([column + 0.5, row + 0.5])
        high = low + size - 1.0
        inside = (low <= mean) & (mean <= high)
        point = mean
        if not inside.all():
            corner = numpy.where(mean < low, low, high)
            step = numpy.where(mean < low, 1.0, -1.0) * (size - 1.0)
            dx, dy = mean - corner
            t = numpy.array([(a * dx + b * dy) / (step[0] * a), (b * dx + c * dy) / (step[1] * c)])
            point = corner + numpy.where(inside[::-1], 0.0, numpy.clip(t, 0.0, 1.0)) * step
        return point, self.strengths[i] * numpy.exp(-0.5 * self.form(i, point))

    def form(self, i, point):
        (dx, dy), (a, b, c) = point - self.means[i], self.conics[i]
        return a * dx * dx + 2 * b * dx * dy + c * dy * dy


def blending_order(sight, weights):
    """For every pixel the Gaussians that have a fragment in it, in the order in which they leave the queues."""
    camera = sight.camera
    order = {}
    for top in range(0, camera.height, TILE):
        for left in range(0, camera.width, TILE):
            keyed = []
            for i in numpy.flatnonzero(sight.strengths > 0.0):
                point, largest = sight.largest(i, left, top, TILE)
                if largest >= model.CUTOFF:
                    keyed.append((sight.depth(i, sight.ray(*point)), i))
            listed = [i for _, i in sorted(keyed, key=lambda entry: entry[0])]
            for row in range(top, top + TILE, BLOCK):
                for column in range(left, left + TILE, BLOCK):
                    block_order(sight, weights, listed, column, row, order)
    return order


def block_order(sight, weights, listed, left, top, order):
    """Adds the pixels of one block to `order`."""
    camera = sight.camera
    ray = sight.ray(left + BLOCK / 2, top + BLOCK / 2)
    block = Queue(BLOCK_QUEUE)
    leaving = []
    for i in listed:
        if sight.largest(i, left, top, BLOCK)[1] >= model.CUTOFF * sight.rounding.reach:
            leaving += block.push(sight.depth(i, ray), i)
    leaving += block.drain()
    for row in range(top, top + BLOCK, QUAD):
        for column in range(left, left + BLOCK, QUAD):
            ray = sight.ray(column + QUAD / 2, row + QUAD / 2)
            quad = Queue(QUAD_QUEUE)
            towards = [out for i in leaving for out in quad.push(sight.depth(i, ray), i)] + list(quad.drain())
            for y in range(row, min(row + QUAD, camera.height)):
                for x in range(column, min(column + QUAD, camera.width)):
                    at, ray = y * camera.width + x, sight.ray(x + 0.5, y + 0.5)
                    pixel, found = Queue(PIXEL_QUEUE), []
                    for i in towards:
                        depth = sight.depth(i, ray)
                        if weights[at, i] > 0.0 and depth >= 0.0:
                            found += pixel.push(depth, i)
                    order[at] = found + list(pixel.drain())


def fragments(gaussians, camera):
    """Weights at every pixel [H * W, M], 0 below the cutoff, and means, conics and depths."""
    means, conics, depths, _, valid = model.project(gaussians, camera, LOW_PASS)
    x, y = model.pixel_grid(camera)
    dx, dy = x[:, None] - means[:, 0], y[:, None] - means[:, 1]
    power = -0.5 * (conics[:, 0] * dx * dx + 2 * conics[:, 1] * dx * dy + conics[:, 2] * dy * dy)
    strengths = np.where(valid, np.maximum(gaussians.opacities, 0.0), 0.0)
    weights = strengths * np.exp(power)
    return np.where(weights >= model.CUTOFF, weights, 0.0), strengths, means, conics, depths


def render(gaussians, camera, background, rounding=Rounding()):
    weights, strengths, means, conics, depths = fragments(gaussians, camera)
    # ties are in the order of the depths of the centres
    nearest = numpy.argsort(stop_gradient(depths), kind="stable")
    sight = Sight(gaussians, nearest, camera, means, conics, strengths, rounding)
    found = blending_order(sight, stop_gradient(weights)[:, nearest])
    pixels, count = weights.shape
    length = max(map(len, found.values()))
    order = numpy.full((pixels, length), count)
    for at, of_pixel in found.items():
        order[at, : len(of_pixel)] = nearest[of_pixel] if of_pixel else []
    alpha = np.where(weights < MAX_ALPHA, weights, MAX_ALPHA)
    alpha = np.concatenate([alpha, np.zeros((pixels, 1))], 1)[numpy.arange(pixels)[:, None], order]
    behind = numpy.cumprod(1.0 - stop_gradient(alpha), 1)
    alpha = np.where(numpy.logical_and.accumulate(behind >= MIN_TRANSMITTANCE, 1), alpha, 0.0)
    through = [np.ones(pixels)]
    for k in range(length):
        through.append(through[-1] * (1.0 - alpha[:, k]))
    covered = alpha * np.stack(through[:-1], 1)
    colours = np.maximum(model.evaluate_colour(gaussians.colour, gaussians.positions, model.camera_centre(camera)), 0.0)
    payload = np.concatenate([colours, depths[:, None]], 1)
    payload = np.concatenate([payload, np.zeros((1, 4))])[order]
    blended = np.sum(covered[..., None] * payload, 1)
    shape = (camera.height, camera.width)
    image = blended[:, :3] + through[-1][:, None] * background
    return Blended(image.reshape((*shape, 3)), (1.0 - through[-1]).reshape(shape), blended[:, 3].reshape(shape))


def is_robust(gaussians, camera, background, of_keys=1e-6, of_reach=1e-2, trials=3):
    """Whether rounding leaves the order alone, or changes nothing that is seen."""
    exact = render(gaussians, camera, background).image
    for trial in range(trials):
        rng = numpy.random.default_rng(trial)
        rounding = Rounding(rng, of_keys, (1.0, 1.0 - of_reach, 1.0 + of_reach)[trial % 3])
        if not numpy.allclose(render(gaussians, camera, background, rounding).image, exact, rtol=0.0, atol=1e-12):
            return False
    return True
