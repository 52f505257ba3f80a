"""A sensor of your own in one file: how far it is to what stands on the left, ahead, on the right.

Run: python examples/08_your_own_sensor.py
"""

import numpy as np

from gn0 import Action, open_simulator, register, run_episode
from gn0.missions import sample_goal_episodes
from gn0.scenes import build_example_scene
from gn0.sim import Sensor, Space, VectorEnv
from gn0.testing import check_sensor

CLEARANCE = Sensor(
    name="clearance",
    doc="float32 [3] m: the nearest that is seen in the left, middle and right third",
    space=lambda settings: Space((3,), np.float32, *settings.preset.depth_range),
    draws=frozenset({"depth"}),
    read=lambda here: np.array([p.min() for p in np.array_split(here.seen("depth"), 3, axis=1)]),
)
register("sensor", CLEARANCE.name, CLEARANCE)


class PolicyWanderer:
    """Walk where there is room; stop after forty actions."""

    name = "wanderer"
    sensors = frozenset({"clearance"})

    def reset(self, instruction, rng):
        self.left = 40

    def act(self, observation):
        self.left -= 1
        left, ahead, right = observation.read("clearance")
        if self.left < 0:
            return Action.STOP
        if ahead > 0.6:
            return Action.FORWARD
        return Action.LEFT if left > right else Action.RIGHT


def main() -> None:
    check_sensor(CLEARANCE)
    scene = build_example_scene()
    simulator = open_simulator(scene, preset="vlnce_r2r", sensors={"clearance"})
    episode = sample_goal_episodes(scene, simulator.navigation, count=1, seed=0)[0]
    trajectory = run_episode(simulator, PolicyWanderer(), episode)
    print(f"{sum(trajectory.collided)} collisions in {trajectory.steps} steps")
    env = VectorEnv(4, scene, sensors=("clearance",), preset="vlnce_r2r")
    seen, _ = env.reset(seed=0)
    print(env.observation_space["clearance"], seen["clearance"].round(2).tolist())


if __name__ == "__main__":
    main()
