#!/usr/bin/env python3
"""How the time and memory of a training step grow with primitives, pixels and views.

    python3 benches/growth.py target/release/dpges --device cpu --json growth.json

Runs `dpges bench step` on the room of the benchmarks, one size after another, and prints Markdown tables. The exponent of a
row is that between it and the row before: 1 means twice the time for twice the size. Below 1 a constant part remains. Needs
Python 3.8; with --plot also matplotlib. An idle machine, or times mean little.
"""

import argparse
import importlib.util
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

# Least time that the counted steps of a size take together, s, as far as ROUNDS allow.
MEASURED_S = 4.0
ROUNDS = (3, 30)
# Gaussians; a tenth as many surfels, of as much area together. Their number is the same in the other sweeps.
PRIMITIVES = [1_000, 10_000, 100_000, 300_000, 1_000_000, 3_000_000]
GAUSSIANS = 100_000
# Pictures of 4 : 3.
WIDTHS = [400, 800, 1600, 3264]
VIEWS = [1, 8, 64]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dpges", type=Path, help="the program")
    parser.add_argument("--device", default="cpu", help="as `dpges bench step` takes it")
    parser.add_argument("--most", type=int, default=PRIMITIVES[-1], help="largest number of Gaussians")
    parser.add_argument("--run", type=Path, help="folder of a run: its scene is measured with more and more of its views")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--plot", type=Path, help="file for a plot, such as growth.svg")
    options = parser.parse_args()
    if not options.dpges.is_file():
        parser.error(f"{options.dpges} is not there: build it with `cargo build --release`")
    if options.most < PRIMITIVES[0]:
        parser.error(f"--most {options.most}: expected at least {PRIMITIVES[0]}")
    if options.plot and not importlib.util.find_spec("matplotlib"):
        parser.error("--plot needs matplotlib: pip install matplotlib")
    sweeps = {}
    for unit, sizes in sweeps_of(options):
        sweeps[unit] = rows = []
        print(f"\n| {unit} | step, ms | exponent | peak memory, MB | exponent |\n|---:|---:|---:|---:|---:|")
        for size, arguments in sizes:
            measured = measure(options, arguments)
            rows.append({unit: size, "ms": measured["median_ms"], "bytes": measured["process_peak_bytes"]})
            print(row_of(rows, unit), flush=True)
    if options.json:
        options.json.write_text(json.dumps({"device": options.device, "sweeps": sweeps}, indent=1) + "\n")
    if options.plot:
        plot(sweeps, options.plot)


def sweeps_of(options):
    """What grows in each sweep, and sizes with their arguments."""

    def room(gaussians, width):
        size = f"{width}x{width * 3 // 4}"
        return ["realistic", "--gaussians", gaussians, "--surfels", gaussians // 10, "--size", size]

    primitives = [(11 * count // 10, room(count, WIDTHS[0])) for count in PRIMITIVES if count <= options.most]
    pixels = [(width * width * 3 // 4, room(min(GAUSSIANS, options.most), width)) for width in WIDTHS]
    yield "primitives", primitives
    yield "pixels", pixels
    if options.run:
        yield "views", [(count, [options.run, "--split", "train", "--cameras", count]) for count in VIEWS]


def measure(options, arguments):
    """The report of a size: of a few steps, and if these are short of so many that chance matters little."""
    rounds = ROUNDS[0]
    while True:
        with tempfile.TemporaryDirectory() as folder:
            answer = Path(folder) / "step.json"
            command = [options.dpges, "bench", "step", *arguments, "--device", options.device, "--json", answer]
            command += ["--rounds", rounds, "--warm-up", 1]
            done = subprocess.run([str(part) for part in command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
            if done.returncode != 0:
                sys.exit(f"{' '.join(map(str, command))} failed:\n{done.stderr}")
            report = json.loads(answer.read_text())
        wanted = math.ceil(1000 * MEASURED_S / report["median_ms"])
        if rounds > ROUNDS[0] or wanted <= rounds:
            return report
        rounds = min(wanted, ROUNDS[1])


def row_of(rows, unit):
    """The last of `rows` in Markdown."""
    now = rows[-1]
    cells = [f"{now[unit]:,}"]
    for key, text in [("ms", "{:.1f}".format), ("bytes", lambda value: f"{value / 1e6:.0f}")]:
        known = now[key] is not None
        cells.append(text(now[key]) if known else "")
        has_exponent = known and len(rows) > 1
        cells.append(f"{exponent(rows[-2], now, unit, key):.2f}" if has_exponent else "")
    return f"| {' | '.join(cells)} |"


def exponent(before, now, unit, key):
    return math.log(now[key] / before[key]) / math.log(now[unit] / before[unit])


def plot(sweeps, path):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(sweeps), figsize=(4 * len(sweeps), 3.4))
    for axis, (unit, rows) in zip(axes, sweeps.items()):
        sizes = [row[unit] for row in rows]
        for key, label, factor in [("ms", "step, ms", 1), ("bytes", "peak memory, MB", 1e-6)]:
            known = [(size, factor * row[key]) for size, row in zip(sizes, rows) if row[key] is not None]
            if known:
                axis.loglog(*zip(*known), "o-", label=label)
        axis.set_xlabel(unit)
        axis.grid(True, which="major", alpha=0.3)
        axis.legend()
    figure.tight_layout()
    figure.savefig(path)


if __name__ == "__main__":
    main()
