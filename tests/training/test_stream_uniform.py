"""Samples of agents that stand anywhere."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gn0.data.field_labels import label_poses
from gn0.errors import ConfigError, FormatError
from gn0.maps.field_expert import ROUNDING
from gn0.maps.navigation import NavigationMap

torch = pytest.importorskip("torch")
uniform = pytest.importorskip("gn0.training.streams.stream_uniform")


def tell(states) -> bytes:
    names = ("episode", "pose", "last", "collided", "actions", "waypoints", "distance")
    arrays = [getattr(states, name) for name in names]
    arrays += [states.pictures[name] for name in sorted(states.pictures)]
    return b"".join(array.contiguous().numpy().tobytes() for array in arrays)


def test_states_follow_from_the_seed_and_their_number(make_env) -> None:
    """Whatever the batches; and again from a state in mid-round."""
    stream = uniform.StreamUniform(make_env(6), seed=4)
    whole = stream.draw(20)
    assert set(whole.pictures) == {"rgb", "history", "near", "far"}
    other = uniform.StreamUniform(make_env(6), seed=4, prepare=False)
    first = other.draw(5)
    state = json.loads(json.dumps(other.state()))
    assert tell(first) == tell(whole.pick(slice(0, 5)))
    rest = tell(other.draw(15))
    assert rest == tell(whole.pick(slice(5, 20)))
    other.restore(state)
    assert tell(other.draw(15)) == rest
    assert tell(uniform.StreamUniform(make_env(6), seed=5).draw(5)) != tell(first)
    for wrong in ({}, {"drawn": "1"}, {"drawn": -1}):
        with pytest.raises(FormatError):
            other.restore(wrong)


def test_labels_and_pictures_are_those_of_the_poses(make_env, rooms) -> None:
    scenes, _ = rooms
    env, twin = make_env(8), make_env(8)
    states = uniform.StreamUniform(env, seed=1).draw(8)
    agent = env.tasks.agent
    ground = {scene.id: NavigationMap(scene.grid, agent.radius) for scene in scenes}
    twin.reset(seed=9)
    seen, _ = twin.place(states.episode.numpy(), states.pose.numpy())
    assert (seen["rgb"].numpy() == states.pictures["rgb"].numpy()).all()
    assert (seen["ego_map"].numpy()[:, :, :24] == states.pictures["near"].numpy()).all()
    assert not states.pictures["history"].any()
    for k, number in enumerate(states.episode.tolist()):
        episode = env.episodes[number]
        field = ground[episode.scene_id].geodesic(episode.destination)
        wanted = label_poses(field, states.pose[k : k + 1].numpy(), agent, 1.0 - ROUNDING)
        assert wanted.actions[0].tolist() == states.actions[k].tolist()
        assert wanted.waypoints[0].tobytes() == states.waypoints[k].numpy().tobytes()
        assert wanted.distance[0] == states.distance[k].item()


def test_half_of_them_look_where_to_go_and_some_stand_near_the_goal(make_env) -> None:
    """With uniform headings one in twelve goes FORWARD; the issue asks for 55 % beside those."""
    env = make_env(300, ("ego_map",))
    plain = uniform.StreamUniform(env, seed=0, facing=0.0, near=(0.0, 1.0)).draw(600)
    ways = plain.waypoints[:, 1]
    away = torch.atan2(ways[:, 1], ways[:, 0]).abs()
    assert 0.02 < (away < 0.4).float().mean() < 0.25
    assert 0.02 < (plain.actions[:, 0] == 1).float().mean() < 0.2
    found = uniform.StreamUniform(env, seed=0, near=(0.0, 1.0)).draw(600)
    ways = found.waypoints[:, 1]
    away = torch.atan2(ways[:, 1], ways[:, 0]).abs()
    there = (ways.square().sum(1) == 0).float().mean()
    assert abs((away < 0.4).float().mean() - there - 0.55 - 0.45 / 8) < 0.08  # 15° and a half
    assert (found.actions[:, 0] == 1).float().mean() > 0.2
    near = uniform.StreamUniform(env, seed=0, near=(1.0, 1.5)).draw(300)
    assert (near.distance < 1.6).all() and (near.distance > 1.0).any()
    some = uniform.StreamUniform(env, seed=0, near=(0.5, 1.5)).draw(600)
    share = (some.distance < 1.55).float().mean() - (plain.distance < 1.55).float().mean()
    assert abs(share - 0.5 * (1 - (plain.distance < 1.55).float().mean())) < 0.08


def test_wrong_settings_are_refused(make_env) -> None:
    env = make_env(2, ("ego_map",))
    for wrong in ({"facing": 1.1}, {"near": (-1, 3)}, {"near": (0.1, 0)}):
        with pytest.raises(ConfigError, match="facing"):
            uniform.StreamUniform(env, seed=0, **wrong)
    with pytest.raises(ConfigError, match="squares"):
        uniform.StreamUniform(env, seed=0, names=("near", "near"))
    assert np.isfinite(uniform.StreamUniform(env, seed=0).draw(2).pose.numpy()).all()
