"""Runs tools/dpges_ray.py on a cluster of two nodes of one core, and removes one in the middle: ray_cluster.py TOOL DPGES DIR.

Prints as JSON which blocks were done by then.
"""
import json
import subprocess
import sys
import time
from pathlib import Path

from ray.cluster_utils import Cluster

tool, dpges, folder = sys.argv[1:]
# a driver that has no cores, so that tasks run on the other two
cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
nodes = [cluster.add_node(num_cpus=1, include_dashboard=False) for _ in range(2)]
words = [sys.executable, tool, folder, f"--dpges={dpges}", "--device=cpu", "--gpus=0", f"--address={cluster.address}"]
driver = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)


def done():
    return sorted(path.parent.name for path in Path(folder).glob("block-*/done.json"))


def begun():
    return [path.parent.name for path in Path(folder).glob("block-*/checkpoint.safetensors")]


try:
    end = time.monotonic() + 240
    # a block is done, and both nodes work on others
    while not (done() and len(set(begun()) - set(done())) == 2):
        if driver.poll() is not None or time.monotonic() > end:
            sys.exit(f"no block is done while others train: {done()} done, {begun()} begun")
        time.sleep(0.01)
    before = done()
    cluster.remove_node(nodes[0], allow_graceful=False)
    printed, _ = driver.communicate(timeout=300)
    print(json.dumps({"before": before, "code": driver.returncode, "printed": printed}))
finally:
    driver.kill()
    cluster.shutdown()
