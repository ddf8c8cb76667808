#!/usr/bin/env python3
"""Trains the blocks of a plan with Ray: the coarse scene, then one remote task for each block, then the merge.

    pip install ray
    dpges blocks plan CAPTURE --out DIR
    python3 tools/dpges_ray.py DIR

Ray places the tasks on GPUs and starts them again, elsewhere, where a worker or a machine is lost. All machines share DIR and
the dataset. A task runs `dpges blocks`, which does nothing if its step is done, and goes on from its last checkpoint.
Blocks that fail for good are named, and the same command tries them again.
"""
import argparse
import json
import os
import subprocess
import sys
from pathlib import Path


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dir", type=Path, help="folder of the plan (`dpges blocks plan`)")
    parser.add_argument("--dpges", default="dpges", help="the program, by its path on all machines [default: dpges]")
    parser.add_argument("--device", default="auto", help="--device of every step [default: auto]")
    parser.add_argument("--gpus", type=float, default=1.0, help="GPUs of a task; 0 to train on CPUs [default: 1]")
    parser.add_argument("--cpus", type=float, default=1.0, help="CPU cores of a task [default: 1]")
    parser.add_argument("--retries", type=int, default=3, help="times that Ray starts a task again [default: 3]")
    parser.add_argument("--address", help="address of the cluster [default: that of RAY_ADDRESS, or else this machine]")
    return parser.parse_args()


def run_step(words, log):
    """Runs `dpges blocks` to its end. Its messages go to the file `log`. It ends when this process does, by its input."""
    environment = {**os.environ, "DPGES_FOR_ANOTHER": "1"}
    with open(log, "ab") as file:
        process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=file, stderr=subprocess.STDOUT, env=environment)
        try:
            code = process.wait()
        finally:
            process.stdin.close()
    if code != 0:
        lines = Path(log).read_text(errors="replace").splitlines()[-12:]
        raise RuntimeError(f"`{' '.join(words)}` ended with code {code}; the end of {log}:\n" + "\n".join(lines))


def main():
    args = arguments()
    folder = args.dir.resolve()
    try:
        blocks = len(json.loads((folder / "plan.json").read_text())["blocks"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        sys.exit(f"{folder} holds no plan: {error}; `dpges blocks plan DATASET --out {args.dir}` makes one")

    try:
        import ray
    except ImportError:
        sys.exit("Ray is not installed: pip install ray")
    ray.init(address=args.address, log_to_driver=False, logging_level="ERROR")

    # a step that fails may do better elsewhere, as a step on a machine that is lost
    options = {"num_cpus": args.cpus, "num_gpus": args.gpus, "max_retries": args.retries, "retry_exceptions": True}
    task = ray.remote(**options)(run_step)

    def start(name, *step):
        words = [args.dpges, "blocks", step[0], str(folder), *step[1:], f"--device={args.device}"]
        return task.options(name=name).remote(words, str(folder / f"{name}.log"))

    def finish(running):
        """Waits for all of `running`, names by task. Returns whether all of them came to their end."""
        failed = False
        while running:
            (ready,), _ = ray.wait(list(running), num_returns=1)
            name = running.pop(ready)
            try:
                ray.get(ready)
                print(f"{name}: done", flush=True)
            except Exception as error:  # whatever a task or Ray raises, the others go on
                failed = True
                print(f"{name}: failed: {error}", file=sys.stderr, flush=True)
        return not failed

    def is_done(name):
        return (folder / name / "done.json").is_file()

    names = [f"block-{block}" for block in range(blocks)]
    steps = [
        {"coarse": ["coarse"]},
        {name: ["train", f"--block={block}"] for block, name in enumerate(names)},
        {"merged": ["merge"]},
    ]
    for step in steps:
        left = {name: words for name, words in step.items() if not is_done(name)}
        for name in step.keys() - left.keys():
            print(f"{name}: done before", flush=True)
        if not finish({start(name, *words): name for name, words in left.items()}):
            sys.exit("the same command tries again what has failed")
    print(folder / "merged" / "scene.safetensors")


if __name__ == "__main__":
    main()
