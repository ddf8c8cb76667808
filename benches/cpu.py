#!/usr/bin/env python3
"""Trains dpges and its peers on the CPU, on the same photographs, and prints a table in Markdown.

    python3 benches/cpu.py --dpges target/release/dpges --opensplat opensplat --brush brush-cli \\
        --scene data/fox 160 16384 --steps 2000 10000 --out cpu

Every program trains on the same photographs, of the size that was asked for, in the COLMAP layout. The held-out views (the
split of a Blender dataset, else every 8th by name) are in a folder of their own, which no program sees. `dpges eval` renders
and measures the result of each; splats of the peers are sorted and blended as in 3DGS. Brush runs on Mesa's lavapipe, a Vulkan
driver on the CPU. OpenSplat reads no alpha, needs points, and on the CPU takes the principal point to be the middle of a
picture: it gets pictures on black, random points where a dataset has none, and held-out cameras as it sees them. Peers keep
their defaults apart from steps, primitives and seed.

Needs Linux, Python 3.9, Pillow and dpges. OUT/cpu.json has every training, OUT/cpu.md the table; both are written, the whole
file or nothing, after every training, and the same command goes on where it was stopped. Ends with 1 if a training failed.
"""

import argparse
import hashlib
import json
import math
import os
import platform
import random
import re
import shutil
import struct
import subprocess
import sys
import time
from pathlib import Path

try:
    from PIL import Image
except ImportError:
    sys.exit("cpu.py needs Pillow: pip install pillow")

TEST_EVERY = 8
LAVAPIPE = "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json"
# Parameters of COLMAP's camera models without distortion.
PINHOLES = {0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4)}
PINHOLE = 1
NO_POINT = 2**64 - 1
# Half the side of the cube that objects without points start in, as in 3DGS.
CUBE = 1.3
KEY = ["scene", "px", "budget", "steps", "program", "version", "threads", "seed"]


class Failure(Exception):
    """Why a scene or a training is of no use."""


class Scene:
    """Views (name, file, width, height, intrinsics, pose, keypoints) and points (id, position and colour, error, track)."""

    def __init__(self, views, held_out, points):
        self.views, self.held_out, self.points = views, held_out, points


class Reader:
    """Little-endian values of a file, one after the other."""

    def __init__(self, path):
        self.path, self.at = path, 0
        self.bytes = path.read_bytes()

    def take(self, layout):
        layout = "<" + layout
        size = struct.calcsize(layout)
        if self.at + size > len(self.bytes):
            raise Failure(f"{self.path} ends after {len(self.bytes)} bytes, in the middle of a record: it was cut short")
        self.at += size
        return struct.unpack_from(layout, self.bytes, self.at - size)

    def name(self):
        end = self.bytes.find(b"\0", self.at)
        if end < 0:
            raise Failure(f"{self.path} ends in the middle of a name: it was cut short")
        start, self.at = self.at, end + 1
        return self.bytes[start:end].decode()


def read_scene(folder):
    if (folder / "transforms_train.json").is_file():
        return read_blender(folder)
    for model in [folder / "sparse/0", folder / "sparse"]:
        if (model / "images.bin").is_file():
            return read_colmap(folder, model)
    raise Failure(f"{folder} has neither sparse/0/images.bin (COLMAP, binary) nor transforms_train.json (Blender)")


def read_colmap(folder, model):
    file, cameras = Reader(model / "cameras.bin"), {}
    for _ in range(file.take("Q")[0]):
        camera, kind, width, height = file.take("IiQQ")
        if kind not in PINHOLES:
            names = " or ".join(name for name, _ in PINHOLES.values())
            raise Failure(f"{file.path}: camera {camera} has model {kind}, not {names}: undistort the photographs first")
        values = file.take(f"{PINHOLES[kind][1]}d")
        cameras[camera] = (width, height, values if kind == PINHOLE else (values[0], *values))
    file, views = Reader(model / "images.bin"), {}
    for _ in range(file.take("Q")[0]):
        number, *pose, camera = file.take("I7dI")
        name = file.name()
        count = file.take("Q")[0]
        keypoints = list(struct.iter_unpack("<ddQ", file.take(f"{24 * count}s")[0]))
        views[number] = (name, folder / "images" / name, *cameras[camera], pose, keypoints)
    file, points = Reader(model / "points3D.bin"), {}
    for _ in range(file.take("Q")[0]):
        point, *place, error, length = file.take("Q3d3BdQ")
        points[point] = (place, error, file.take(f"{2 * length}I"))
    names = sorted(view[0] for view in views.values())
    held_out = set(names[::TEST_EVERY])
    return Scene(views, {number for number, view in views.items() if view[0] in held_out}, points)


def read_blender(folder):
    views, held_out = {}, set()
    for split in ["train", "test"]:
        described = folder / f"transforms_{split}.json"
        try:
            cameras = json.loads(described.read_text())
            angle, frames = cameras["camera_angle_x"], cameras["frames"]
        except (OSError, ValueError, KeyError) as error:
            raise Failure(f"{described} cannot be read as cameras of the Blender layout: {error!r}") from error
        for frame in frames:
            file = folder / frame["file_path"]
            file = file if file.suffix else file.with_suffix(".png")
            try:
                with Image.open(file) as picture:
                    width, height = picture.size
            except OSError as error:
                raise Failure(f"{file} cannot be read: {error}") from error
            focal = width / 2 / math.tan(angle / 2)
            intrinsics = (focal, focal, width / 2, height / 2)
            number = len(views) + 1
            name = f"{split}_{file.stem}.png"
            views[number] = (name, file, width, height, intrinsics, pose_of(frame["transform_matrix"]), [])
            if split == "test":
                held_out.add(number)
    return Scene(views, held_out, {})


def random_points(count):
    draw = random.Random(0)
    place = lambda: [draw.uniform(-CUBE, CUBE) for _ in range(3)] + [draw.randrange(256) for _ in range(3)]
    return {number + 1: (place(), 0.0, ()) for number in range(count)}


def pose_of(world_from_camera):
    """Quaternion (w, x, y, z) and translation of the world seen from a camera that looks along -z, with y up."""
    columns = [[row[k] * sign for row in world_from_camera[:3]] for k, sign in enumerate([1, -1, -1])]
    centre = [row[3] for row in world_from_camera[:3]]
    translation = [-sum(a * b for a, b in zip(column, centre)) for column in columns]
    (a, b, c), (d, e, f), (g, h, i) = columns
    # each row is four times the quaternion times one of its values: the longest loses least
    rows = [[1 + a + e + i, h - f, c - g, d - b], [h - f, 1 + a - e - i, b + d, c + g]]
    rows += [[c - g, b + d, 1 - a + e - i, f + h], [d - b, c + g, f + h, 1 - a - e + i]]
    longest = max(rows, key=lambda row: sum(value * value for value in row))
    norm = math.sqrt(sum(value * value for value in longest))
    return [value / norm for value in longest] + translation


def prepare(folder, px, budget, out):
    """The folders of a scene with photographs of at most `px` on their longer side: `train` and `held_out`, and both `plain`,
    for OpenSplat."""
    done = out / "scenes" / f"{folder.resolve().name}_{px}_{budget}"
    if done.is_dir():
        return done
    scene = read_scene(folder)
    if not scene.held_out or len(scene.held_out) == len(scene.views):
        raise Failure(f"{folder} has {len(scene.views)} views, {len(scene.held_out)} of them held out: both kinds are needed")
    beside = done.with_name(done.name + ".new")
    shutil.rmtree(beside, ignore_errors=True)
    # A scene has no more points than primitives, so that no program starts beyond its budget.
    ordered = sorted(scene.points)
    kept = {ordered[at * len(ordered) // budget] for at in range(budget)} if len(ordered) > budget else set(ordered)
    points = {point: scene.points[point] for point in sorted(kept)}
    for name, numbers in [("train", scene.views.keys() - scene.held_out), ("held_out", scene.held_out)]:
        views = {number: scene.views[number] for number in sorted(numbers)}
        write_colmap(beside / name, views, points, px)
        write_colmap(beside / "plain" / name, views, points or random_points(budget), px, plain=True)
    os.replace(beside, done)
    return done


def write_colmap(folder, views, points, px, plain=False):
    model = folder / "sparse/0"
    model.mkdir(parents=True)
    cameras, images = [struct.pack("<Q", len(views))], [struct.pack("<Q", len(views))]
    for number, (name, file, width, height, intrinsics, pose, keypoints) in views.items():
        scale = min(1.0, px / max(width, height))
        size = max(1, round(width * scale)), max(1, round(height * scale))
        x, y = size[0] / width, size[1] / height
        name = str(Path(name).with_suffix(".png"))
        write_picture(file, (width, height), size, folder / "images" / name, plain)
        middle = (width / 2, height / 2) if plain else intrinsics[2:]
        scaled = [value * (y if at % 2 else x) for at, value in enumerate((*intrinsics[:2], *middle))]
        cameras.append(struct.pack("<IiQQ4d", number, PINHOLE, *size, *scaled))
        images.append(struct.pack("<I7dI", number, *pose, number) + name.encode() + b"\0" + struct.pack("<Q", len(keypoints)))
        images += [struct.pack("<ddQ", u * x, v * y, of if of in points else NO_POINT) for u, v, of in keypoints]
    cloud = [struct.pack("<Q", len(points))]
    for point, (place, error, track) in points.items():
        track = [value for pair in zip(track[::2], track[1::2]) if pair[0] in views for value in pair]
        cloud.append(struct.pack(f"<Q3d3BdQ{len(track)}I", point, *place, error, len(track) // 2, *track))
    for name, records in [("cameras", cameras), ("images", images), ("points3D", cloud)]:
        (model / f"{name}.bin").write_bytes(b"".join(records))


def write_picture(file, expected, size, to, plain):
    try:
        with Image.open(file) as opened:
            has_alpha = "A" in opened.mode and not plain
            picture = opened.convert("RGBA")
    except OSError as error:
        raise Failure(f"{file} cannot be read: {error}") from error
    if picture.size != expected:
        raise Failure(f"{file} has {picture.size} px, its camera {expected}")
    # colours that are multiplied by alpha, since those of transparent pixels mean nothing
    picture = picture.convert("RGBa").resize(size, Image.Resampling.BICUBIC)
    on_black = Image.merge("RGB", picture.split()[:3])
    to.parent.mkdir(parents=True, exist_ok=True)
    (picture.convert("RGBA") if has_alpha else on_black).save(to)


# The programs. Each function returns the command of a training, where its scene will be, and which views it is held against.


def dpges(program, data, out, row):
    command = [program, "train", data / "train", "--out", out / "run", "--overwrite", "--device", "cpu", "--quiet"]
    command += ["--test-every", 0, "--max-resolution", 0]
    command += ["--steps", row["steps"], "--budget", row["budget"], "--seed", row["seed"]]
    return command, out / "run/scene.safetensors", data / "held_out"


def opensplat(program, data, out, row):
    command = [program, data / "plain/train", "--cpu", "-o", out / "splat.ply"]
    command += ["-n", row["steps"], "--max-gaussians", row["budget"]]
    return command, out / "splat.ply", data / "plain/held_out"


def brush(program, data, out, row):
    command = [program, data / "train", "--total-train-iters", row["steps"], "--max-splats", row["budget"]]
    command += ["--seed", row["seed"]]
    command += ["--export-every", row["steps"], "--export-path", out, "--export-name", "splat.ply"]
    return command, out / "splat.ply", data / "held_out"


PROGRAMS = {"dpges": dpges, "opensplat": opensplat, "brush": brush}


def run(command, environment, processors, log):
    """Runs to the end; returns wall-clock and processor seconds, and peak memory in MiB."""
    with log.open("w") as said:
        begin = time.monotonic()
        child = subprocess.Popen(
            list(map(str, command)),
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
            preexec_fn=lambda: os.sched_setaffinity(0, processors),
        )
        try:
            _, status, used = os.wait4(child.pid, 0)
        except BaseException:
            child.kill()
            raise
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        said = last_line(log.read_text(errors="replace"))
        raise Failure(f"{Path(command[0]).name} ended with {child.returncode}: {said} ({log})")
    seconds = {"wall_seconds": time.monotonic() - begin, "processor_seconds": used.ru_utime + used.ru_stime}
    return {**{name: round(value, 2) for name, value in seconds.items()}, "peak_mib": round(used.ru_maxrss / 1024, 1)}


def last_line(text):
    lines = [line.strip() for line in re.split(r"[\r\n]", text) if line.strip()]
    return lines[-1][:300] if lines else "it said nothing"


def environment(threads):
    """Variables that bound the threads of rayon, OpenMP (libtorch) and lavapipe, and choose lavapipe."""
    names = ["RAYON_NUM_THREADS", "OMP_NUM_THREADS", "LP_NUM_THREADS"]
    drivers = {"VK_ICD_FILENAMES": LAVAPIPE, "VK_DRIVER_FILES": LAVAPIPE}
    return {**os.environ, **dict.fromkeys(names, str(threads)), **drivers}


def measure(options, data, row):
    """Trains and evaluates; adds what was measured to `row`."""
    name, program = row["program"], getattr(options, row["program"]).resolve()
    processors = set(sorted(os.sched_getaffinity(0))[: row["threads"]])
    out = options.out / "runs" / "-".join(str(row[key]) for key in KEY if key != "version")
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    command, scene, views = PROGRAMS[name](program, data, out, row)
    row["command"] = list(map(str, command))
    row["began"] = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    row["load"] = os.getloadavg()[0]
    row.update(run(command, environment(row["threads"]), processors, out / "train.log"))
    if not scene.is_file():
        raise Failure(f"{name} wrote no {scene} ({out / 'train.log'})")
    evaluate = [options.dpges.resolve(), "eval", scene, "--data", views, "--split", "train", "--test-every", 0]
    evaluate += ["--max-resolution", 0, "--device", "cpu", "--lpips", "none", "--json", out / "eval.json"]
    run(evaluate, environment(row["threads"]), processors, out / "eval.log")
    found = json.loads((out / "eval.json").read_text())
    row["views"] = len(found["views"])
    row["primitives"] = found["surfels"] + found["gaussians"]
    row.update({metric: found[metric] for metric in ["psnr", "ssim"]})


def version_of(program):
    """What it says, and the beginning of its SHA-256, which tells builds apart."""
    try:
        said = subprocess.run([program, "--version"], capture_output=True, text=True, timeout=60, check=True).stdout
    except (OSError, subprocess.SubprocessError) as error:
        sys.exit(f"{program} --version failed: {error}")
    return f"{last_line(said)}, {hashlib.sha256(program.read_bytes()).hexdigest()[:8]}"


def commit():
    """Of the checkout that this script is in."""
    asked = ["git", "-C", str(Path(__file__).resolve().parent), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def machine():
    processor = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    return f"{processor[1] if processor else platform.machine()}, {os.cpu_count()} threads"


def table(report):
    date = report["rows"][-1]["began"][:10] if report["rows"] else "-"
    versions = "; ".join(f"{name} ({said})" for name, said in report["versions"].items())
    lines = [f"{report['machine']}; {date}; {versions}; commit of cpu.py: {report['commit']}.", ""]
    columns = ["scene", "px", "steps", "program", "threads", "primitives", "PSNR, dB", "SSIM", "processor s", "wall s", "MiB"]
    lines += ["| " + " | ".join(columns) + " |", "|---|---:|---:|---|" + "---:|" * 7]
    for row in report["rows"]:
        start = [row["scene"], row["px"], f"{row['steps']:,}", row["program"], row["threads"]]
        if row["failed"]:
            cells = [*start, "failed", *[""] * 5]
        else:
            quality = [f"{row['primitives']:,}", f"{row['psnr']:.2f}", f"{row['ssim']:.3f}"]
            cost = [f"{row[name]:.0f}" for name in ["processor_seconds", "wall_seconds", "peak_mib"]]
            cells = [*start, *quality, *cost]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"


def write(path, text):
    """The whole file or nothing."""
    beside = path.with_name(path.name + ".new")
    beside.write_text(text)
    os.replace(beside, path)


def program(text):
    found = shutil.which(text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text} is no program: name the file that was built")
    return Path(found)


def count(text):
    if not text.isdigit() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"`{text}` is not a whole number of at least 1")
    return int(text)


def parsed(arguments):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dpges", type=program, required=True, metavar="BIN", help="trains, and evaluates every program")
    parser.add_argument("--opensplat", type=program, metavar="BIN", help="left out unless given")
    parser.add_argument("--brush", type=program, metavar="BIN", help="brush or brush-cli; left out unless given")
    parser.add_argument(
        "--scene", nargs=3, action="append", required=True, metavar=("DIR", "PX", "PRIMITIVES"),
        help="dataset (COLMAP, Blender), longer side of its photographs, budget of primitives; may be repeated",
    )
    parser.add_argument("--steps", type=count, nargs="+", default=[2000], help="one training each [2000]")
    parser.add_argument("--threads", type=count, default=len(os.sched_getaffinity(0)), help="[all]")
    parser.add_argument("--seed", type=int, default=0, help="of dpges and Brush; OpenSplat has none [0]")
    parser.add_argument("--out", type=Path, default=Path("cpu"), metavar="DIR", help="folder for all results [cpu]")
    options = parser.parse_args(arguments)
    if options.threads > len(os.sched_getaffinity(0)):
        parser.error(f"--threads {options.threads}: this machine lends {len(os.sched_getaffinity(0))}")
    if options.brush and not Path(LAVAPIPE).is_file():
        parser.error(f"--brush needs Mesa's software Vulkan, {LAVAPIPE} (Debian: mesa-vulkan-drivers)")
    for scene in options.scene:
        try:
            scene[:] = [Path(scene[0]), count(scene[1]), count(scene[2])]
        except argparse.ArgumentTypeError as error:
            parser.error(f"--scene {scene[0]}: {error}")
        if not scene[0].is_dir():
            parser.error(f"--scene {scene[0]}: there is no such folder")
    return options


def main(arguments):
    options = parsed(arguments)
    options.out = options.out.resolve()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "cpu.json"
    report = json.loads(path.read_text()) if path.is_file() else {"rows": []}
    report["machine"], report["commit"] = machine(), commit()
    versions = {name: version_of(getattr(options, name)) for name in PROGRAMS if getattr(options, name)}
    report["versions"] = {**report.get("versions", {}), **versions}
    failed = False
    for folder, px, budget in options.scene:
        try:
            data = prepare(folder, px, budget, options.out)
        except Failure as failure:
            sys.exit(f"--scene {failure}")
        for steps in options.steps:
            for name, version in versions.items():
                row = dict(zip(KEY, [folder.resolve().name, px, budget, steps, name, version, options.threads, options.seed]))
                same = [one for one in report["rows"] if all(one[key] == row[key] for key in KEY)]
                if any(one["failed"] is None for one in same):
                    continue
                row["failed"] = None
                try:
                    measure(options, data, row)
                except Failure as failure:
                    row["failed"], failed = str(failure), True
                report["rows"] = [one for one in report["rows"] if one not in same] + [row]
                write(path, json.dumps(report, indent=2) + "\n")
                write(options.out / "cpu.md", table(report))
                done = row["failed"] or f"{row['psnr']:.2f} dB, {row['processor_seconds']:.0f} s of processor time"
                print(f"{row['scene']} {px} px, {steps} steps, {name}: {done}", file=sys.stderr, flush=True)
    print(table(report), end="")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
