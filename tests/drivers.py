#!/usr/bin/env python3
"""Runs dpges on every graphics driver of this machine, and prints a table in Markdown.

    cargo build --release && cargo test --release --workspace --no-run
    python3 tests/drivers.py target/release/dpges [--only SwiftShader] [--only "validation: core"] [--json drivers.json]
    dpges-render/web/tests/browser.py --keep page && python3 tests/drivers.py target/release/dpges --page page   # with browsers
    python3 tests/drivers.py target/release/dpges --compile-only mesa25/libvulkan_radeon.so                      # for cards of AMD

A driver is a row: Mesa's lavapipe with subgroups of 4, 8 and 16, Chromium's SwiftShader, every Vulkan driver of a GPU,
OpenGL, and Chromium's WebGPU and WebGL2 if there is a page. Columns: the selftest (worst error as a share of its tolerance,
so that 1 is the most that passes), random scenes at the extremes (tensors that are not finite), the kernels' tests of golden
cases and parity, PSNR of a training of 50 steps, and the worst golden picture of the real-time renderer (of the page: the
worst picture against the native one). Validation by Khronos's layers is a row of its own where they are installed: the number
of their messages in a selftest, a training and a rendered path. The last table tells whether trainings on lavapipe depend on
the order of workgroups, which a layer of our own shuffles (workgroups.c). Ends with 1 if a cell failed, or if there is nothing
to run. Needs Python 3.9; layers need gcc and Vulkan's headers (Debian's libvulkan-dev).

With --compile-only another layer (compiled.c) has Mesa's AMD driver compile what a training and a rendered path run on lavapipe,
for cards that need not be there: shaders and which of them spill registers, which fails, the lowest occupancy (subgroups that a
SIMD holds at once), and the ten with the largest latency x launches. Draws count as launches. It runs nothing else. Mesa 25 does
it, 22.3 crashes for gfx11; `dpkg -x` unpacks `mesa-vulkan-drivers` of a newer Debian without installing it.
"""

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

BROWSER_TEST = Path(__file__).resolve().parent.parent / "dpges-render/web/tests/browser.py"
sys.path.append(str(BROWSER_TEST.parent))
from chromium import program  # noqa: E402

ICD_FOLDERS = ["/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/nvidia/share/vulkan/icd.d"]
SWIFTSHADER = ["/usr/lib/chromium/vk_swiftshader_icd.json", "/opt/google/chrome/vk_swiftshader_icd.json"]
# files of drivers that run on the CPU
LAVAPIPE = "lvp_icd"
VALIDATION_LAYER = "VkLayer_khronos_validation.json"
FEATURES = {
    "core": "",
    "synchronisation": "VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT",
    "GPU-assisted": "VK_VALIDATION_FEATURE_ENABLE_GPU_ASSISTED_EXT",
}
# of the tests on a GPU
KERNEL_TESTS = ["golden_cases", "parity::every_operation"]
BROWSERS = {"webgpu": "Chromium, WebGPU", "webgl": "Chromium, WebGL2"}
# kernels of every kind: peeled and summed, sorted, met by rays, in queues, with a core
METHODS = ["dpges", "mcmc", "2dgs", "stopthepop", "htgs", "sortfree"]
THREADS = [0, 1, 2, 7]
# the second half of a dispatch before the first, then pieces in orders drawn from these seeds
SHUFFLES = [0, 1, 2]
ORDER = "order of workgroups"
SHUFFLE_LAYER = Path(__file__).with_name("workgroups.c")
COMPILE_LAYER = Path(__file__).with_name("compiled.c")
# a card of each kind by its name in Mesa
CARDS = {"gfx9": "vega10", "gfx10.3": "navi21", "gfx11": "navi31"}
OCCUPANCY = "Subgroups per SIMD"
SPILLS = ["Spilled SGPRs", "Spilled VGPRs", "Scratch size"]
MOST_EXPENSIVE = 10
SMALL = ["--steps", "50", "--max-resolution", "64", "--budget", "2000"]


class Row:
    def __init__(self, name, environment, computes=True):
        self.name, self.environment, self.computes = name, environment, computes


def vulkan(icd, **more):
    # the second name is that of loaders before 1.3.207
    return {"VK_DRIVER_FILES": str(icd), "VK_ICD_FILENAMES": str(icd), "WGPU_BACKEND": "vulkan", **more}


def installed():
    """Files that name Vulkan drivers to the loader."""
    return [icd for folder in ICD_FOLDERS if Path(folder).is_dir() for icd in sorted(Path(folder).glob("*.json"))]


def rows():
    found = []
    for icd in installed():
        if LAVAPIPE in icd.name:
            for bits in [128, 256, 512]:
                environment = vulkan(icd, LP_NATIVE_VECTOR_WIDTH=str(bits))
                found.append(Row(f"lavapipe, subgroups of {bits // 32}", environment))
        else:
            found.append(Row(icd.name.split("_icd")[0], vulkan(icd)))
    found += [Row("SwiftShader", vulkan(icd)) for icd in SWIFTSHADER if Path(icd).is_file()][:1]
    found.append(Row("OpenGL", {"WGPU_BACKEND": "gl"}, computes=False))
    return found


class Kit:
    def __init__(self, options, folder):
        self.dpges = str(Path(options.dpges).resolve())
        self.deps = Path(self.dpges).parent / "deps"
        self.limit = options.limit
        self.folder = folder

    def run(self, command, environment):
        """Exit status (None: it ran too long) and all that was printed."""
        runtime = {"XDG_RUNTIME_DIR": os.environ.get("XDG_RUNTIME_DIR", self.folder), "NO_COLOR": "1"}
        environment = {**os.environ, **runtime, **environment}
        try:
            done = subprocess.run(
                command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=self.limit, text=True
            )
        except subprocess.TimeoutExpired as error:
            output = error.stdout or b""
            return None, output.decode(errors="replace") if isinstance(output, bytes) else output
        except OSError as error:
            return 127, str(error)
        return done.returncode, done.stdout

    def training_and_path(self, run):
        train = [self.dpges, "train", "--out", run, "--device", "wgpu", *SMALL]
        path = ["--renderer", "raster", "--path", "orbit", "--frames", "3", "--size", "320x180", "--out", f"{run}-path"]
        return {"training": train, "path": [self.dpges, "render", run, *path]}

    def test(self, name):
        """The newest binary of a test target."""
        files = [file for file in self.deps.glob(f"{name}-*") if os.access(file, os.X_OK) and not file.suffix]
        if not files:
            sys.exit(f"no test `{name}` in {self.deps}: run `cargo test --release --workspace --no-run` first")
        return str(max(files, key=lambda file: file.stat().st_mtime))

    def driver(self, row):
        """The adapter of a row as `--device` takes it, and its name and version; None if there is none."""
        code, output = self.run([self.dpges, "devices", "--json"], row.environment)
        if code != 0:
            return None
        for adapter in json.loads(output[output.index("{") :])["adapters"]:
            if adapter["api"] == row.environment["WGPU_BACKEND"]:
                words = [adapter[key] for key in ["name", "driver", "driver_info"]]
                return adapter["device"], ", ".join(word for word in words if word)
        return None

    def selftest(self, environment, device):
        code, output = self.run([self.dpges, "selftest", "--device", device, "--json"], environment)
        try:
            report = json.loads(output[output.index("{") :])
        except ValueError:
            return failed(code, output)
        worst = max(row["error"] / row["tolerance"] for row in report["operations"] if row["tolerance"] > 0)
        return (f"{worst:.2f} of {report['tensors']} tensors", report["passed"])

    def extremes(self, environment, device):
        command = [self.dpges, "selftest", "--device", device, "--extremes", "20", "--json"]
        code, output = self.run(command, environment)
        return ("finite", True) if code == 0 else failed(code, output)

    def kernels(self, environment, _):
        passed, wrong = 0, 0
        for filtered in KERNEL_TESTS:
            command = [self.test("machine"), filtered, "--test-threads", "1"]
            code, output = self.run(command, {**environment, "DPGES_REQUIRE_GPU": "1"})
            found = re.search(r"test result: \w+\. (\d+) passed; (\d+) failed", output)
            if not found:
                return failed(code, output)
            passed, wrong = passed + int(found[1]), wrong + int(found[2])
        return (f"{passed} passed, {wrong} failed", wrong == 0)

    def training(self, environment, device):
        out = tempfile.mkdtemp(dir=self.folder)
        code, output = self.run([self.dpges, "train", "--out", f"{out}/run", "--device", device, *SMALL], environment)
        if code != 0:
            return failed(code, output)
        found = re.search(r"held-out PSNR\s+(\d+\.\d+)", output)
        return (f"{found[1]} dB" if found else "ran", True)

    def raster(self, environment, _):
        command = [self.test("golden"), "agrees_with", "--nocapture", "--test-threads", "1"]
        code, output = self.run(command, {**environment, "DPGES_REQUIRE_GPU": "1"})
        found, worst = re.findall(r"(\w+), (Float|Half), (\w+): ([\d.]+) dB", output), {}
        # drivers that cannot blend 32-bit floats have only the other
        best = min((precision for _, precision, _, _ in found), default="Float")
        for name, _, depths, db in (row for row in found if row[1] == best):
            worst[depths] = min(worst.get(depths, (float("inf"), "")), (float(db), name))
        if not worst:
            return failed(code, output)
        cells = [f"{depths.lower()} depths {db:.0f} dB ({name})" for depths, (db, name) in worst.items()]
        return (", ".join(cells), code == 0)

    def page(self, backend, page):
        code, output = self.run([sys.executable, BROWSER_TEST, "--folder", page, "--backends", backend], {})
        pictures = re.findall(r"^\w+ +\w+: (.+): (\d+\.\d+|inf) dB, at least", output, re.MULTILINE)
        if not pictures:
            return failed(code, output)
        db, name = min((float(db), name) for name, db in pictures)
        return (f"{db:.0f} dB ({name}), {len(pictures)} pictures", code == 0)


def failed(code, output):
    lines = [line for line in output.strip().splitlines() if line.strip()]
    why = next((line for line in reversed(lines) if "error" in line.lower() or "failed" in line.lower()), "")
    return (f"{'too slow' if code is None else f'exit {code}'}: {why.strip()[:120]}", False)


def validation(kit, wanted):
    """Messages of Khronos's layers by kind of validation, on lavapipe."""
    icds = [icd for icd in installed() if LAVAPIPE in icd.name]
    if not icds:
        return
    for kind, feature in FEATURES.items():
        if not wanted(f"validation: {kind}"):
            continue
        run = f"{kit.folder}/validated-{kind}"
        environment = vulkan(
            icds[0], VK_INSTANCE_LAYERS="VK_LAYER_KHRONOS_validation", VK_LAYER_ENABLES=feature, VK_LOADER_LAYERS_ENABLE="*validation",
            VK_LOADER_DEBUG="layer",
        )
        commands = {"selftest": [kit.dpges, "selftest", "--device", "wgpu"], **kit.training_and_path(run)}
        for name, command in commands.items():
            code, output = kit.run(command, environment)
            if not re.search(r'Insert instance layer "?VK_LAYER_KHRONOS_validation', output):
                yield kind, name, code, ["the layer was not loaded"], output
                continue
            messages = re.findall(r"(?:VUID-[\w-]+|SYNC-HAZARD-[\w-]+|UNASSIGNED-[\w-]+)", output)
            yield kind, name, code, sorted(set(messages)), output


def layer(kit, source, description):
    """Environment in which a layer of ours is loaded; None if it cannot be built."""
    library = f"{kit.folder}/lib{source.stem}.so"
    code, output = kit.run(["gcc", "-shared", "-fPIC", "-O2", "-o", library, source, "-ldl"], {})
    if code != 0:
        print(f"the layer {source.name} was not built: {output.strip()[:200]}", file=sys.stderr)
        return None
    described = {
        "name": f"VK_LAYER_DPGES_{source.stem}", "type": "INSTANCE", "library_path": library, "api_version": "1.3.0",
        "implementation_version": "1", "description": description,
    }
    manifest = Path(kit.folder, f"{source.stem}.json")
    manifest.write_text(json.dumps({"file_format_version": "1.1.0", "layer": described}))
    return {"VK_LAYER_PATH": kit.folder, "VK_INSTANCE_LAYERS": described["name"]}


def shuffles(kit):
    """Environments in which every dispatch is cut into pieces that run in another order; None for each if the layer cannot be built."""
    loaded = layer(kit, SHUFFLE_LAYER, "Dispatches run in pieces, in another order.")
    return {f"shuffle {seed}": loaded and {**loaded, "DPGES_WORKGROUPS": str(seed)} for seed in SHUFFLES}


def orders(kit, wanted):
    """Whether trainings on lavapipe end with the same bytes, whatever the order of workgroups: with one thread they run as they
    come, with more in an order that differs from run to run, and a layer shuffles them. Yields the method, the order, digest of
    the scene (None: no scene) and the share of dispatches that had more than one workgroup and were cut."""
    icds = [icd for icd in installed() if LAVAPIPE in icd.name]
    environments = {f"{threads} threads": {"LP_NUM_THREADS": str(threads)} for threads in THREADS}
    if icds and any(wanted(f"{ORDER}: {method}, shuffle {seed}") for method in METHODS for seed in SHUFFLES):
        environments |= shuffles(kit)
    for method in METHODS if icds else []:
        for order, environment in environments.items():
            if not wanted(f"{ORDER}: {method}, {order}"):
                continue
            if environment is None:
                yield method, order, None, 0
                continue
            run = Path(kit.folder) / f"{method}, {order}"
            command = [kit.dpges, "train", "--out", run, "--device", "wgpu", "--method", method, *SMALL]
            code, output = kit.run(command, vulkan(icds[0], **environment))
            scene = run / "scene.safetensors"
            digest = hashlib.sha256(scene.read_bytes()).hexdigest() if code == 0 and scene.is_file() else None
            counted = re.search(r"workgroups: (\d+) dispatches, (\d+) of them cut", output)
            cut = int(counted[2]) / max(int(counted[1]), 1) if counted else 0
            # without the layer the order would be the usual one
            yield method, order, digest if "shuffle" not in order or cut > 0 else None, cut


def compiled(kit, driver):
    """Shaders of a training and of a rendered path as `driver` compiles them for cards: yields the card, what ran, the name and
    version of the driver, and its shaders (compiled.c). Exits if there is nothing to run, or no card."""
    icds = [icd for icd in installed() if LAVAPIPE in icd.name]
    loaded = icds and layer(kit, COMPILE_LAYER, "Pipelines are compiled for a card of AMD, too.")
    if not loaded:
        sys.exit("--compile-only needs lavapipe to run on, and a layer of ours")
    table, log = Path(kit.folder, "compiled.jsonl"), Path(kit.folder, "kernels.log")
    # the last two are for names: of kernels, which are otherwise without their modules, and of the renderer's pipelines
    more = {
        "DPGES_COMPILED_DRIVER": driver, "DPGES_COMPILED_TABLE": str(table), "MESA_SHADER_CACHE_DISABLE": "true",
        "CUBECL_DEBUG_LOG": str(log), "WGPU_DEBUG": "1",
    }
    for card, family in CARDS.items():
        for name, command in kit.training_and_path(f"{kit.folder}/{family}").items():
            for file in [table, log]:
                file.unlink(missing_ok=True)
            code, output = kit.run(command, vulkan(icds[0], RADV_FORCE_FAMILY=family, **loaded, **more))
            if code != 0 or not table.is_file():
                said = re.search(r"^compiled: .*", output, re.MULTILINE)
                sys.exit(f"{name} for {card}: {said[0] if said else failed(code, output)[0]}")
            logged = log.read_text() if log.is_file() else ""
            kernels = re.findall(r"^name: ([\w:]+)::\w+.*?^@compute[^\n]*\nfn (\w+)", logged, re.DOTALL | re.MULTILINE)
            modules = {kernel: path for path, kernel in kernels}
            of_card, *shaders = map(json.loads, table.read_text().splitlines())
            for shader in shaders:
                path, of_pipeline = modules.get(shader["name"]), f"{shader['pipeline']}: {shader['name']}"
                shader["name"] = path.split("::", 1)[-1].replace("::cube::", "::") if path else of_pipeline
            yield card, name, f"{of_card['card']}, {of_card['driver']}", shaders


def compile_only(kit, driver):
    """Prints what the driver says of the shaders; returns whether none spills, and all of it."""
    found, passed = [], True
    print("| card | driver | what ran | shaders | that spill | lowest occupancy |\n|---|---|---|---:|---|---|")
    for card, run, version, shaders in compiled(kit, driver):
        found.append({"card": card, "driver": version, "of": run, "shaders": shaders})
        spill = sorted({shader["name"] for shader in shaders if any(shader["statistics"][key] for key in SPILLS)})
        passed &= not spill
        least = min((shader for shader in shaders if shader["launches"]), key=lambda shader: shader["statistics"][OCCUPANCY])
        cells = [card, version, run, len(shaders), f"**{', '.join(spill)}**" if spill else "none"]
        print(f"| {' | '.join(map(str, cells))} | {least['statistics'][OCCUPANCY]} ({least['name']}) |", flush=True)
    columns = ["workgroup", "VGPRs", "SGPRs", "spilled", "occupancy", "instructions", "latency", "launches", "groups each", "share"]
    for table in found:
        print(f"\n| {table['card']}, {table['of']} | {' | '.join(columns)} |\n|---|{'---:|' * len(columns)}")
        waits = [(shader["launches"] * shader["statistics"]["Latency"], shader) for shader in table["shaders"]]
        total = sum(wait for wait, _ in waits)
        for wait, shader in sorted(waits, key=lambda pair: pair[0], reverse=True)[:MOST_EXPENSIVE]:
            of, launches, computes = shader["statistics"], shader["launches"], any(shader["workgroup"])
            cells = ["x".join(map(str, shader["workgroup"])) if computes else "–", of["VGPRs"], of["SGPRs"]]
            cells += [sum(of[key] for key in SPILLS), of[OCCUPANCY], of["Instructions"], of["Latency"], launches]
            cells += [f"{shader['workgroups'] / launches:.0f}" if computes else "–", f"{wait / total:.1%}"]
            print(f"| {shader['name']} | {' | '.join(map(str, cells))} |")
    return passed, found


def line(name, version, cells):
    """Prints a row of the table; returns what is kept of it."""
    print(f"| {name}: {version} | " + " | ".join(text if ok else f"**{text}**" for text, ok in cells) + " |", flush=True)
    return {"driver": name, "version": version, "cells": [text for text, _ in cells]}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dpges", help="the program, built with `cargo build --release`")
    parser.add_argument("--only", action="append", help="drivers whose names contain this; `validation: core`, `order of workgroups: dpges, shuffle`")
    parser.add_argument("--page", help="a folder that browser.py left with --keep, for the rows of Chromium")
    parser.add_argument("--compile-only", metavar="DRIVER", help="libvulkan_radeon.so of Mesa 25: what it compiles for cards of AMD")
    parser.add_argument("--json", help="where to write everything that was found")
    parser.add_argument("--limit", type=float, default=900, help="most seconds for a cell (default 900)")
    options = parser.parse_args()
    if options.page and not (Path(options.page) / "reference.json").is_file():
        parser.error(f"--page {options.page}: no reference.json there; make it with browser.py --keep {options.page}")
    if options.compile_only and not Path(options.compile_only).is_file():
        parser.error(f"--compile-only {options.compile_only}: no such file; give Mesa's libvulkan_radeon.so")
    passed, table = True, []

    def wanted(name):
        named = not options.only or any(only.lower() in name.lower() for only in options.only)
        return named and not options.compile_only

    with tempfile.TemporaryDirectory() as folder:
        kit = Kit(options, folder)
        if options.compile_only:
            passed, table = compile_only(kit, str(Path(options.compile_only).resolve()))
        chosen = [row for row in rows() if wanted(row.name)]
        if chosen or options.page and any(map(wanted, BROWSERS.values())):
            print("| driver | selftest | extremes | kernels' tests | training | real-time renderer |")
            print("|---|---|---|---|---|---|")
        for row in chosen:
            found = kit.driver(row)
            if found is None:
                print(f"{row.name}: no adapter", file=sys.stderr)
                continue
            device, driver = found
            measures = [kit.selftest, kit.extremes, kit.kernels, kit.training] if row.computes else []
            cells = [measure(row.environment, device) for measure in measures] or [("–", True)] * 4
            cells.append(kit.raster(row.environment, device))
            passed &= all(ok for _, ok in cells)
            table.append(line(row.name, driver, cells))
        for backend, name in BROWSERS.items() if options.page else []:
            if wanted(name):
                cells = [("–", True)] * 4 + [kit.page(backend, options.page)]
                passed &= cells[-1][1]
                table.append(line(name, kit.run([program(), "--version"], {})[1].strip().splitlines()[-1], cells))
        layers = Path("/usr/share/vulkan/explicit_layer.d") / VALIDATION_LAYER
        if layers.is_file() and any(wanted(f"validation: {kind}") for kind in FEATURES):
            print("\n| validation | what ran | messages |\n|---|---|---|")
            for kind, name, code, messages, _ in validation(kit, wanted):
                passed &= code == 0 and not messages
                print(f"| {kind} | {name} | {', '.join(messages) or 'none'}{'' if code == 0 else f' (exit {code})'} |", flush=True)
                table.append({"validation": kind, "of": name, "exit": code, "messages": messages})
        digests = {}
        for method, order, digest, cut in orders(kit, wanted):
            if not digests:
                print("\n| method | orders of workgroups | most dispatches cut | scenes |\n|---|---|---|---|")
            digests.setdefault(method, {})[order] = (digest, cut)
            if digest is None:
                print(f"{method}, {order}: no scene, or the layer did not cut", file=sys.stderr)
        for method, found in digests.items():
            scenes, most = {digest for digest, _ in found.values()}, max(cut for _, cut in found.values())
            missing = [order for order, (digest, _) in found.items() if digest is None]
            agree = len(scenes) == 1 < len(found) and not missing
            passed &= agree
            differ = f"**none of {', '.join(missing)}**" if missing else f"**{len(scenes)} of {len(found)} differ**"
            same = "the same bytes" if agree else differ
            print(f"| {method} | {', '.join(found)} | {most:.0%} | {same} |")
            table.append({"method": method, "scenes": {order: digest for order, (digest, _) in found.items()}, "cut": most})
    if options.json:
        Path(options.json).write_text(json.dumps(table, indent=1))
    sys.exit(0 if passed and table else 1)


if __name__ == "__main__":
    main()
