"""Specification of the blending of Student's t kernels (SSS), in float64 NumPy.

Conventions are those of `model.py`. Opacities are from -1 to 1. Colours [M, 3] are given. As dense and slow as that.
"""

from __future__ import annotations

from typing import NamedTuple

import autograd.numpy as np

import model

MAX_ALPHA = 0.99
MIN_TRANSMITTANCE = 1e-4
# Two-sided quantiles of 99 % of Student's t distribution with 1, 2, 3 ... degrees of freedom, as published
QUANTILES = [63.657, 9.925, 5.841, 4.604, 4.032, 3.707, 3.499, 3.355, 3.250, 3.169, 3.106, 3.055, 3.012]


class Students(NamedTuple):
    positions: np.ndarray  # [M, 3]
    quaternions: np.ndarray  # [M, 4]
    log_scales: np.ndarray  # [M, 3]
    opacities: np.ndarray  # [M]
    degrees_of_freedom: np.ndarray  # [M]
    colours: np.ndarray  # [M, 3]


def reach(degrees):
    """Standard deviations of the major axis up to which a kernel is drawn."""
    whole = int(np.floor(degrees))
    if whole >= len(QUANTILES):
        return 3.0
    own, following = QUANTILES[whole - 1], QUANTILES[whole]
    return (own - following) * (degrees - whole) + following


def bounds(conics, degrees):
    """Half sides [M] of the squares around the projected centres in which kernels are drawn, px."""
    sides = []
    for (a, b, c), degree in zip(conics, degrees):
        determinant = 1.0 / (a * c - b * b)
        x, y = c * determinant, a * determinant
        mid = 0.5 * (x + y)
        largest = mid + np.sqrt(max(0.1, mid * mid - determinant))
        sides.append(np.ceil(reach(degree) * np.sqrt(largest)))
    return np.array(sides)


def blend(students, camera):
    """Colour [H * W, 3] and alpha [H * W], nearest first, without a background."""
    means, conics, depths, _, valid = model.project(students, camera, low_pass=0.0)
    fixed = model.stop_gradient
    half_sides = bounds(fixed(conics), fixed(students.degrees_of_freedom))
    x, y = model.pixel_grid(camera)
    colour, through = np.zeros((x.size, 3)), np.ones(x.size)
    is_open = np.ones(x.size, bool)
    for i in np.argsort(fixed(depths), kind="stable"):
        if not valid[i]:
            continue
        dx, dy = x - means[i, 0], y - means[i, 1]
        squared = conics[i, 0] * dx * dx + 2 * conics[i, 1] * dx * dy + conics[i, 2] * dy * dy
        degrees = students.degrees_of_freedom[i]
        weight = students.opacities[i] * (1.0 + squared / degrees) ** (-0.5 * (degrees + 2.0))
        inside = (np.abs(fixed(dx)) <= half_sides[i]) & (np.abs(fixed(dy)) <= half_sides[i])
        alpha = np.clip(weight, -MAX_ALPHA, MAX_ALPHA)
        seen = inside & (np.abs(fixed(weight)) >= model.CUTOFF)
        behind = through * (1.0 - alpha)
        is_open = is_open & ~(seen & (fixed(behind) < MIN_TRANSMITTANCE))
        alpha = np.where(seen & is_open, alpha, 0.0)
        colour = colour + (alpha * through)[:, None] * students.colours[i]
        through = through * (1.0 - alpha)
    return colour, 1.0 - through
