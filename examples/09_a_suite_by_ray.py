"""A suite made by Ray on two machines, one of which is cut off in the middle of its work.

Run: python examples/09_a_suite_by_ray.py [OUT_FOLDER]

Needs Ray: pip install -e '.[scale]'. Both machines are nodes on this one. What the lost one held is
done again on the other, and the suite is, byte for byte, the one that a single process makes.
"""

import dataclasses
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

from gn0.scenes import build_example_scene, save_scene

SCENES = 6


def gn0(*told: str) -> subprocess.Popen[bytes]:
    """A gn0 command, begun."""
    return subprocess.Popen([sys.executable, "-m", "gn0", *told])


def wait(*running: subprocess.Popen[bytes]) -> None:
    """Wait for commands, all of which must succeed."""
    if any(process.wait() for process in running):
        raise SystemExit("a command failed: see above")


def files_of(folder: Path) -> dict[str, bytes]:
    """Every file of a folder, by its path there."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def cut_when_busy(cluster: Any, node: Any, folder: Path, running: subprocess.Popen[bytes]) -> bool:
    """Cut a machine off as soon as the first scene is done; whether it was in time."""
    while running.poll() is None:
        if any(folder.rglob("report.json")):
            cluster.remove_node(node, allow_graceful=False)
            return True
        time.sleep(0.05)
    return False


def main(out: Path) -> None:
    """Missions in six flats, twice: by one process, and on two machines."""
    try:
        from ray.cluster_utils import Cluster
    except ImportError:
        raise SystemExit("Ray is not installed: pip install -e '.[scale]'") from None

    flat = build_example_scene()
    for number in range(SCENES):
        save_scene(dataclasses.replace(flat, id=f"flat-{number}"), out / "flats" / str(number))
    missions = ["missions", "generate", f"{out}/flats", "--name", "flats", "--per-scene", "20"]
    wait(gn0(*missions, "--out", f"{out}/alone"))

    warnings.simplefilter("ignore")  # Ray's own sockets, open when it ends
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    other = cluster.add_node(num_cpus=1)
    try:
        running = gn0(*missions, "--executor", "ray", "--ray-address", cluster.address,
                      "--workers", "2", "--out", f"{out}/by-ray")  # fmt: skip
        cut = cut_when_busy(cluster, other, out / "by-ray", running)
        wait(running)
    finally:
        cluster.shutdown()
    same = files_of(out / "alone") == files_of(out / "by-ray")
    print(f"a machine was {'cut off' if cut else 'too late to be cut off'}; same bytes: {same}")
    if not same:
        raise SystemExit(1)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/by-ray"))
