#!/usr/bin/env python3
"""Measures dpges on a Linux machine with a GPU, from a binary that was built elsewhere.

    python3 gpu.py path/to/dpges --out results

Needs Python 3.8 and nothing else; benches/README.md says what each part does. Writes results/gpu.json after every part,
the whole file or nothing, so that a part that fails or takes too long loses no other. Ends with 1 if a part failed.
"""

import argparse
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

# Seconds that each part may take; less than ten minutes together.
LIMITS = {
    "devices": 20,
    "selftest": 60,
    "train": 90,
    "render": 50,
    "step": 60,
    "step-large": 110,
    "dataset": 120,
}
TAIL = 4000
# Where containers with the driver of NVIDIA mount it.
DRIVER_FOLDERS = ["/usr/local/nvidia/share/vulkan/icd.d", "/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d"]


class Sizes:
    """What is measured: as large as scenes are, or as small as a try on a CPU bears (--tiny)."""

    def __init__(self, tiny):
        small = ["--steps", "20", "--max-resolution", "32", "--budget", "1000", "--set", "init.max_points=300"]
        self.train = small if tiny else []
        self.fallback_train = small if tiny else ["--steps", "300"]
        self.render = ["--size", "64x48", "--rounds", "1", "--warm-up", "0"] if tiny else ["--rounds", "5"]
        self.rounds = ["--rounds", "2", "--warm-up", "1"] if tiny else []
        self.builtin = ["--size", "32x32"] if tiny else []
        self.step = ["--size", "64x48", "--surfels", "100", "--gaussians", "500"] if tiny else ["--size", "400x400"]
        large = ["--size", "1920x1080", "--surfels", "150000", "--gaussians", "1500000"]
        self.large = ["--size", "96x64", "--surfels", "200", "--gaussians", "1000"] if tiny else large
        self.dataset = small if tiny else []


class LeftOut(Exception):
    """Why a part was not tried."""


class Kit:
    def __init__(self, options):
        self.options = options
        self.sizes = Sizes(options.tiny)
        self.out = options.out.resolve()
        self.environment = environment(options.vulkan)
        self.deadline = 0.0
        self.commands = []

    def run(self, *arguments, answer=None):
        """Runs dpges within what is left of the part's time; returns the JSON that it wrote to `answer`, or printed."""
        program = [str(self.options.dpges.resolve()), *map(str, arguments)]
        return self.run_program(program, answer)

    def run_program(self, program, answer=None):
        if answer is not None:
            answer.unlink(missing_ok=True)
        command = {"command": program, "exit_code": None, "seconds": None, "timed_out": False, "stdout": "", "stderr": ""}
        self.commands.append(command)
        begin = time.monotonic()
        child = subprocess.Popen(
            program,
            cwd=self.out,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        try:
            printed, said = child.communicate(timeout=max(1.0, self.deadline - begin))
        except subprocess.TimeoutExpired:
            # with the children that dpges starts to look for devices
            os.killpg(child.pid, signal.SIGKILL)
            printed, said = child.communicate()
            command["timed_out"] = True
        command["seconds"] = round(time.monotonic() - begin, 3)
        command["exit_code"] = child.returncode
        command["stdout"], command["stderr"] = printed[-TAIL:], said[-TAIL:]
        if child.returncode != 0:
            late = f"was stopped after {command['seconds']:.0f} s"
            why = late if command["timed_out"] else f"ended with {child.returncode}: {last_line(said)}"
            raise RuntimeError(f"{' '.join(program[1:4])} {why}")
        text = answer.read_text() if answer is not None else printed
        try:
            return json.loads(text)
        except ValueError:
            return None

    # The parts. Each returns what goes into the file as its result.

    def devices(self):
        return {"all": self.run("devices", "--json"), "auto": self.run("devices", "--auto", "--json")}

    def selftest(self):
        return self.run("selftest", "--device", self.options.device, "--json")

    def train(self):
        return {"evaluation": self.trained("builtin", self.sizes.train)}

    def render(self):
        scene = self.out / "builtin"
        if not (scene / "scene.safetensors").is_file():
            self.trained("builtin", self.sizes.fallback_train)
        answer = self.out / "render.json"
        more = ["--training", self.options.device, "--json", answer]
        return self.run("bench", "render", scene, *self.sizes.render, *more, answer=answer)

    def step(self):
        return {
            "builtin": self.bench_step("builtin", self.sizes.builtin, "step_builtin"),
            "realistic": self.bench_step("realistic", self.sizes.step, "step_realistic"),
            "blended": self.bench_step("realistic", [*self.sizes.step, "--stage", "blended"], "step_blended"),
        }

    def step_large(self):
        return self.bench_step("realistic", self.sizes.large, "step_large")

    def dataset(self):
        if self.options.dataset is None:
            raise LeftOut("no dataset was named (--dataset)")
        trained = [self.options.dataset.resolve(), *self.sizes.dataset]
        return {"evaluation": self.trained("dataset", trained)}

    def bench_step(self, scene, sizes, name):
        answer = self.out / f"{name}.json"
        more = ["--device", self.options.device, "--json", answer]
        return self.run("bench", "step", scene, *sizes, *self.sizes.rounds, *more, answer=answer)

    def trained(self, name, arguments):
        """Trains into the folder `name`; returns the evaluation of its held-out views."""
        folder = self.out / name
        self.run("train", *arguments, "--out", folder, "--overwrite", "--device", self.options.device, "--quiet")
        answer = self.out / f"{name}_evaluation.json"
        return self.run("eval", folder, "--device", self.options.device, "--json", answer, answer=answer)


def last_line(text):
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "it said nothing"


def environment(vulkan):
    """The environment of all programs: with the loader in the folder `vulkan`, and a driver for it."""
    variables = dict(os.environ)
    if vulkan is None:
        return variables
    loaders = sorted({str(file.parent) for file in vulkan.resolve().rglob("libvulkan.so*")})
    if not loaders:
        sys.exit(f"--vulkan {vulkan}: there is no libvulkan.so in it or in the folders below")
    before = variables.get("LD_LIBRARY_PATH")
    variables["LD_LIBRARY_PATH"] = os.pathsep.join(loaders + ([before] if before else []))
    folders = [vulkan.resolve(), *map(Path, DRIVER_FOLDERS)]
    drivers = next((found for found in map(drivers_in, folders) if found), [])
    if drivers:
        # the older and the newer name of the same variable
        variables["VK_ICD_FILENAMES"] = variables["VK_DRIVER_FILES"] = os.pathsep.join(drivers)
    return variables


def drivers_in(folder):
    """Descriptions of Vulkan drivers in `folder` and below."""
    found = []
    for file in sorted(folder.rglob("*.json")) if folder.is_dir() else []:
        try:
            described = json.loads(file.read_text())
        except (OSError, ValueError):
            continue
        if isinstance(described, dict) and "ICD" in described:
            found.append(str(file))
    return found


def machine(variables):
    """What the machine is, as far as it says."""
    info = {"system": platform.platform(), "python": platform.python_version(), "threads": os.cpu_count()}
    info["processor"] = line_of("/proc/cpuinfo", "model name")
    info["memory"] = line_of("/proc/meminfo", "MemTotal")
    info["gpus"] = nvidia(variables)
    names = ("LD_LIBRARY_PATH", "VK_ICD_FILENAMES", "VK_DRIVER_FILES")
    info["environment"] = {name: variables[name] for name in names if name in variables}
    return info


def line_of(path, key):
    try:
        lines = Path(path).read_text().splitlines()
    except OSError:
        return None
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith(key)), None)


def nvidia(variables):
    """Name, driver, memory and clock of every GPU of NVIDIA; None where nvidia-smi is missing or fails."""
    program = shutil.which("nvidia-smi")
    if program is None:
        return None
    fields = ["name", "driver_version", "memory.total", "clocks.max.sm", "power.limit"]
    query = [program, f"--query-gpu={','.join(fields)}", "--format=csv,noheader"]
    try:
        printed = subprocess.run(query, env=variables, capture_output=True, text=True, timeout=20, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return None
    return [dict(zip(fields, (value.strip() for value in line.split(",")))) for line in printed.splitlines() if line.strip()]


def write(path, value):
    """The whole file or nothing."""
    beside = path.with_name(path.name + ".new")
    beside.write_text(json.dumps(value, indent=2) + "\n")
    os.replace(beside, path)


def limit_of(text):
    name, _, seconds = text.partition("=")
    if name not in LIMITS or not seconds.isdigit() or int(seconds) == 0:
        raise argparse.ArgumentTypeError(f"`{text}` is not PART=SECONDS with one of the parts {', '.join(LIMITS)}")
    return name, int(seconds)


def parts_of(text):
    names = text.split(",")
    unknown = [name for name in names if name not in LIMITS]
    if unknown:
        raise argparse.ArgumentTypeError(f"there is no part {', '.join(unknown)}: {', '.join(LIMITS)}")
    return [name for name in LIMITS if name in names]


def parsed(arguments):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dpges", type=Path, help="the program")
    parser.add_argument("--out", type=Path, default=Path("gpu"), metavar="DIR", help="folder for all results [gpu]")
    parser.add_argument("--device", default="wgpu", metavar="NAME", help="as `dpges devices` lists them [wgpu]")
    parser.add_argument("--parts", type=parts_of, default=list(LIMITS), metavar="A,B", help=f"of {', '.join(LIMITS)} [all]")
    parser.add_argument("--dataset", type=Path, metavar="DIR", help="also train on these photographs")
    parser.add_argument("--vulkan", type=Path, metavar="DIR", help="folder with the Vulkan loader, libvulkan.so.1")
    parser.add_argument(
        "--limit", type=limit_of, action="append", default=[], metavar="PART=SECONDS", help="of one part; may be repeated"
    )
    parser.add_argument("--tiny", action="store_true", help="sizes to try the script with, not to measure")
    options = parser.parse_args(arguments)
    if not os.access(options.dpges, os.X_OK) or options.dpges.is_dir():
        parser.error(f"{options.dpges} is no program: name the file `dpges` that `cargo build --release` made")
    return options


def main(arguments):
    options = parsed(arguments)
    limits = {**LIMITS, **dict(options.limit)}
    kit = Kit(options)
    kit.out.mkdir(parents=True, exist_ok=True)
    path = kit.out / "gpu.json"
    report = {
        "program": str(options.dpges),
        "tiny": options.tiny,
        "begun": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "machine": machine(kit.environment),
        "parts": {},
    }
    write(path, report)
    failed = []
    for name in options.parts:
        kit.commands, begin = [], time.monotonic()
        kit.deadline = begin + limits[name]
        part = {"status": "done", "reason": None, "limit_seconds": limits[name], "seconds": None, "result": None}
        try:
            part["result"] = getattr(kit, name.replace("-", "_"))()
        except LeftOut as reason:
            part.update(status="left out", reason=str(reason))
        except (OSError, RuntimeError) as error:
            part.update(status="failed", reason=str(error))
            failed.append(name)
        part["seconds"] = round(time.monotonic() - begin, 3)
        part["commands"] = kit.commands
        report["parts"][name] = part
        write(path, report)
        print(f"{name:12}{part['status']:10}{part['seconds']:8.1f} s  {part['reason'] or ''}".rstrip(), flush=True)
    print(f"{path}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
