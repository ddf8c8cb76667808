"""Prints what published programs say of the pictures that the tests of the metrics make, as JSON.

    python make_metrics.py      (with the packages of requirements-metrics.txt)

Of MS-SSIM, SSIMULACRA2 and LPIPS. The pictures and, for LPIPS, the weights come from formulas that the tests of
dpges-train/src/metrics have too, so that no file is needed. MS-SSIM of pictures whose sides are not multiples of 16 is
computed here, since programs treat the last row and column of odd pictures differently. The Python package for SSIMULACRA2
blurs other than the program that its author published: it gets that program's filter.
"""

import json
import tempfile
from pathlib import Path

import lpips
import numpy as np
import ssimulacra2.ssimulacra2
import torch
from PIL import Image
from pytorch_msssim import ms_ssim
from scipy.ndimage import correlate1d
from test_pictures import discs, moved, noisy, picture, tinted

OTHERS = {"moved": moved, "noisy": noisy, "tinted": tinted}


def pairs(width, height):
    reference = picture(discs, width, height)
    return {name: (reference, picture(of, width, height)) for name, of in OTHERS.items()}


def batch(planes):
    return torch.from_numpy(planes.astype(np.float64) / 255.0)[None]


def ms_ssim_in_numpy(reference, test):
    """The formula, with the last row and column of odd pictures counted twice."""
    weights = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333]
    offsets = np.arange(-5, 6)
    window = np.exp(-(offsets**2) / (2 * 1.5**2))
    window /= window.sum()

    def blurred(a):
        whole = correlate1d(correlate1d(a, window, 0), window, 1)
        return whole[5:-5, 5:-5]

    def halved(a):
        even = np.pad(a, [(0, side % 2) for side in a.shape], mode="edge")
        return (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4

    def of_channel(a, b):
        product = 1.0
        for scale, weight in enumerate(weights):
            mean_a, mean_b = blurred(a), blurred(b)
            variances = blurred(a * a) - mean_a**2 + blurred(b * b) - mean_b**2
            contrast = (2 * (blurred(a * b) - mean_a * mean_b) + 9e-4) / (variances + 9e-4)
            luminance = (2 * mean_a * mean_b + 1e-4) / (mean_a**2 + mean_b**2 + 1e-4)
            last = scale == len(weights) - 1
            product *= max((contrast * luminance if last else contrast).mean(), 0.0) ** weight
            a, b = halved(a), halved(b)
        return product

    return np.mean([of_channel(a / 255.0, b / 255.0) for a, b in zip(reference, test)])


# Half of the impulse response of the recursive filter (Charalampidis 2016, sigma 1.5) that SSIMULACRA2 is defined with.
BLUR = [2.64621105e-01, 2.12928592e-01, 1.09335373e-01, 3.60111147e-02, 9.41436781e-03]


def blur_image(image, sigma=1.5):
    window = np.array(BLUR[:0:-1] + BLUR)
    return correlate1d(correlate1d(image, window, 0, mode="constant"), window, 1, mode="constant")


def score_ssimulacra2(reference, test):
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder) / name) for name in ("reference.png", "test.png")]
        for path, planes in zip(paths, (reference, test)):
            Image.fromarray(planes.transpose(1, 2, 0)).save(path)
        return ssimulacra2.ssimulacra2.compute_ssimulacra2(*paths)


def shares(number, count):
    """A hash of positions, from 0 to 1."""
    index = np.arange(count, dtype=np.uint64)
    mask = np.uint64(0xFFFFFFFF)
    start = np.uint64(number * 0x85EBCA77 & 0xFFFFFFFF)
    value = (index * np.uint64(0x9E3779B1) & mask) ^ start
    value = (value ^ (value >> np.uint64(16))) * np.uint64(0x85EBCA6B) & mask
    value = (value ^ (value >> np.uint64(13))) * np.uint64(0xC2B2AE35) & mask
    return (value ^ (value >> np.uint64(16))).astype(np.float64) / 2.0**32


def network(name):
    """The published LPIPS, with weights from the hash."""
    model = lpips.LPIPS(net=name, pnet_rand=True, pretrained=False, verbose=False)
    state = {key: value for key, value in model.state_dict().items() if key.startswith("net.")}
    order = sorted(state, key=lambda key: (int(key.split(".")[2]), key.endswith("bias")))
    order += [f"lin{level}.model.1.weight" for level in range(5)]
    for number, key in enumerate(order, start=1):
        shape = model.state_dict()[key].shape
        values = shares(number, shape.numel())
        if not key.startswith("lin"):
            bound = np.sqrt(6.0 / shape[1:].numel()) if len(shape) == 4 else 0.1
            values = bound * (2.0 * values - 1.0)
        values = torch.from_numpy(values.astype(np.float32)).reshape(shape)
        model.state_dict()[key].copy_(values)
    return model


def main():
    found = {"ms_ssim 192x176": {}, "ms_ssim 181x165": {}, "ssimulacra2 256x232": {}}
    for name, (reference, test) in pairs(192, 176).items():
        published = ms_ssim(batch(reference), batch(test), data_range=1.0).item()
        assert abs(published - ms_ssim_in_numpy(reference, test)) < 1e-5, name
        found["ms_ssim 192x176"][name] = published
    for name, (reference, test) in pairs(181, 165).items():
        found["ms_ssim 181x165"][name] = ms_ssim_in_numpy(reference, test)
    ssimulacra2.ssimulacra2.blur_image = blur_image
    for name, (reference, test) in pairs(256, 232).items():
        found["ssimulacra2 256x232"][name] = score_ssimulacra2(reference, test)
    for net in ("alex", "vgg"):
        model = network(net)
        scores = found[f"lpips {net} 64x48"] = {}
        with torch.no_grad():
            for name, (reference, test) in pairs(64, 48).items():
                scores[name] = model(batch(reference).float(), batch(test).float(), normalize=True).item()
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
