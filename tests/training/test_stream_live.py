"""Samples of agents that walk while they are drawn, and that they go on where they were left."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, astuple

import numpy as np
import pytest

from gn0.data.build import build_dataset
from gn0.data.episode_frames import read_frames
from gn0.data.field_labels import label_poses
from gn0.data.settings import BuildSettings, LabelSettings, PictureSettings
from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, FormatError, SimError
from gn0.maps.field_expert import ROUNDING
from gn0.maps.navigation import NavigationMap
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.ego_map import read_map_view

torch = pytest.importorskip("torch")
live = pytest.importorskip("gn0.training.streams.stream_live")
from gn0.training.streams.live_counts import LiveCounts, share_counts  # noqa: E402 (needs torch)
from gn0.training.streams.step_ring import StepRing  # noqa: E402

FIELDS = ("episode", "pose", "last", "collided", "actions", "waypoints", "distance")


def tell(states) -> bytes:
    """All bytes of states."""
    arrays = [getattr(states, name) for name in FIELDS]
    arrays += [states.pictures[name] for name in sorted(states.pictures)]
    return b"".join(array.contiguous().numpy().tobytes() for array in arrays)


def wander(states):
    """A policy that goes by what it sees: the same pictures, the same actions."""
    sums = states.pictures["near"].flatten(1).sum(1) + states.pictures["history"].flatten(1).sum(1)
    return torch.stack([(sums + k) % 4 for k in (0, 1, 1)], 1)


SETTINGS = {
    "expert": {},
    "policy": {"driver": wander},
    "mixture": {"driver": wander, "beta": lambda drawn: 0.9 - drawn / 100, "stop_share": 0.0},
}


@pytest.mark.parametrize(
    "who",
    [pytest.param(who, marks=() if who == "mixture" else pytest.mark.slow) for who in SETTINGS],
)
def test_a_stream_goes_on_where_it_was_left(make_env, who: str) -> None:
    """Round the ring, in mid-plan, whoever drives: batch for batch the same bytes."""
    settings = {"seed": 3, "ratio": 1.0, "fill": 5, **SETTINGS[who]}

    def make():
        env = make_env(2)
        return live.StreamLive(env, StepRing(env, 18), **settings)

    stream, told, states = make(), [], {}
    for batch in range(13):
        if batch in ((10,) if who == "mixture" else (1, 10)):
            states[batch] = json.loads(json.dumps(stream.state()))
        told.append(tell(stream.draw(7)))
    assert stream.ring.count > 36
    other = make()
    other.draw(9)
    for batch, state in states.items():
        other.restore(state)
        assert other.state() == state
        for k in range(batch, batch + 3):
            assert tell(other.draw(7)) == told[k], (batch, k)
    assert len(set(told)) == 13


def test_labels_are_those_of_the_poses_and_stop_a_metre_away(make_env, rooms) -> None:
    scenes, _ = rooms
    env = make_env(3)
    stream = live.StreamLive(env, StepRing(env, 40), seed=1, fill=30)
    states = stream.draw(60)
    agent = env.tasks.agent
    ground = {scene.id: NavigationMap(scene.grid, agent.radius) for scene in scenes}
    for k, number in enumerate(states.episode.tolist()):
        episode = env.episodes[number]
        assert stream.texts[number] == episode.mission.instruction
        field = ground[episode.scene_id].geodesic(episode.destination)
        wanted = label_poses(field, states.pose[k : k + 1].numpy(), agent, 1.0 - ROUNDING)
        assert wanted.actions[0].tolist() == states.actions[k].tolist()
        assert wanted.waypoints[0].tobytes() == states.waypoints[k].numpy().tobytes()
        assert wanted.distance[0] == states.distance[k].item()
    stops = states.actions[:, 0] == 0
    assert (states.distance[stops] <= 1.0).all()


def test_experts_arrive_and_are_counted(make_env) -> None:
    env = make_env(4, ("ego_map",))
    stream = live.StreamLive(env, StepRing(env, 100), seed=0, fill=100, dark=0.0)
    states = stream.draw(200)
    assert set(states.pictures) == {"near", "far"}
    counts = stream.tell()
    assert counts.steps == 4 * stream.ring.count
    assert counts.ended == counts.arrived > 3
    assert counts.cut_short == counts.asked == 0 < counts.forwards
    assert stream.tell().steps == 0


def test_samples_are_uniform_over_what_the_ring_holds(make_env) -> None:
    env = make_env(4, ("ego_map",))
    ring = StepRing(env, 16)
    stream = live.StreamLive(env, ring, seed=0, ratio=0.01, fill=16)
    asked: list[int] = []
    ring.draw, plain = (lambda rows, dark: (asked.extend(rows), plain(rows, dark))[1]), ring.draw
    for _ in range(40):
        stream.draw(16)
    counts = np.bincount(np.array(asked) % 64, minlength=64)
    assert counts.sum() == 640 and ((counts - 10) ** 2 / 10).sum() < 110


def test_a_tenth_of_the_mosaics_is_black(make_env) -> None:
    env = make_env(3)
    stream = live.StreamLive(env, StepRing(env, 60), seed=2, ratio=0.01, fill=40)
    pasts = [stream.draw(100) for _ in range(4)]
    walked = torch.cat([one.last >= 0 for one in pasts])
    black = torch.cat([(one.pictures["history"] == 0).flatten(1).all(1) for one in pasts])
    share = black[walked].float().mean().item()
    assert 0.05 < share < 0.16
    assert black[~walked].all()


def test_wrong_stops_end_episodes_only_by_chance(make_env) -> None:
    """A policy that always stops: never, or always, or one time in five."""

    def ends(share: float) -> tuple[int, int]:
        env = make_env(4, ("ego_map",), max_steps=500)
        stops = lambda states: torch.zeros(len(states), dtype=torch.long)  # noqa: E731
        stream = live.StreamLive(
            env, StepRing(env, 8), seed=0, driver=stops, stop_share=share, fill=25
        )
        stream.draw(1)
        counts = stream.tell()
        assert counts.asked == counts.steps == 100
        return counts.ended, counts.arrived

    ended, arrived = ends(0.0)
    assert ended == arrived  # the expert's STOPs alone
    ended, _ = ends(1.0)
    assert ended == 100
    ended, arrived = ends(0.2)
    assert 8 < ended - arrived < 35


def test_agents_that_begin_in_mid_plan_follow_the_expert(make_env) -> None:
    """The policy is asked every third step, of all agents."""
    env = make_env(3, ("ego_map",), max_steps=7)
    asked: list[int] = []
    stream = live.StreamLive(env, StepRing(env, 40), seed=0, fill=20,
        driver=lambda states: (asked.append(stream.ring.count),
                               torch.full((3, 3), 2))[1])  # fmt: skip
    stream.draw(1)
    assert asked == list(range(1, 21, 3))
    kept = {name: stream.ring[name] for name in ("step", "last", "actions")}
    turns = 0
    for step in range(1, 20):
        for agent in range(3):
            since = (step - 1) % 3  # decisions are made at 0, 3, 6 …
            if kept["step"][step, agent] > since:
                assert kept["last"][step, agent] == 2
                turns += 1
            elif kept["step"][step, agent] and kept["step"][step, agent] <= since:
                assert kept["last"][step, agent] == kept["actions"][step - 1, agent, 0]
    assert turns > 20


def test_a_stop_of_steps_ago_is_asked_again(make_env) -> None:
    """The answer is LEFT, STOP, STOP, and RIGHT when it is asked again."""
    settings = {"seed": 0, "fill": 9, "stop_share": 1.0}

    def open_live(confirmed: int | None) -> tuple[live.StreamLive, list[int]]:
        env, asked = make_env(4, ("ego_map",), max_steps=500), []
        first = lambda states: torch.tensor([[2, 0, 0]]).repeat(len(states), 1)  # noqa: E731

        def again(states):
            asked.append(len(states))
            return torch.tensor([[3, 3, 2]]).repeat(len(states), 1)

        ring = StepRing(env, 20)
        return live.StreamLive(env, ring, driver=first, confirm=again, confirmed=confirmed,
                               **settings), asked  # fmt: skip

    stream, asked = open_live(4)
    stream.draw(1)
    assert asked == [4] * 6  # at each step but the first of an answer: the host does not look
    assert stream._log[:9].tolist() == [[code] * 4 for code in (2, 3, 3) * 3]
    assert stream.tell().ended == 0
    stream, asked = open_live(1)
    stream.draw(1)
    assert set(asked) == {1}
    expert = stream.ring["actions"][:9, :, 0]
    log = stream._log[:9].to(torch.int8)
    for step in range(9):  # one at a time is asked again, the others follow the expert
        mine = [code for code in log[step].tolist() if code == (2, 3, 3)[step % 3]]
        assert len(mine) >= 1
    assert torch.equal(log[1, 1:], expert[1, 1:])


def test_inputs_drive_as_often_as_their_shares_say(make_env) -> None:
    """One for all agents from decision to decision; the same one is asked again about its STOPs."""
    asked: list[tuple[int, str, int]] = []

    def open_live() -> live.StreamLive:
        env = make_env(4)
        ring = StepRing(env, 20)

        def drive(name: str, again: bool):
            def driver(states):
                asked.append((ring.count, f"{name} again" if again else name, len(states)))
                plan = torch.full((len(states), 2), 1)
                plan[:, 1] = 2 if again else 0
                return plan

            return driver

        shares = {"all": 0.5, "views": 0.3, "maps": 0.2}
        return live.StreamLive(
            env, ring, seed=3, inputs=shares, stop_share=0.0,
            driver={name: drive(name, False) for name in shares},
            confirm={name: drive(name, True) for name in shares}, confirmed=2,
        )  # fmt: skip

    stream = open_live()
    stream.draw(600)
    decided = {step: name for step, name, many in asked if many == 4}
    again = {step: name for step, name, many in asked if many == 2}
    assert len(decided) == 48  # of 95 steps: 20 that fill the ring, 75 for 600 samples
    assert again == {step + 1: f"{name} again" for step, name in decided.items() if step < 95}
    counts = Counter(decided.values())
    for name, share in (("all", 0.5), ("views", 0.3), ("maps", 0.2)):
        spread = (share * (1 - share) / len(decided)) ** 0.5
        assert abs(counts[name] / len(decided) - share) < 3 * spread
    kept = stream.state()
    asked.clear()
    expected = [tell(stream.draw(8)) for _ in range(6)]
    theirs = list(asked)
    other = open_live()
    other.restore(kept)
    asked.clear()
    assert [tell(other.draw(8)) for _ in range(6)] == expected
    assert asked == theirs


def test_stops_of_the_policy_are_held_against_the_experts(make_env) -> None:
    """A policy that always stops finds all that are due; its precision is their share."""
    env = make_env(4, ("ego_map",), max_steps=500)
    stops = lambda states: torch.zeros(len(states), dtype=torch.long)  # noqa: E731
    stream = live.StreamLive(env, StepRing(env, 40), seed=0, driver=stops, stop_share=0.0, fill=40)
    stream.draw(1)
    due = int((stream.ring["actions"][:40, :, 0] == 0).sum())
    counts = stream.tell(reset=False)
    assert counts.due == counts.stopped_right == counts.agreed == due > 0
    assert counts.stopped == counts.asked == 160
    shares = share_counts(asdict(counts))
    assert shares["walks_stop_recall"] == 1 and shares["walks_stop_precision"] == due / 160
    assert shares["driven"] == 1 and shares["agreement"] == due / 160
    assert counts + counts == LiveCounts(*(2 * one for one in astuple(counts)))
    other = live.StreamLive(env, StepRing(env, 40), seed=0, driver=stops, stop_share=0.0, fill=40)
    other.restore(json.loads(json.dumps(stream.state())))
    assert other.tell() == counts  # and the counts go on, too


def test_what_does_not_fit_is_refused(make_env) -> None:
    env, other = make_env(2, ("ego_map",)), make_env(2, ("ego_map",))
    with pytest.raises(ConfigError, match="in use"):
        live.StreamLive(env, StepRing(other, 20), seed=0)
    for wrong in ({"ratio": 0}, {"fill": 0}, {"stop_share": 1.5}, {"dark": -0.1}):
        with pytest.raises(ConfigError, match="ratio"):
            live.StreamLive(env, StepRing(env, 20), seed=0, **wrong)
    stream = live.StreamLive(env, StepRing(env, 20), seed=0, fill=3,
                             driver=lambda states: torch.zeros(5))  # fmt: skip
    with pytest.raises(SimError, match="policy gave actions"):
        stream.draw(1)
    state = live.StreamLive(other, StepRing(other, 20), seed=0, fill=3).state()
    with pytest.raises(ConfigError, match="stream of 2 agents and 20 steps"):
        live.StreamLive(env, StepRing(env, 21), seed=0).restore(state)
    with pytest.raises(FormatError, match="not a live stream"):
        stream.restore(state | {"actions": "none"})


def test_actions_are_packed_without_loss() -> None:
    actions = np.random.default_rng(0).integers(0, 4, (7, 5)).astype(np.uint8)
    packed = live.pack_actions(actions)
    assert packed.nbytes == 9
    again = live.unpack_array(live.pack_array(packed, np.uint8), np.uint8, None)
    assert (live.unpack_actions(again, (7, 5)) == actions).all()


def test_live_samples_are_a_datasets_of_the_same_states(
    flats_suite, own_cache, monkeypatch, tmp_path
):
    """Labels, distances and ego maps, to the bit; maps without colours, which renderers round."""
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    labels = LabelSettings(variant="field")
    pictures = PictureSettings(layout="none")
    dataset = build_dataset(
        flats_suite, tmp_path / "data", BuildSettings(labels=labels, pictures=pictures)
    )
    squares = [{"size": 20, "metres_per_pixel": scale, "content": "occupancy"}
               for scale in (0.1, 0.27)]  # fmt: skip
    view = read_map_view({"squares": squares})
    env = VectorEnvDevice(12, suite=flats_suite.folder, device=DeviceHost(2), map_view=view,
                          sensors=("ego_map",))  # fmt: skip
    stream = live.StreamLive(env, StepRing(env, 70), seed=0, fill=1,
                             stop_distance=labels.stop_distance)  # fmt: skip
    env.reset(options={"episode": list(range(12))})
    for _ in range(60):
        stream.step()
    states = stream.ring.draw(np.arange(*stream.ring.window))
    at = {(n, p.tobytes()): k for k, (n, p) in enumerate(
        zip(states.episode.tolist(), states.pose.numpy(), strict=True))}  # fmt: skip
    compared = 0
    for number, episode in enumerate(env.episodes):
        rows = dataset.rows(episode.id)
        frames = read_frames(dataset, episode.id, ("ego_map",), map_view=view)
        for t, (pose, frame) in enumerate(zip(rows.poses, frames, strict=True)):
            k = at.get((number, np.asarray(pose, np.float64).tobytes()))
            if k is None:  # it was walked for longer than we looked
                assert t > 40
                continue
            assert states.actions[k].tolist() == rows.actions[t].tolist()
            assert states.waypoints[k].numpy().tobytes() == rows.waypoints[t].tobytes()
            assert states.distance[k].item() == rows.distance[t]
            for name, square in zip(("near", "far"), view.split(frame["ego_map"]), strict=True):
                np.testing.assert_array_equal(states.pictures[name][k].numpy(), square)
            compared += 1
    assert compared > 150
