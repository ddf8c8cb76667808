"""Pictures from integer formulas; dpges-train/src/metrics/test_pictures.rs has the same."""

import numpy as np


def discs(c, y, x):
    inside = (abs(x % 24 - 12)) ** 2 + (abs(y % 24 - 12)) ** 2 < 60
    return np.where(inside, 60 + 70 * c, (x + 2 * y + 40 * c) % 256)


def moved(c, y, x):
    return discs(c, y, x + 1)


def noisy(c, y, x):
    noise = (x * 7919 + y * 104_729 + c * 1_299_709 + x * y * 31) % 251
    return (7 * discs(c, y, x) + noise) // 8


def tinted(c, y, x):
    return discs(c, y, x) * (8 - c) // 8


def picture(of, width, height):
    """[3, height, width], bytes."""
    c, y, x = np.meshgrid(np.arange(3), np.arange(height), np.arange(width), indexing="ij")
    return (of(c, y, x) % 256).astype(np.uint8)
