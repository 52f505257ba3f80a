"""A ball rolls through the built-in flat, a box turns, a door leaf swings: three renderers see it.

Run: python examples/07_a_ball_rolls.py [OUT_FOLDER]

The CPU draws it from all splats, and from those that are visible near the eye; CUDA where a card
is, or where GN0_DEVICE=host has its kernels run on the CPU. A moment costs three poses: no splat of
a moving part is copied or moved.
"""

import math
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from gn0 import Camera, view_from_pose
from gn0.device import find_device
from gn0.maps import NavigationMap
from gn0.render import DrawnScene, open_renderer
from gn0.scenes import build_ball, build_box, build_example_scene, build_leaf
from gn0.sim import PartPath, PathMotion

RADIUS, EYE = 0.15, 1.2  # m


def stand(x: float, y: float, z: float, yaw: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """Part to world [4, 4]: turned by `roll` about y, then by `yaw` about z, at (x, y, z) m."""
    pose = np.eye(4)
    c, s, cr, sr = math.cos(yaw), math.sin(yaw), math.cos(roll), math.sin(roll)
    turn, over = (
        np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
        np.array([[cr, 0, sr], [0, 1, 0], [-sr, 0, cr]]),
    )
    pose[:3, :3], pose[:3, 3] = turn @ over, (x, y, z)
    return pose


def build_motion() -> PathMotion:
    """A ball along x, a box on the spot, a leaf on its hinge; 4 s."""
    times = np.linspace(0.0, 4.0, 17)
    ball = np.stack([stand(2.0 + 0.35 * t, 2.2, RADIUS, roll=0.35 * t / RADIUS) for t in times])
    box = np.stack([stand(3.0, 2.9, 0.0, yaw=0.8 * t) for t in times])
    leaf = np.stack([stand(3.4, 1.4, 0.02, yaw=0.35 * t) for t in times])
    clouds = {"ball": build_ball(RADIUS), "box": build_box(), "leaf": build_leaf(0.7, 1.9)}
    dim = np.array([0.7, 0.7, 0.75], np.float32)  # the box stands in the shade
    paths = [
        PartPath("ball", times, ball),
        PartPath("box", times, box, dim),
        PartPath("leaf", times, leaf),
    ]
    return PathMotion(clouds, paths)


def main(out: Path) -> None:
    scene, motion = build_example_scene(), build_motion()
    camera = Camera.from_hfov(320, 240, 90)
    views = view_from_pose(0.6, 2.4, EYE, 0.0, -0.15)[None].repeat(6, axis=0)
    moments = [motion.at(time) for time in np.linspace(0.0, 4.0, 6)]
    ways = [("cpu", False), ("cpu", True)]
    if find_device()[0] is not None:
        ways.append(("cuda", False))
    floor = NavigationMap(scene.grid, 0.2).inflated
    rows, first = [], None
    for backend, visible in ways:
        renderer = open_renderer(backend)
        renderer.keep("flat", scene.gaussians)
        drawn = DrawnScene(renderer, "flat")
        if visible:
            drawn = drawn.limit_to_visible(scene.cloud_hash, floor, EYE)
        for name, cloud in motion.clouds.items():
            drawn.name_cloud(name, cloud)
        seen = drawn.render(camera, views, outputs=("rgb",), parts=moments).rgb
        rows.append(np.concatenate(list(seen), axis=1))
        first = seen if first is None else first
        off = np.abs(seen.astype(int) - first.astype(int))
        print(f"{drawn.name}: {off.mean():.3f} of 255 from the first renderer, on average")
    still = open_renderer("cpu")
    still.keep("flat", scene.gaussians)
    assert (still.render(camera, views[:1], "flat").rgb[0] != first[0]).any()
    out.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(rows, axis=0)).save(out / "ball.png")
    print(f"a row a renderer, a column a moment: {out / 'ball.png'}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/ball"))
