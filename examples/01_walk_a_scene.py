"""Walk the built-in two-room flat with the oracle and save what the agent saw.

Run: python examples/01_walk_a_scene.py [OUT_FOLDER]
"""

import sys
from pathlib import Path

from PIL import Image

from gn0 import open_simulator, run_episode
from gn0.missions import sample_goal_episodes
from gn0.policies import PolicyOracle
from gn0.scenes import build_example_scene


def main(out: Path) -> None:
    scene = build_example_scene()
    simulator = open_simulator(scene, preset="vlnce_r2r", sensors={"rgb", "depth", "bev"})
    episode = sample_goal_episodes(scene, simulator.navigation, count=1, seed=1)[0]
    trajectory = run_episode(simulator, PolicyOracle(), episode)
    first = simulator.reset(episode)
    print(first.instruction)
    last = simulator.observe_at(trajectory.poses[-1])
    out.mkdir(parents=True, exist_ok=True)
    for name, observation in (("first", first), ("last", last)):
        Image.fromarray(observation.rgb).save(out / f"{name}.png")
    Image.fromarray(first.bev).save(out / "map.png")
    print(f"{len(trajectory.actions)} actions, pictures in {out}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/example"))
