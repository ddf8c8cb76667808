#!/usr/bin/env python3
"""Trains the built-in scene in four blocks on a Ray cluster of two nodes with a core each, one of which is lost on the way.

    pip install ray
    python3 tests/ray_blocks.py target/release/dpges

Ends with 0 if the plan is finished all the same, no block that was done has been touched again, and the same command once more
does nothing.
"""
import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from ray.cluster_utils import Cluster

ROOT = Path(__file__).resolve().parent.parent
BLOCKS = 4
SMALL = ["--steps", "900", "--max-resolution", "64", "--budget", "2000"]
LIMIT_S = 900


def done(folder):
    """When each step that is done was done, by its name."""
    return {file.parent.name: file.stat().st_mtime_ns for file in folder.glob("*/done.json")}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dpges", type=Path)
    dpges = str(parser.parse_args().dpges.resolve())
    with tempfile.TemporaryDirectory() as at:
        folder = Path(at) / "plan"
        subprocess.run([dpges, "blocks", "plan", "builtin", "--out", folder, "--blocks", str(BLOCKS), *SMALL], check=True)
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
        nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
        cluster.wait_for_nodes()
        script = [sys.executable, ROOT / "dpges-train/tools/dpges_ray.py", folder, "--dpges", dpges, "--device=cpu", "--gpus=0"]
        script.append(f"--address={cluster.address}")
        running, start = subprocess.Popen(script), time.monotonic()
        while not any(name.startswith("block-") for name in done(folder)):
            if running.poll() is not None or time.monotonic() > start + LIMIT_S:
                sys.exit("no block came to its end")
            time.sleep(0.2)
        before = done(folder)
        cluster.remove_node(nodes[1], allow_graceful=False)
        print(f"a node is lost; done were {', '.join(sorted(before))}", flush=True)
        code = running.wait(timeout=LIMIT_S)
        after = done(folder)
        again = subprocess.run(script, capture_output=True, text=True, timeout=LIMIT_S)
        cluster.shutdown()
        expected = {"coarse", "merged", *(f"block-{block}" for block in range(BLOCKS))}
        checks = {
            "the plan is finished": code == 0 and set(after) == expected,
            "blocks that were done are as they were": all(after[name] == when for name, when in before.items()),
            "the scene is there": (folder / "merged/scene.safetensors").is_file(),
            "the same command does nothing": again.stdout.count("done before") == len(expected) and done(folder) == after,
        }
        for name, passed in checks.items():
            print(f"{name}: {'yes' if passed else 'NO'}")
        sys.exit(0 if all(checks.values()) else 1)


if __name__ == "__main__":
    main()
