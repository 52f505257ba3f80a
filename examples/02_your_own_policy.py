"""A policy of your own in twenty lines, checked against the contract and run on episodes.

Run: python examples/02_your_own_policy.py
"""

from gn0 import Action, open_simulator, run_episode
from gn0.missions import sample_goal_episodes
from gn0.scenes import build_example_scene
from gn0.testing import check_policy


class PolicyBumper:
    """Walk until something is in the way, then turn by chance; stop after fifty actions."""

    name = "bumper"
    sensors = frozenset({"depth"})

    def reset(self, instruction, rng):
        self.rng = rng
        self.left = 50

    def act(self, observation):
        self.left -= 1
        if self.left < 0:
            return Action.STOP
        middle = observation.depth[:, observation.depth.shape[1] // 2]
        if observation.collided or middle.min() < 0.5:
            return Action.LEFT if self.rng.random() < 0.5 else Action.RIGHT
        return Action.FORWARD


def main() -> None:
    check_policy(PolicyBumper)
    scene = build_example_scene()
    simulator = open_simulator(scene, preset="vlnce_r2r", sensors={"depth"})
    for episode in sample_goal_episodes(scene, simulator.navigation, count=3, seed=0):
        trajectory = run_episode(simulator, PolicyBumper(), episode)
        distance = simulator.navigation.geodesic(episode.goal).distance_at(
            *trajectory.poses[-1][:2]
        )
        print(f"{episode.instruction:50} ends {distance:.1f} m away")


if __name__ == "__main__":
    main()
