"""Writes the golden case of Student's t kernels: a small scene with its picture and gradients, and the coefficients of
relocation.

    python make_students.py FOLDER [--seed 0]

FOLDER/students.safetensors has float64 tensors:
  students.*               inputs, stored raw: log scales, opacities, degrees of freedom, colours
  camera.rotation [3,3], camera.translation [3], camera.intrinsics (fx, fy, cx, cy)
  upstream [H,W,4]
  out.colour [H,W,3], out.alpha [H,W]
  grad.*                   d sum(upstream * (colour, alpha)) / d input
  relocation [N,5]         opacity, copies, degrees of freedom, then the opacity and the factor of scales of each copy
Its metadata: width, height, near.
"""

import argparse
from pathlib import Path

import mpmath
import numpy as np
from autograd import grad
from safetensors.numpy import save_file

import model
import students
from make_golden import look_at


def random_students(rng, count):
    degrees = 10 ** rng.uniform(0.0, 4.0, count)
    degrees[:4] = 1.0, 2.5, 12.9, 1e4
    opacities = rng.uniform(-0.97, 0.97, count)
    opacities[:2] = 0.9995, -0.9995
    log_scales = rng.uniform(-3.5, -1.0, (count, 3))
    log_scales[:2] = -1.2
    positions = rng.uniform(-1.0, 1.0, (count, 3))
    # together these end pixels
    positions[4:9] *= 0.2
    log_scales[4:9], opacities[4:9] = -0.9, 0.97
    return students.Students(
        positions,
        rng.normal(size=(count, 4)),
        log_scales,
        opacities,
        degrees,
        rng.uniform(-0.2, 1.2, (count, 3)),
    )


def relocated(opacity, copies, degrees):
    """Opacity and factor of scales of each copy by the published double sum, before opacities are clamped."""
    o, nu = mpmath.mpf(opacity), mpmath.mpf(degrees)
    shared = 1 - (1 - o) ** (mpmath.mpf(1) / copies)
    total = mpmath.mpf(0)
    for i in range(1, copies + 1):
        for j in range(i):
            term = mpmath.binomial(i - 1, j) * (-1) ** j * shared ** (j + 1)
            total += term * mpmath.beta(mpmath.mpf(1) / 2, ((j + 1) * (nu + 3) - 1) / 2)
    factor = (o * mpmath.beta(mpmath.mpf(1) / 2, (nu + 2) / 2) / total) ** 2
    return [opacity, copies, degrees, float(shared), float(factor)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([arguments.seed, 2000])
    scene = random_students(rng, 60)
    camera = look_at(rng, 3.0, 40, 28, 36.0)
    upstream = rng.normal(size=(camera.height, camera.width, 4))

    def loss(arrays):
        colour, alpha = students.blend(students.Students(**arrays), camera)
        weights = upstream.reshape(-1, 4)
        return model.np.sum(weights[:, :3] * colour) + model.np.sum(weights[:, 3] * alpha)

    colour, alpha = students.blend(scene, camera)
    mpmath.mp.dps = 60
    cases = [
        (opacity, copies, degrees)
        for opacity in (-0.9, -0.3, 0.05, 0.5, 0.99)
        for copies in (1, 2, 5, 17, 51)
        for degrees in (1.0, 3.7, 100.0, 1e4)
    ]
    tensors = {f"students.{name}": value for name, value in scene._asdict().items()}
    tensors |= {f"grad.{name}": value for name, value in grad(loss)(scene._asdict()).items()}
    tensors |= {
        "camera.rotation": camera.rotation,
        "camera.translation": camera.translation,
        "camera.intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "upstream": upstream,
        "out.colour": colour.reshape(camera.height, camera.width, 3),
        "out.alpha": alpha.reshape(camera.height, camera.width),
        "relocation": np.array([relocated(*case) for case in cases]),
    }
    for key, value in tensors.items():
        assert np.all(np.isfinite(value)), f"{key} is not finite"
    metadata = {"width": str(camera.width), "height": str(camera.height), "near": str(camera.near)}
    tensors = {name: np.ascontiguousarray(value) for name, value in tensors.items()}
    save_file(tensors, arguments.folder / "students.safetensors", metadata=metadata)
    print(f"students: colour mean {colour.mean():.6f}, alpha from {alpha.min():.3f} to {alpha.max():.5f}")


if __name__ == "__main__":
    main()
