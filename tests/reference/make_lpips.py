"""Prints LPIPS of ten pairs of pictures with the published weights, by its formula in float64 NumPy, as JSON.

    python make_lpips.py NETWORK.safetensors [PICTURE PICTURE]

The file is one that dpges-train/tools/lpips_weights.py has made. The pictures are those of
`test_pictures.py`. With two pictures, which need Pillow, it prints theirs instead.
"""

import json
import struct
import sys
from pathlib import Path

import numpy as np
from test_pictures import discs, moved, noisy, picture, tinted

SHIFT, SCALE = [-0.030, -0.088, -0.188], [0.458, 0.448, 0.450]
# Of each convolution: its number in torchvision's `features`, its stride and padding, the window of a max pooling before it,
# and whether the features after its ReLU are compared.
NETWORKS = {
    "alex": [(0, 4, 2, 0, True), (3, 1, 2, 3, True), (6, 1, 1, 3, True), (8, 1, 1, 0, True), (10, 1, 1, 0, True)],
    "vgg": [
        (index, 1, 1, 2 if index in (5, 10, 17, 24) else 0, index in (2, 7, 14, 21, 28))
        for index in (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
    ],
}


def read(path):
    """The network and its tensors in float64."""
    data = Path(path).read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    network = header.pop("__metadata__")["network"]
    body = data[8 + length :]

    def tensor(entry):
        begin, end = entry["data_offsets"]
        return np.frombuffer(body[begin:end], "<f4").reshape(entry["shape"]).astype(np.float64)

    return network, {name: tensor(entry) for name, entry in header.items()}


def windows(features, size, stride):
    """[channels, height, width, size, size]"""
    return np.lib.stride_tricks.sliding_window_view(features, (size, size), (1, 2))[:, ::stride, ::stride]


def convolved(features, weight, bias, stride, padding):
    padded = np.pad(features, [(0, 0), (padding, padding), (padding, padding)])
    return np.einsum("chwij,ocij->ohw", windows(padded, weight.shape[2], stride), weight, optimize=True) + bias[:, None, None]


def unit_length(features):
    return features / (np.sqrt((features**2).sum(0)) + 1e-10)


def lpips(network, tensors, reference, test):
    """Of pictures [3, height, width] from 0 to 1."""
    column = lambda values: np.array(values)[:, None, None]
    pair = [(2.0 * picture - 1.0 - column(SHIFT)) / column(SCALE) for picture in (reference, test)]
    distance, level = 0.0, 0
    for index, stride, padding, pool, is_compared in NETWORKS[network]:
        weight, bias = tensors[f"features.{index}.weight"], tensors[f"features.{index}.bias"]
        if pool:
            pair = [windows(features, pool, 2).max((3, 4)) for features in pair]
        pair = [np.maximum(convolved(features, weight, bias, stride, padding), 0.0) for features in pair]
        if is_compared:
            a, b = (unit_length(features) for features in pair)
            linear = tensors[f"lin{level}.model.1.weight"][0]
            distance += (linear * (a - b) ** 2).sum(0).mean()
            level += 1
    return distance


# Width, height and the two pictures.
PAIRS = [
    (64, 48, discs, moved),
    (64, 48, discs, noisy),
    (64, 48, discs, tinted),
    (64, 48, moved, noisy),
    (64, 48, noisy, tinted),
    (97, 65, discs, moved),
    (97, 65, discs, noisy),
    (97, 65, discs, tinted),
    (97, 65, tinted, moved),
    (33, 31, noisy, discs),
]


def main():
    network, tensors = read(sys.argv[1])
    if len(sys.argv) > 2:
        from PIL import Image

        pair = [np.asarray(Image.open(path).convert("RGB")).transpose(2, 0, 1) / 255.0 for path in sys.argv[2:]]
        print(json.dumps({network: lpips(network, tensors, *pair)}))
        return
    values = [
        lpips(network, tensors, picture(reference, width, height) / 255.0, picture(test, width, height) / 255.0)
        for width, height, reference, test in PAIRS
    ]
    print(json.dumps({network: [round(value, 9) for value in values]}, indent=1))


if __name__ == "__main__":
    main()
