#!/usr/bin/env python3
"""A training step of gsplat on exported splats: rasterise, compare, go back, Adam.

    python3 gsplat_step.py splats.ply step.json --json result.json

`splats.ply` is what `dpges export --format ply` wrote of the scene that `dpges bench step --save-scene` measured, and
`step.json` what that command wrote with --json: the size and the camera are the same. Needs PyTorch with CUDA and gsplat.
"""

import argparse
import json
import os
import statistics
import time
from pathlib import Path

import gsplat
import torch

DARKER = 0.9
RATE = 1e-6


def read_ply(path):
    """Columns of floats by name, of a binary file with vertices alone."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    header = data[:end].decode().splitlines()
    if "format binary_little_endian 1.0" not in header:
        raise SystemExit(f"{path} is no binary PLY: `dpges export --format ply` writes one")
    count = next(int(line.split()[2]) for line in header if line.startswith("element vertex"))
    names = [line.split()[2] for line in header if line.startswith("property float")]
    rows = torch.frombuffer(bytearray(data[end:]), dtype=torch.float32).reshape(count, len(names))
    return {name: rows[:, column] for column, name in enumerate(names)}


def parameters(columns, device):
    """Leaves in the order and activation that gsplat takes."""

    def numbered(name, count):
        return torch.stack([columns[f"{name}_{number}"] for number in range(count)], 1)

    rest = sum(name.startswith("f_rest_") for name in columns)
    coefficients = numbered("f_dc", 3)[:, None, :]
    if rest:
        # all coefficients of red, then of green, then of blue
        further = numbered("f_rest", rest).reshape(-1, 3, rest // 3).transpose(1, 2)
        coefficients = torch.cat([coefficients, further], 1)
    values = {
        "means": torch.stack([columns[axis] for axis in "xyz"], 1),
        "quats": numbered("rot", 4),
        "log_scales": numbered("scale", 3),
        "logits": columns["opacity"],
        "colours": coefficients,
    }
    return {name: value.contiguous().to(device).requires_grad_() for name, value in values.items()}


def rasterise(leaves, view):
    degree = round(leaves["colours"].shape[1] ** 0.5) - 1
    images, _, info = gsplat.rasterization(
        means=leaves["means"],
        quats=leaves["quats"],
        scales=leaves["log_scales"].exp(),
        opacities=leaves["logits"].sigmoid(),
        colors=leaves["colours"],
        sh_degree=degree,
        rasterize_mode="antialiased",
        **view,
    )
    return images[0], info


def view_of(step, device):
    """The camera of a report of `dpges bench step`."""
    camera = step["camera"]
    pose = torch.tensor([*camera["camera_from_world"], [0.0, 0.0, 0.0, 1.0]], dtype=torch.float32, device=device)
    intrinsics = [[camera["fx"], 0.0, camera["cx"]], [0.0, camera["fy"], camera["cy"]], [0.0, 0.0, 1.0]]
    return {
        "viewmats": pose[None],
        "Ks": torch.tensor(intrinsics, dtype=torch.float32, device=device)[None],
        "width": step["width"],
        "height": step["height"],
        "near_plane": camera["near"],
    }


def times_ms(run, rounds, warm_up):
    """Of calls that are waited for."""
    times = []
    for number in range(warm_up + rounds):
        torch.cuda.synchronize()
        begin = time.perf_counter()
        run()
        torch.cuda.synchronize()
        if number >= warm_up:
            times.append(1e3 * (time.perf_counter() - begin))
    times.sort()
    return {"median_ms": statistics.median(times), "p95_ms": times[round(0.95 * (len(times) - 1))]}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("splats", type=Path)
    parser.add_argument("step", type=Path)
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--warm-up", type=int, default=5)
    options = parser.parse_args()
    if not torch.cuda.is_available():
        raise SystemExit("PyTorch finds no CUDA device")
    device = torch.device("cuda")
    leaves = parameters(read_ply(options.splats), device)
    view = view_of(json.loads(options.step.read_text()), device)
    with torch.no_grad():
        image, info = rasterise(leaves, view)
        target = DARKER * image.clamp(0.0, 1.0)
    optimiser = torch.optim.Adam(list(leaves.values()), lr=RATE, eps=1e-15, fused=True)

    def forward():
        with torch.no_grad():
            rasterise(leaves, view)

    def forward_and_backward():
        optimiser.zero_grad(set_to_none=True)
        image, _ = rasterise(leaves, view)
        (image - target).abs().mean().backward()

    def step():
        forward_and_backward()
        optimiser.step()

    torch.cuda.reset_peak_memory_stats()
    rounds = (options.rounds, options.warm_up)
    result = {
        "gsplat": gsplat.__version__,
        "torch": torch.__version__,
        "device": torch.cuda.get_device_name(),
        "splats": leaves["means"].shape[0],
        "width": view["width"],
        "height": view["height"],
        "sees": int((image.sum(-1) > 0).sum()),
        "forward": times_ms(forward, *rounds),
        "forward_and_backward": times_ms(forward_and_backward, *rounds),
        "step": times_ms(step, *rounds),
        "peak_bytes": torch.cuda.max_memory_allocated(),
    }
    if "isect_ids" in info:
        result["entries"] = int(info["isect_ids"].shape[0])
    beside = options.json.with_name(options.json.name + ".new")
    beside.write_text(json.dumps(result, indent=2) + "\n")
    os.replace(beside, options.json)


if __name__ == "__main__":
    main()
