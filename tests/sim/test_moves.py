"""What a Teleport or Displacement costs: the steps that the body needs to turn and walk there."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gn0.errors import PolicyError, SimError
from gn0.geometry import Pose2D, wrap_angle
from gn0.missions.episode import AgentSpec
from gn0.sim.kinematics import plan_journey
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.sim.state import Action, Displacement, Observation, Teleport
from gn0.testing.scenes import build_point_episodes

BODY = AgentSpec()  # 0.25 m, 15 degrees
DEGREE = math.pi / 180


@pytest.mark.parametrize(
    ("move", "steps"),
    [
        ((0.25, 0.0, 0.0), 1),  # a FORWARD
        ((0.0, 0.0, 15 * DEGREE), 1),  # a LEFT
        ((0.0, 0.0, 0.0), 1),  # nothing is not free
        ((0.0, 0.0, 16 * DEGREE), 2),
        ((0.26, 0.0, 0.0), 2),
        ((2.0, 0.0, 0.0), 8),
        ((99.0, 0.0, 0.0), 396),
        ((0.0, 1.0, 90 * DEGREE), 6 + 4),  # turn to the left and walk
        ((0.0, 1.0, 0.0), 6 + 4 + 6),  # and look ahead again
        ((-0.5, 0.0, 0.0), 12 + 2 + 12),  # it cannot walk backwards
        ((0.25, 0.02, 0.0), 2 + 1),  # a little aside: two small turns are one together
        ((0.25, 0.0, math.pi), 1 + 12),
    ],
)
@pytest.mark.parametrize("yaw", [0.0, 1.234, -3.0])
def test_a_move_costs_what_walking_it_would(
    move: tuple[float, float, float], steps: int, yaw: float
) -> None:
    pose = Pose2D(3.7, -41.3, yaw)
    x, y, end = Displacement(*move).at(pose)
    assert plan_journey(pose, x, y, end, BODY).steps == steps


class PolicyLost:
    """Wants to make one move, again and again."""

    name = "lost"
    sensors: frozenset[str] = frozenset()

    def __init__(self, move: Displacement | Teleport) -> None:
        self.move = move

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        pass

    def act(self, observation: Observation) -> Displacement | Teleport:
        return self.move


@pytest.mark.parametrize("move", [Displacement, Teleport])
@pytest.mark.parametrize("place", [(1e308, 0.0), (0.0, -1e308), (1e308, 1e308), (2e9, 0.0)])
def test_a_move_to_the_end_of_the_world_is_refused_and_told_of_its_policy(
    plan_scene, move, place
) -> None:
    """The steps of such a way are no number."""
    simulator = open_simulator(plan_scene)
    episode = build_point_episodes(plan_scene, simulator.navigation, 1)[0]
    simulator.reset(episode)
    before = simulator.pose
    with pytest.raises(SimError, match=r"leads farther than 1e\+09 m"):
        simulator.step(move(*place, 0.0))
    assert simulator.pose == before and simulator.steps == 0
    with pytest.raises(PolicyError, match=r"step 0: policy 'lost' returned no valid action: \w+"):
        run_episode(simulator, PolicyLost(move(*place, 0.0)), episode)


def test_a_move_costs_the_episodes_own_body() -> None:
    body = AgentSpec(forward_step=0.5, turn_degrees=30.0)
    assert plan_journey(Pose2D(0, 0, 0), 0.0, 2.0, math.pi / 2, body).steps == 4 + 3


def test_moves_and_single_actions_cost_the_same(plan_scene) -> None:
    """Turns of 15° and whole strides, cut by walls or not: the same steps, collisions and place."""
    rng = np.random.default_rng(5)
    free = open_simulator(plan_scene, max_steps=100_000)
    walker = open_simulator(plan_scene, max_steps=100_000)
    episode = build_point_episodes(plan_scene, free.navigation, 1)[0]
    cut = 0
    for _ in range(150):
        for simulator in (free, walker):
            simulator.reset(episode)
        turns, strides, after = rng.integers(-11, 12), rng.integers(1, 12), rng.integers(-11, 12)
        bearing = wrap_angle(turns * 15 * DEGREE)
        length = strides * 0.25
        move = Displacement(
            length * math.cos(bearing), length * math.sin(bearing), (turns + after) * 15 * DEGREE
        )
        jumped = free.step(move)
        collided = False
        for _ in range(abs(turns)):
            walker.step(Action.LEFT if turns > 0 else Action.RIGHT)
        for _ in range(strides):
            collided = walker.step(Action.FORWARD).collided
            if collided:
                break
        for _ in range(abs(after)):
            walker.step(Action.LEFT if after > 0 else Action.RIGHT)
        assert jumped.collided == collided
        # a straight line of cells is not the line of its parts: cut, they may differ by a stride
        assert abs(free.steps - walker.steps) <= int(collided)
        if not collided:
            assert free.steps == walker.steps == jumped.steps
            assert np.allclose(free.pose, walker.pose)
        cut += collided
    assert 20 < cut < 130


def test_a_journey_ends_with_the_episodes_steps(make_simulator, make_episode) -> None:
    """A jump of 99 m used to be one step, also as the last one."""
    simulator = make_simulator(max_steps=20)
    simulator.reset(make_episode(start=(1.0, 2.3, 0.0)))
    for _ in range(12):
        simulator.step(Action.LEFT)
    simulator.step(Action.LEFT)
    result = simulator.step(Teleport(6.0, 2.3, 0.0))  # needs 13 turns and 20 strides; 7 are left
    assert result.truncated and not result.terminated and not result.collided
    assert (simulator.steps, result.steps, result.moved) == (20, 7, 0.0)
    assert simulator.pose.yaw == pytest.approx(wrap_angle((13 + 7) * 15 * DEGREE))

    simulator.reset(make_episode(start=(1.0, 2.3, 0.0)))
    result = simulator.step(Teleport(6.5, 2.3, 1.0))  # 22 strides
    assert result.truncated and result.steps == 20
    assert simulator.pose == pytest.approx((6.0, 2.3, 0.0))

    simulator.reset(make_episode(start=(1.0, 2.3, 0.0)))
    result = simulator.step(Teleport(5.5, 2.3, 45 * DEGREE))  # 18 strides, 3 turns
    assert result.truncated and simulator.pose == pytest.approx((5.5, 2.3, 30 * DEGREE))


def test_a_cut_move_is_one_collision_among_the_steps_to_the_wall(
    make_simulator, make_episode
) -> None:
    simulator = make_simulator()
    simulator.reset(make_episode(start=(1.0, 2.5, math.pi)))
    result = simulator.step(Displacement(50.0, 0.0, 0.0))
    assert result.collided and result.moved < 1.0
    assert result.steps == math.floor(result.moved / 0.25) + 1, "not the 200 that it asked for"
    assert simulator.step(Displacement(50.0, 0.0, 0.0)).steps == 1, "at the wall already"


def test_moves_of_one_step_stay_where_they_are_asked_for(make_simulator, make_episode) -> None:
    simulator = make_simulator(max_steps=2)
    simulator.one_step_moves = True
    simulator.reset(make_episode(start=(1.0, 2.3, 0.0)))
    assert simulator.step(Teleport(6.0, 2.3, 1.0)).steps == 1
    assert simulator.pose == (6.0, 2.3, 1.0) and simulator.steps == 1


class PolicyMoves:
    """Two moves and STOP."""

    name = "moves"
    sensors = frozenset()

    def reset(self, instruction, rng) -> None:
        self.queue = [Action.LEFT, Displacement(1.0, 0.0, 0.0), Displacement(50.0, 0, 0), 0]

    def act(self, observation):
        return self.queue.pop(0)


def test_a_trajectory_tells_what_its_actions_cost(make_simulator, make_episode) -> None:
    simulator = make_simulator()
    walked = run_episode(simulator, PolicyMoves(), make_episode(start=(1.0, 2.5, 0.0)))
    assert walked.actions == (2, -1, -1, 0) and walked.costs[:2] == (1, 4)
    assert walked.steps == sum(walked.costs) == simulator.steps > 4
    simulator.one_step_moves = True
    single = run_episode(simulator, PolicyMoves(), make_episode(start=(1.0, 2.5, 0.0)))
    assert single.costs == () and single.steps == 4
    assert single.poses == walked.poses
