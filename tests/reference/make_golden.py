"""Writes the golden cases: small scenes with the images, losses and gradients of the float64 model.

    python make_golden.py FOLDER [--seed 0]

Each case becomes FOLDER/NAME.safetensors. Its tensors, float64 but for the integer ids:
  surfels.*, gaussians.*   inputs, stored raw: log scales, linear opacities, unnormalised quaternions
  camera.rotation [3,3], camera.translation [3], camera.intrinsics (fx, fy, cx, cy)
  background [3], target [H,W,3], upstream [H,W,3]
  environment [16,3]       coefficients, in the case that has one
  out.*                    image, surfel_image, weights, transmittance, gaussian_colour, gaussian_weight,
                           surfel_depth, surfel_normal, layers.{ids, alpha, depth}
  loss.*                   rgb, ssim, surfel, scale, transmittance, total
  grad_image.*             d sum(upstream * image) / d input
  grad_detached.*          the same without the gradient through the transmittance
  grad_total.*             d total loss / d input
Its metadata: width, height, near, layer_count, modulation, footprint, peeling.

Cases of Gaussians that are blended in the order of each pixel's own ray become FOLDER/stopthepop/NAME.safetensors. They have
no surfels, target and losses, out.{image, alpha, depth}, and grad_image.*. What their metadata say of layers is unused.

Cases of Gaussians that rays meet without a projection become FOLDER/htgs/NAME.safetensors, the same, with
transparency [1], an index of `htgs.TRANSPARENCIES`.

Cases of weighted sums become FOLDER/summed/NAME.safetensors:
  gaussians.*              inputs, of which opacity_base, opacity_detail and colour.* are harmonics
  common                   [3] sigma, beta and the weight of the background
  camera.*, background [3], upstream [H,W,3]
  out.image, out.alpha     [H,W,3], [H,W]
  grad_image.*             d sum(upstream * image) / d input
Its metadata: width, height, near, weight.
"""

import argparse
from functools import partial
from pathlib import Path

import numpy as np
from autograd import grad
from safetensors.numpy import save_file

import htgs
import model
import stopthepop

BACKGROUND = np.array([0.1, 0.2, 0.3])


def random_colour(rng, count, lobes):
    raw = np.concatenate(
        [
            rng.normal(0.0, 0.3, (count, lobes, 3)),
            rng.uniform(0.0, np.pi, (count, lobes, 1)),
            rng.uniform(0.0, 2 * np.pi, (count, lobes, 1)),
            rng.normal(0.0, 0.7, (count, lobes, 1)),
        ],
        -1,
    )
    return model.Colour(rng.normal(0.0, 1.0, (count, 3)), raw)


def random_scene(
    rng, surfels, gaussians, lobes=2, extent=1.0, surfel_scale=(-2.5, -1.2), gaussian_scale=(-4.0, -1.5), margins=0.2
):
    return (
        model.Surfels(
            rng.uniform(-extent, extent, (surfels, 3)),
            rng.normal(size=(surfels, 4)),
            rng.uniform(*surfel_scale, (surfels, 2)) + np.log(extent),
            random_colour(rng, surfels, lobes),
            rng.uniform(0.0, margins * extent, surfels),
        ),
        model.Gaussians(
            rng.uniform(-extent, extent, (gaussians, 3)),
            rng.normal(size=(gaussians, 4)),
            rng.uniform(*gaussian_scale, (gaussians, 3)) + np.log(extent),
            rng.uniform(-0.1, 1.6, gaussians),
            random_colour(rng, gaussians, lobes),
        ),
    )


def look_at(rng, distance, width, height, focal):
    """A camera in a random direction from the origin that sees it near the middle of the image."""
    forward = rng.normal(size=3)
    forward /= np.linalg.norm(forward)
    right = np.cross([0.0, 0.0, 1.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    position = -distance * forward + 0.1 * rng.normal(size=3)
    shift = rng.uniform(-3, 3, 2)
    cx, cy = width / 2 + shift[0], height / 2 + shift[1]
    return model.Camera(rotation, -rotation @ position, focal, focal * 1.03, cx, cy, width, height)


def cases(seed):
    """Name, surfels, Gaussians, camera and options of every case, each from random numbers of its own."""
    square = (4.0, 32, 32, 40.0)
    recipes = [
        ("basic", (30, 40), {}, (4.0, 48, 32, 60.0), {}),
        ("crowded", (200, 200), {"surfel_scale": (-3.0, -1.5)}, (3.0, 40, 40, 45.0), {"footprint": "opacity"}),
        ("inside", (60, 60), {}, (0.3, 40, 30, 30.0), {}),
        ("one_layer_opaque", (40, 60), {}, square, {"layer_count": 1, "modulation": 255.0}),
        ("two_layers", (40, 60), {}, square, {"layer_count": 2, "peeling": "nearest"}),
        ("four_layers_translucent", (40, 60), {}, square, {"layer_count": 4, "modulation": 0.8}),
        ("no_lobes", (30, 40), {"lobes": 0}, square, {}),
        ("no_gaussians", (30, 0), {}, square, {}),
        ("no_surfels", (0, 40), {}, square, {}),
        ("large_world", (40, 60), {"extent": 1000.0}, (4000.0, 32, 32, 40.0), {}),
        ("subpixel", (200, 200), {"surfel_scale": (-6.0, -4.0), "gaussian_scale": (-7.0, -5.0)}, square, {}),
        ("environment", (30, 40), {}, (2.0, 40, 28, 25.0), {"modulation": 1.5, "environment": True}),
        # more rims before cores than there are layers
        ("crowded_rims", (300, 80), {"surfel_scale": (-2.6, -1.6)}, (3.0, 32, 32, 36.0), {"layer_count": 2}),
        # the order of most neighbours is uncertain, and most Gaussians are within ramps
        ("wide_margins", (60, 80), {"surfel_scale": (-2.2, -1.4), "margins": 1.2}, (3.0, 32, 32, 36.0), {}),
        ("nearest", (200, 80), {"surfel_scale": (-2.6, -1.6)}, (3.0, 32, 32, 36.0), {"layer_count": 3, "peeling": "nearest"}),
        ("literal", (60, 80), {"surfel_scale": (-2.2, -1.4)}, (3.0, 32, 32, 36.0), {"layer_count": 3, "peeling": "literal"}),
    ]
    for index, (name, counts, scene, camera, options) in enumerate(recipes):
        rng = np.random.default_rng([seed, index])
        surfels, gaussians = random_scene(rng, *counts, **scene)
        camera = look_at(rng, *camera)
        if options.pop("environment", False):
            options["environment"] = rng.normal(0.0, 0.5, (16, 3))
        yield name, surfels, gaussians, camera, options


def named(prefix, tree):
    """The arrays of nested tuples by their dotted names."""
    arrays = {}
    for name, value in tree._asdict().items():
        arrays |= named(f"{prefix}.{name}", value) if hasattr(value, "_asdict") else {f"{prefix}.{name}": value}
    return arrays


def scene_from(arrays):
    """Surfels and Gaussians from the arrays that `named` gives."""

    def part(kind, of):
        colour = model.Colour(arrays[f"{of}.colour.base"], arrays[f"{of}.colour.lobes"])
        return kind(*(colour if field == "colour" else arrays[f"{of}.{field}"] for field in kind._fields))

    return part(model.Surfels, "surfels"), part(model.Gaussians, "gaussians")


def tensors_of(seed, surfels, gaussians, camera, options):
    rng = np.random.default_rng([seed, 1000])
    shape = (camera.height, camera.width, 3)
    target, upstream = rng.uniform(0, 1, shape), rng.normal(0, 1, shape)
    background = BACKGROUND
    inputs = named("surfels", surfels) | named("gaussians", gaussians)
    options = dict(options)
    environment = options.pop("environment", None)
    if environment is not None:
        inputs["environment"] = environment

    def rendered(arrays, **more):
        behind = arrays.get("environment")
        return model.render(*scene_from(arrays), camera, background, environment=behind, **options, **more)

    def image_dot(arrays, detach):
        return model.np.sum(upstream * rendered(arrays, detach_transmittance=detach).image)

    def total(arrays):
        behind = arrays.get("environment")
        return model.total_loss(*scene_from(arrays), camera, target, background, environment=behind, **options)

    result = rendered(inputs)
    tensors = inputs | {
        "camera.rotation": camera.rotation,
        "camera.translation": camera.translation,
        "camera.intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "background": background,
        "target": target,
        "upstream": upstream,
        "loss.rgb": model.rgb_loss(result.image, target),
        "loss.ssim": model.ssim(result.image, target),
        "loss.surfel": model.surfel_loss(result.surfel_image, target),
        "loss.transmittance": model.transmittance_loss(result),
        "loss.total": total(inputs),
    }
    if len(surfels.positions):
        tensors["loss.scale"] = model.scale_loss(surfels.log_scales)
    outputs = named("out", result)
    tensors |= {name: value for name, value in outputs.items() if name.split(".")[-1] not in ("colour", "normal", "margin")}
    tensors["out.layers.ids"] = result.layers.ids.astype(np.int32)
    gradients = {
        "grad_image": grad(lambda arrays: image_dot(arrays, False)),
        "grad_detached": grad(lambda arrays: image_dot(arrays, True)),
        "grad_total": grad(total),
    }
    for prefix, gradient in gradients.items():
        tensors |= {f"{prefix}.{name}": value for name, value in gradient(inputs).items()}
    return {name: np.ascontiguousarray(value) for name, value in tensors.items()}


def stopthepop_cases(seed):
    """Name, Gaussians and camera of every case: the first random ones whose image does not depend on rounding, which decides
    the order of what is equally far."""
    recipes = [
        # of few in each pixel
        ("few", 40, {"gaussian_scale": (-3.0, -1.0)}, (-0.1, 1.6), (3.0, 34, 20, 36.0)),
        # needles and disks across a wide view, which overflow all queues; no block reaches beyond the image, where kernels list
        # nothing
        ("overflowing", 400, {"gaussian_scale": (-4.5, 0.5)}, (0.01, 0.06), (1.2, 12, 8, 6.0)),
        # some of them behind the camera or around it
        ("inside", 120, {"gaussian_scale": (-2.5, -0.8)}, (-0.1, 1.6), (0.3, 28, 18, 20.0)),
    ]
    for index, (name, count, scene, opacities, camera) in enumerate(recipes):
        for attempt in range(1000):
            rng = np.random.default_rng([seed, 100 + index, attempt])
            _, gaussians = random_scene(rng, 0, count, lobes=1, **scene)
            gaussians = gaussians._replace(opacities=rng.uniform(*opacities, count))
            seen_by = look_at(rng, *camera)
            if stopthepop.is_robust(gaussians, seen_by, BACKGROUND):
                yield name, gaussians, seen_by
                break
        else:
            raise RuntimeError(f"{name}: every order depends on rounding")


def htgs_cases(seed):
    """Name, Gaussians, camera and transparency of every case: the first random ones whose image does not depend on rounding."""
    crowd = (300, {"gaussian_scale": (-2.5, -0.5)}, (0.02, 0.25), (2.0, 14, 10, 12.0))
    few = (40, {"gaussian_scale": (-3.0, -1.0)}, (-0.1, 1.6), (3.0, 34, 20, 36.0))
    recipes = [
        ("few", "hybrid", few),
        # more fragments than a core has room for, and fainter ones
        ("crowd", "hybrid", crowd),
        ("nearest", "nearest", crowd),
        ("sorted", "sorted", few),
        ("tail", "tail", crowd),
        # some of them behind the camera or around it
        ("inside", "hybrid", (120, {"gaussian_scale": (-3.5, -1.5)}, (-0.1, 1.6), (0.3, 28, 18, 20.0))),
    ]
    for index, (name, transparency, (count, scene, opacities, camera)) in enumerate(recipes):
        for attempt in range(1000):
            rng = np.random.default_rng([seed, 200 + index, attempt])
            _, gaussians = random_scene(rng, 0, count, lobes=1, **scene)
            gaussians = gaussians._replace(opacities=rng.uniform(*opacities, count))
            seen_by = look_at(rng, *camera)
            if htgs.is_robust(gaussians, seen_by, BACKGROUND, transparency):
                yield name, gaussians, seen_by, transparency
                break
        else:
            raise RuntimeError(f"{name}: every image depends on rounding")


def blended_tensors_of(seed, gaussians, camera, render):
    upstream = np.random.default_rng([seed, 1001]).normal(0, 1, (camera.height, camera.width, 3))
    inputs = named("gaussians", gaussians)

    def rendered(arrays):
        colour = model.Colour(arrays["gaussians.colour.base"], arrays["gaussians.colour.lobes"])
        fields = (colour if field == "colour" else arrays[f"gaussians.{field}"] for field in model.Gaussians._fields)
        return render(model.Gaussians(*fields), camera, BACKGROUND)

    tensors = inputs | {
        "camera.rotation": camera.rotation,
        "camera.translation": camera.translation,
        "camera.intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "background": BACKGROUND,
        "upstream": upstream,
    }
    tensors |= named("out", rendered(inputs))
    gradient = grad(lambda arrays: model.np.sum(upstream * rendered(arrays).image))(inputs)
    tensors |= {f"grad_image.{name}": value for name, value in gradient.items()}
    return {name: np.ascontiguousarray(value) for name, value in tensors.items()}


def write(folder, name, tensors, camera, options):
    for key, value in tensors.items():
        # absent layers lie at infinity
        assert key == "out.layers.depth" or np.all(np.isfinite(value)), f"{name}: {key} is not finite"
    metadata = {
        "width": str(camera.width),
        "height": str(camera.height),
        "near": str(camera.near),
        "layer_count": str(options.get("layer_count", model.LAYER_COUNT)),
        "modulation": str(options.get("modulation", model.SURFEL_MODULATION)),
        "footprint": options.get("footprint", "kernel"),
        "peeling": options.get("peeling", "continuous"),
    }
    save_file(tensors, folder / f"{name}.safetensors", metadata=metadata)
    print(name, f"image mean {tensors['out.image'].mean():.6f}")


def summed_cases(seed):
    """Name, Gaussians, camera, weight and what is common, of every case of a weighted sum."""
    recipes = [
        ("lc", "lc", (3.6, 1.0, 0.02), 40, (4.0, 40, 28, 45.0), (-4.0, -1.5)),
        ("exp", "exp", (0.2, 1.3, 0.3), 40, (4.0, 40, 28, 45.0), (-4.0, -1.5)),
        ("dir", "dir", (10.0, 1.0, 0.05), 40, (4.0, 40, 28, 45.0), (-4.0, -1.5)),
        ("inside", "lc", (2.0, 1.0, 0.02), 60, (0.3, 32, 24, 24.0), (-4.0, -1.5)),
        ("subpixel", "lc", (6.0, 1.0, 0.02), 80, (4.0, 32, 32, 40.0), (-7.0, -4.0)),
    ]
    for index, (name, weight, common, count, camera, scales) in enumerate(recipes):
        rng = np.random.default_rng([seed, 100 + index])
        _, plain = random_scene(rng, 0, count, gaussian_scale=scales)
        gaussians = model.SummedGaussians(
            plain.positions,
            plain.quaternions,
            plain.log_scales,
            plain.opacities,
            rng.normal(4.0, 3.0, (count, 1)),
            rng.normal(0.0, 0.4, (count, 15)),
            plain.colour.base,
            rng.normal(0.0, 0.3, (count, 15, 3)),
        )
        yield name, gaussians, look_at(rng, *camera), weight, np.array(common)


def summed_tensors_of(seed, gaussians, camera, weight, common):
    upstream = np.random.default_rng([seed, 2000]).normal(0, 1, (camera.height, camera.width, 3))
    background = np.array([0.1, 0.2, 0.3])
    names = {field: f"gaussians.{field.replace('colour_', 'colour.')}" for field in gaussians._fields}
    inputs = {names[field]: value for field, value in gaussians._asdict().items()} | {"common": common}

    def rendered(arrays):
        of = model.SummedGaussians(*(arrays[names[field]] for field in gaussians._fields))
        return model.render_summed(of, camera, background, weight, *(arrays["common"][i] for i in range(3)))

    image, alpha = rendered(inputs)
    gradients = grad(lambda arrays: model.np.sum(upstream * rendered(arrays)[0]))(inputs)
    tensors = inputs | {
        "camera.rotation": camera.rotation,
        "camera.translation": camera.translation,
        "camera.intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "background": background,
        "upstream": upstream,
        "out.image": image,
        "out.alpha": alpha,
    }
    tensors |= {f"grad_image.{name}": value for name, value in gradients.items()}
    return {name: np.ascontiguousarray(value) for name, value in tensors.items()}


def write_summed(folder, seed):
    folder.mkdir(exist_ok=True)
    for name, gaussians, camera, weight, common in summed_cases(seed):
        tensors = summed_tensors_of(seed, gaussians, camera, weight, common)
        for key, value in tensors.items():
            assert np.all(np.isfinite(value)), f"{name}: {key} is not finite"
        metadata = {
            "width": str(camera.width),
            "height": str(camera.height),
            "near": str(camera.near),
            "weight": weight,
        }
        save_file(tensors, folder / f"{name}.safetensors", metadata=metadata)
        print(f"summed/{name} image mean {tensors['out.image'].mean():.6f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    for part in ("stopthepop", "htgs"):
        (arguments.folder / part).mkdir(parents=True, exist_ok=True)
    for name, surfels, gaussians, camera, options in cases(arguments.seed):
        write(arguments.folder, name, tensors_of(arguments.seed, surfels, gaussians, camera, options), camera, options)
    for name, gaussians, camera in stopthepop_cases(arguments.seed):
        tensors = blended_tensors_of(arguments.seed, gaussians, camera, stopthepop.render)
        write(arguments.folder / "stopthepop", name, tensors, camera, {})
    for name, gaussians, camera, transparency in htgs_cases(arguments.seed):
        render = partial(htgs.render, transparency=transparency)
        tensors = blended_tensors_of(arguments.seed, gaussians, camera, render)
        tensors["transparency"] = np.array([htgs.TRANSPARENCIES.index(transparency)], np.int32)
        write(arguments.folder / "htgs", name, tensors, camera, {})
    write_summed(arguments.folder / "summed", arguments.seed)


if __name__ == "__main__":
    main()
