"""Makes the file of a network that `dpges eval --lpips` and `dpges compare --lpips` take.

    python lpips_weights.py {alex,vgg} --out FILE [--backbone FILE] [--linear FILE]

It needs PyTorch and safetensors (`pip install torch numpy safetensors`). The weights are those of torchvision, trained on
ImageNet, and of LPIPS, version 0.1. Without --backbone and --linear they are downloaded and kept beside FILE. Files whose
SHA-256 is not that of the published ones are refused, before anything in them is read.
"""

import argparse
import hashlib
import sys
import urllib.request
from pathlib import Path

BACKBONES = "https://download.pytorch.org/models/"
LINEAR = "https://github.com/richzhang/PerceptualSimilarity/raw/master/lpips/weights/v0.1/"

# File and the beginning of its SHA-256, as far as its publisher states it or the package lpips 0.1.4 has it.
BACKBONE_FILES = {
    "alex": ("alexnet-owt-7be5be79.pth", "7be5be79"),
    "vgg": ("vgg16-397923af.pth", "397923af"),
}
LINEAR_FILES = {
    "alex": ("alex.pth", "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0"),
    "vgg": ("vgg.pth", "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868"),
}

# Shapes of the weights: of torchvision's `features` by their numbers, then of the linear layers.
ALEX = {0: (64, 3, 11, 11), 3: (192, 64, 5, 5), 6: (384, 192, 3, 3), 8: (256, 384, 3, 3), 10: (256, 256, 3, 3)}
VGG_CHANNELS = {
    0: (64, 3), 2: (64, 64), 5: (128, 64), 7: (128, 128), 10: (256, 128), 12: (256, 256), 14: (256, 256),
    17: (512, 256), 19: (512, 512), 21: (512, 512), 24: (512, 512), 26: (512, 512), 28: (512, 512),
}  # fmt: skip
CONVOLUTIONS = {"alex": ALEX, "vgg": {index: (*channels, 3, 3) for index, channels in VGG_CHANNELS.items()}}
LEVELS = {"alex": (64, 192, 384, 256, 256), "vgg": (64, 128, 256, 512, 512)}


def checked(path, sha256):
    """`path`, if its SHA-256 begins with `sha256`."""
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    if not digest.hexdigest().startswith(sha256):
        sys.exit(f"{path} is not the published file: its SHA-256 is {digest.hexdigest()}, expected {sha256}…")
    return path


def fetched(given, url, folder, name, sha256):
    """The file that was given, or a download in `folder`; either is checked."""
    path = Path(given) if given else folder / name
    if not path.is_file():
        if given:
            sys.exit(f"there is no file {path}")
        print(f"downloading {url}{name}", file=sys.stderr)
        part = path.with_name(path.name + ".part")
        try:
            urllib.request.urlretrieve(url + name, part)
        except OSError as error:
            sys.exit(f"cannot download {url}{name}: {error}; name a copy of it with --backbone or --linear")
        part.rename(path)
    return checked(path, sha256)


def tensors(network, backbone, linear):
    """Everything that the file holds, from the two state dictionaries."""
    shapes = {}
    for index, shape in CONVOLUTIONS[network].items():
        shapes[f"features.{index}.weight"] = shape
        shapes[f"features.{index}.bias"] = shape[:1]
    for level, channels in enumerate(LEVELS[network]):
        shapes[f"lin{level}.model.1.weight"] = (1, channels, 1, 1)
    found = {}
    for name, shape in shapes.items():
        tensor = (linear if name.startswith("lin") else backbone).get(name)
        if tensor is None:
            sys.exit(f"tensor {name} is missing")
        if tuple(tensor.shape) != shape:
            sys.exit(f"tensor {name} has shape {tuple(tensor.shape)}, expected {shape}")
        found[name] = tensor.float().contiguous().clone()
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", choices=sorted(CONVOLUTIONS))
    parser.add_argument("--out", required=True, type=Path, metavar="FILE", help="for example lpips_alex.safetensors")
    parser.add_argument("--backbone", metavar="FILE", help="the file of torchvision, if it is here already")
    parser.add_argument("--linear", metavar="FILE", help="the file of LPIPS, if it is here already")
    options = parser.parse_args()

    import torch
    from safetensors.torch import save_file

    folder, network = options.out.resolve().parent, options.network
    backbone = fetched(options.backbone, BACKBONES, folder, *BACKBONE_FILES[network])
    linear = fetched(options.linear, LINEAR, folder, *LINEAR_FILES[network])
    states = [torch.load(path, map_location="cpu", weights_only=True) for path in (backbone, linear)]
    part = options.out.with_name(options.out.name + ".part")
    save_file(tensors(network, *states), part, metadata={"network": network, "version": "0.1"})
    part.rename(options.out)
    print(options.out)


if __name__ == "__main__":
    main()
