"""Noise of depth, pose and moves: the source's numbers, seeded, and none unless asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from gn0.errors import ConfigError, SimError
from gn0.seeds import random_stream
from gn0.sim.env import GoalNavEnv
from gn0.sim.noise import (
    ActuationNoise,
    MoveNoise,
    Noise,
    PoseNoise,
    Spread,
    blur_depth,
    find_actuation,
    sample_move,
)
from gn0.sim.open import open_simulator
from gn0.sim.state import Displacement, Teleport
from gn0.sim.vector import VectorEnv

LOUD = Noise(depth=1.0, pose=PoseNoise(place=0.05, drift_heading=0.01), actuation=find_actuation())
# habitat-sim 0586bec, habitat_sim/agent/controls/pyrobot_noisy_controls.py, lines 101 to 157:
# means of (along, across), of rotation; variances of the same; moves, then turns
SOURCE = {
    ("LoCoBot", "ILQR"): [
        ([0.014, 0.009], [0.006, 0.005], 0.008, 0.004),
        ([0.003, 0.003], [0.002, 0.003], 0.023, 0.012),
    ],
    ("LoCoBot", "Proportional"): [
        ([0.017, 0.042], [0.007, 0.023], 0.031, 0.026),
        ([0.001, 0.005], [0.001, 0.004], 0.043, 0.017),
    ],
    ("LoCoBot", "Movebase"): [
        ([0.074, 0.036], [0.019, 0.033], 0.189, 0.038),
        ([0.002, 0.003], [0.0, 0.002], 0.219, 0.019),
    ],
    ("LoCoBot-Lite", "ILQR"): [
        ([0.142, 0.023], [0.008, 0.008], 0.031, 0.028),
        ([0.002, 0.002], [0.001, 0.002], 0.122, 0.03),
    ],
    ("LoCoBot-Lite", "Proportional"): [
        ([0.135, 0.043], [0.007, 0.009], 0.049, 0.009),
        ([0.002, 0.002], [0.002, 0.001], 0.054, 0.061),
    ],
    ("LoCoBot-Lite", "Movebase"): [
        ([0.192, 0.117], [0.055, 0.144], 0.128, 0.143),
        ([0.002, 0.001], [0.001, 0.001], 0.173, 0.025),
    ],
}


def moments(mean: float, variance: float, low: float = -math.inf) -> tuple[float, float]:
    """Mean and standard deviation of what `truncnorm.rvs` of the source draws."""
    sigma = math.sqrt(variance)
    if not sigma:
        return mean, 0.0
    least = max((low - mean) / sigma, -3)
    return truncnorm.mean(least, 3, mean, sigma), truncnorm.std(least, 3, mean, sigma)


@pytest.mark.parametrize(("robot", "controller"), SOURCE, ids=" ".join)
def test_moves_have_the_moments_of_the_source(robot, controller) -> None:
    noise = find_actuation(robot, controller)
    rng = random_stream(0, "moments")
    step, turn = 0.25, math.radians(15)
    for row, (ahead, angle) in zip(
        SOURCE[robot, controller], ((step, 0.0), (0.0, turn)), strict=True
    ):
        (along, across), (along2, across2), swing, swing2 = row
        drawn = np.array([sample_move(noise, ahead, angle, rng) for _ in range(3000)])
        wanted = [
            moments(along, along2, -0.95 * step if ahead else -math.inf),
            moments(across, across2),
            moments(swing, swing2, -0.95 * turn if angle else -math.inf),
        ]
        off = drawn * (1, -1, 1) - (ahead, 0, angle)
        for values, (mean, sigma) in zip(off.T, wanted, strict=True):
            assert values.mean() == pytest.approx(mean, abs=4 * sigma / math.sqrt(3000) + 1e-12)
            assert values.std() == pytest.approx(sigma, rel=0.06, abs=1e-12)
    right = np.array([sample_move(noise, 0.0, -turn, rng)[2] for _ in range(500)])
    assert (right < 0).all() and right.mean() < -turn, "a turn is overdone to its own side"


def test_a_multiplier_scales_all_of_it_and_nought_is_none() -> None:
    once = sample_move(find_actuation(), 0.25, 0.0, random_stream(1, "a"))
    twice = sample_move(find_actuation(multiplier=2.0), 0.25, 0.0, random_stream(1, "a"))
    np.testing.assert_allclose(
        np.subtract(twice, (0.25, 0, 0)), 2 * np.subtract(once, (0.25, 0, 0))
    )
    assert not Noise(actuation=find_actuation(multiplier=0.0)).moves


def test_depth_has_the_spread_and_the_holes_of_the_source() -> None:
    """habitat-sim 0586bec, redwood_depth_noise_model.py, lines 44 to 87, without its lens."""
    for z in (0.8, 2.0, 5.0):
        seen = blur_depth(np.full((200, 200), z, np.float32), 1.0, random_stream(0, "depth"))
        steps = 35.130 / seen.astype(np.float64) * 8
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)
        for k in np.unique(steps.round()):
            edges = (np.array([k - 0.5, k + 0.5]) / 8 - 35.130 / z) / 0.027778
            low, high = norm.cdf(edges)
            assert (steps.round() == k).mean() == pytest.approx(high - low, abs=0.01)
        assert len(np.unique(steps.round())) >= 2
    far = blur_depth(np.array([[10.0, 12.0], [0.0, 3.0]], np.float32).repeat(8, 0).repeat(8, 1),
                     1.0, random_stream(0, "far"))  # fmt: skip
    assert (far[:7] == 0).all() and (far[9:, :7] == 0).all() and (far[9:, 9:] > 2.8).all()
    edge = np.where(np.arange(64) < 32, 1.0, 4.0).astype(np.float32)[None].repeat(64, 0)
    jagged = blur_depth(edge, 1.0, random_stream(0, "edge"))
    assert len({tuple(row) for row in (jagged > 2).tolist()}) > 1, "edges do not jitter"


def walk(room_scene, episode, noise, actions=(1, 2, 1, 1, 3, 1)):
    sensors = {"depth", "pose", "rgb"}
    simulator = open_simulator(room_scene, "vlnce_r2r", "cpu", sensors, noise=noise)
    seen = [simulator.reset(episode)] + [simulator.step(a).observation for a in actions]
    return simulator, seen


def test_no_noise_leaves_every_byte(room_scene, make_episode) -> None:
    _, plain = walk(room_scene, make_episode(), None)
    _, none = walk(room_scene, make_episode(), Noise(actuation=find_actuation(multiplier=0.0)))
    for a, b in zip(plain, none, strict=True):
        assert a.pose == b.pose and a.rgb.tobytes() == b.rgb.tobytes()
        assert a.depth.tobytes() == b.depth.tobytes()


def test_the_same_seed_gives_the_same_noise_and_another_another(room_scene, make_episode) -> None:
    simulator, one = walk(room_scene, make_episode(), LOUD)
    _, same = walk(room_scene, make_episode(), LOUD)
    _, other = walk(room_scene, make_episode(seed=5), LOUD)
    _, plain = walk(room_scene, make_episode(), None)
    assert [o.pose for o in one] == [o.pose for o in same]
    assert all(a.depth.tobytes() == b.depth.tobytes() for a, b in zip(one, same, strict=True))
    assert not {o.pose for o in one} & {o.pose for o in other + plain}
    assert one[0].depth.tobytes() != other[0].depth.tobytes()
    assert one[-1].depth.dtype == np.float32 and not one[-1].depth.flags.writeable
    assert one[-1].depth.max() <= 10.0
    kept = simulator.save_state()
    after = [simulator.step(a).observation for a in (1, 2)]
    simulator.restore_state(kept)
    again = [simulator.step(a).observation for a in (1, 2)]
    assert [o.pose for o in after] == [o.pose for o in again], "a walk taken up again differs"


def test_odometry_drifts_and_the_simulator_knows_better(room_scene, make_episode) -> None:
    drifting = Noise(pose=PoseNoise(drift_place=0.05))
    simulator, seen = walk(room_scene, make_episode(), drifting, (2,) * 40)
    off = [math.dist(o.pose[:2], simulator.pose[:2]) for o in seen]
    assert off[0] == 0.0 and max(off[-10:]) > 0.05
    steps = np.diff(np.array([o.pose[:2] for o in seen]), axis=0)
    assert steps.std() == pytest.approx(0.05, rel=0.4), "what a step adds stays"


def test_noise_never_leads_into_a_wall(room_scene, make_episode) -> None:
    wild = Noise(actuation=find_actuation("locobot-lite", "movebase"))
    simulator = open_simulator(room_scene, noise=wild)
    simulator.reset(make_episode())
    hit = 0
    for k in range(150):
        hit += simulator.step(2 if k % 5 == 4 else 1).collided
        assert simulator.navigation.is_free(simulator.pose.x, simulator.pose.y)
    assert hit


def test_the_environments_carry_it(room_scene, make_episode) -> None:
    noise = Noise(depth=1.0, pose=PoseNoise(place=0.05, drift_heading=0.01))
    settings = {"episodes": [make_episode()], "sensors": ("depth", "pose"), "noise": noise,
                "preset": "vlnce_r2r", "backend": "cpu"}  # fmt: skip
    one, many = GoalNavEnv(room_scene, **settings), VectorEnv(2, room_scene, **settings)
    plain = GoalNavEnv(room_scene, **settings | {"noise": None})
    a, b, c = (env.reset(seed=3)[0] for env in (one, many, plain))
    for action in (1, 2, 1):
        for name in ("depth", "pose"):
            assert a[name].tobytes() == b[name][0].tobytes() != c[name].tobytes()
        assert a in one.observation_space and b in many.observation_space
        a, b, c = one.step(action)[0], many.step([action, 2])[0], plain.step(action)[0]
    with pytest.raises(ConfigError, match="move without noise"):
        VectorEnv(2, room_scene, **settings | {"noise": LOUD})


def test_bad_noise_is_refused_in_words(room_scene, make_episode) -> None:
    with pytest.raises(ConfigError, match=r"no actuation noise of 'spot' under 'ilqr'"):
        find_actuation("spot")
    for make in (
        lambda: Noise(depth=-1.0),
        lambda: PoseNoise(place=math.nan),
        lambda: Spread(variance=-1.0),
        lambda: Spread(mean=math.inf),
        lambda: find_actuation(multiplier=-2.0),
    ):
        with pytest.raises(ConfigError, match="0 or more"):
            make()
    simulator, _ = walk(room_scene, make_episode(), LOUD)
    before = simulator.pose
    for action in (Displacement(1.0, 0.0, 0.0), Teleport(2.0, 2.5, 0.0)):
        with pytest.raises(SimError, match="has no noise"):
            simulator.step(action)
    assert simulator.pose == before
    still = Spread()
    exact = ActuationNoise(forward=MoveNoise(along=still, across=still, turn=still),
                           turn=MoveNoise(along=still, across=still, turn=still))  # fmt: skip
    moved, _ = walk(room_scene, make_episode(), Noise(actuation=exact))
    plain, _ = walk(room_scene, make_episode(), None)
    np.testing.assert_allclose(moved.pose, plain.pose, atol=1e-12)
