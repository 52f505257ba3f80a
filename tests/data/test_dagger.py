"""DAgger: who acts, what is written beside it, when an episode ends, and crash-safety."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.cli.main import main
from gn0.data.collect import build_dagger, describe_summary, sum_up
from gn0.data.dagger import collect_visited
from gn0.data.dataset import Dataset, open_dataset
from gn0.data.expert_labels import LabelSettings, label_states, walk_actions
from gn0.data.sample_table import EpisodeRows
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
from gn0.errors import ConfigError, DataError, PlanError, PolicyError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, MissionFollow
from gn0.paper import HALT_STEPS
from gn0.policies.oracle import PolicyOracle
from gn0.policies.simple import PolicyRandom, PolicyStraight
from gn0.scenes.example import build_example_scene
from gn0.sim.policy import Policy
from gn0.sim.rollout import run_episode
from gn0.sim.sensors import SensorConfig
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action
from gn0.suites.suite import Suite

EXACT = LabelSettings()
DRIVE: dict[str, object] = {"policy": "straight", "halting": "none", "max_steps": 60}


PLUGIN = Path(__file__).parent / "plugin"
sys.path.insert(0, str(PLUGIN))
PolicyScript = import_module("dagger_policies").PolicyScript
PolicyGlides = import_module("dagger_policies").PolicyGlides


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    scene = build_example_scene()
    config = SensorConfig(active=frozenset({"goal_vector"}))
    return Simulator(scene, navigation=NavigationMap(scene.grid, 0.2), sensors=config, max_steps=60)


@pytest.fixture
def episode(data_suite: Suite) -> Episode:
    return data_suite.episodes[0]


def collect(
    simulator: Simulator, policy: Policy, episode: Episode, rules: LabelSettings = EXACT, **other
) -> EpisodeRows:
    asked = DaggerSettings(**{**DRIVE, **other})
    return collect_visited(simulator, policy, episode, asked, rules)


def straight_line(episode: Episode, length: float) -> Episode:
    """The episode from a start that looks at its goal over free ground, so far away [m]."""
    x, y = episode.goal
    navigation = NavigationMap(build_example_scene().grid, 0.2)
    for yaw in np.arange(0, 6.28, 0.05):
        a, b = x - length * np.cos(yaw), y - length * np.sin(yaw)
        if navigation.is_free(a, b) and not navigation.move(a, b, x, y)[2]:
            return msgspec.structs.replace(episode, start=(float(a), float(b), float(yaw)))
    raise AssertionError("no free line")


# ------------------------------------------------------------------------------- who acts


@pytest.mark.parametrize("policy", [PolicyStraight(), PolicyRandom()])
def test_with_beta_0_the_policy_goes_its_own_way(
    simulator: Simulator, data_suite: Suite, policy: Policy
) -> None:
    """And every state of its trajectory is labelled as the expert labels it on its own."""
    for episode in data_suite.episodes[:3]:
        rows = collect(simulator, policy, episode, beta=0.0)
        run = run_episode(simulator, policy, episode)
        assert rows.executed.tolist() == list(run.actions)
        assert rows.policy_actions == tuple((code,) for code in run.actions)
        np.testing.assert_array_equal(rows.poses, np.array(run.poses)[:-1])
        assert rows.collided.tolist() == list(run.collided)
        assert rows.source == "dagger"
        labels = label_states(simulator.navigation, episode, rows.poses)
        np.testing.assert_array_equal(rows.waypoints, labels.waypoints)
        np.testing.assert_array_equal(rows.valid, labels.valid)
        same = (rows.actions == labels.actions6).all(axis=1)
        assert same.mean() > 0.9  # a plan that is followed is kept, and may be another of equals


def test_with_beta_1_the_expert_walks_and_the_policy_is_still_asked(
    simulator: Simulator, data_suite: Suite
) -> None:
    for episode in data_suite.episodes[:3]:
        rows = collect(simulator, PolicyScript("3" * 99), episode, beta=1.0)
        assert rows.executed.tolist() == rows.actions[:, 0].tolist()
        assert rows.executed[-1] == Action.STOP and rows.distance[-1] <= 0.25
        assert set(rows.policy_actions) == {(3,)}
        assert not rows.collided.any()


def test_with_beta_between_the_draw_is_made_anew_at_every_step(
    simulator: Simulator, data_suite: Suite
) -> None:
    mixed = total = 0
    for episode in data_suite.episodes:
        rows = collect(simulator, PolicyScript("3" * 99), episode, beta=0.7)
        expert = rows.executed == rows.actions[:, 0]
        policy = rows.executed == 3
        assert (expert | policy).all()
        mixed += int((expert & ~policy).sum())
        total += int((rows.actions[:, 0] != 3).sum())
    assert 0.55 < mixed / total < 0.85
    again = collect(simulator, PolicyScript("3" * 99), data_suite.episodes[-1], beta=0.7)
    assert again.executed.tobytes() == rows.executed.tobytes()
    other = collect(simulator, PolicyScript("3" * 99), data_suite.episodes[-1], beta=0.7, seed=1)
    assert other.executed.tobytes() != rows.executed.tobytes()


def test_beta_changes_with_the_iteration_as_asked() -> None:
    def shares(schedule: str) -> list[float]:
        return [
            DaggerSettings(policy="p", beta=0.5, schedule=schedule, iteration=i).expert_share  # type: ignore[arg-type]
            for i in (1, 2, 3)
        ]

    assert shares("constant") == [0.5, 0.5, 0.5]
    assert shares("power") == [1.0, 0.5, 0.25]
    assert shares("first") == [1.0, 0.0, 0.0]


# -------------------------------------------------------------------- what the labels lead to


@pytest.mark.parametrize("variant", ["exact", "mpc", "field"])
def test_the_labels_of_visited_states_lead_to_the_goal(
    simulator: Simulator, data_suite: Suite, variant: str
) -> None:
    rules = LabelSettings(variant=variant)  # type: ignore[arg-type]
    navigation = simulator.navigation
    for episode in data_suite.episodes[:2]:
        rows = collect(simulator, PolicyRandom(), episode, rules, beta=0.3)
        for row in range(0, len(rows), 25):
            state, ahead = rows.poses[row], rows.actions[row]
            for _ in range(60):
                stops = np.flatnonzero(ahead == 0)
                walked = ahead[: stops[0]] if len(stops) else ahead
                poses, cut = walk_actions(navigation, episode.agent, state, walked)
                assert not cut.any()
                state = poses[-1]
                if len(stops):
                    break
                ahead = label_states(navigation, episode, state[None], rules).actions6[0]
            assert len(stops)
            assert navigation.geodesic(episode.goal).distance_at(*state[:2]) <= 0.25


# ------------------------------------------------------------------------------ halting


def test_after_ten_steps_near_the_goal_the_episode_is_cut_and_labelled_stop(
    simulator: Simulator, episode: Episode
) -> None:
    """Paper, Eq. halting: the agent turns on the spot within the success distance."""
    near = straight_line(episode, 1.5)
    rows = collect(
        simulator, PolicyScript("2" * 99), near, beta=0.0, halting="paper", success_radius=2.0
    )
    assert len(rows) == HALT_STEPS + 1  # ten additional steps, then the terminal state
    assert rows.actions[-1].tolist() == [0] * 6 and rows.executed[-1] == Action.STOP
    assert (rows.actions[:-1, 0] != 0).all()
    assert rows.policy_actions[-1] == (2,)  # what the policy would have said is kept


def test_the_counter_starts_when_the_agent_comes_near_and_again_when_it_comes_back(
    simulator: Simulator, episode: Episode
) -> None:
    near = straight_line(episode, 1.2)
    away = "2" * 12 + "1" * 3 + "2" * 99  # half a turn, out of 1.4 m, then on the spot
    rows = collect(
        simulator, PolicyScript(away), near, beta=0.0, halting="paper", success_radius=1.4
    )
    assert len(rows) == HALT_STEPS + 1
    rows = collect(
        simulator, PolicyScript("1" + "2" * 99), near, beta=0.0, halting="paper",
        success_radius=1.1,
    )  # fmt: skip
    inside = rows.distance <= 1.1
    first = int(np.argmax(inside))
    assert first == 1 and inside[first:].all()
    assert len(rows) == first + HALT_STEPS + 1
    none = collect(simulator, PolicyScript("2" * 99), near, beta=0.0, halting="none")
    assert len(none) == 60 and (none.actions[:, 0] != 0).all()


def test_the_release_gives_ten_steps_after_leaving_the_zone(
    simulator: Simulator, episode: Episode
) -> None:
    """The zone of a short path is 1 m; after the exit labels end with STOP where they enter it."""
    start = straight_line(episode, 0.9)
    release = LabelSettings(variant="gn0-release")
    script = "2" * 12 + "1" * 2 + "2" * 99
    rows = collect(simulator, PolicyScript(script), start, release, beta=0.0, halting="gn0-release")
    away = np.hypot(*(rows.poses[:, :2] - episode.goal).T)
    left = int(np.argmax(away > 1.0))
    assert left > 0 and (away[:left] <= 1.0).all()
    assert not rows.actions[:left].any()  # inside 1 m: six STOPs
    assert len(rows) == left + HALT_STEPS + 1
    assert rows.executed[-1] == Action.STOP
    late = [codes for codes in rows.actions[left:].tolist() if 1 in codes and 0 in codes]
    for codes in late:
        assert not any(codes[codes.index(0) :])


# ----------------------------------------------------------------------------- refusals


def test_what_cannot_be_labelled_is_refused(simulator: Simulator, episode: Episode) -> None:
    with pytest.raises(PolicyError, match="displacement"):
        collect(simulator, PolicyGlides(), episode)
    follow = msgspec.structs.replace(
        episode, mission=MissionFollow(goal=episode.goal, instruction="Follow.", human="a")
    )
    with pytest.raises(PlanError, match="whom to follow"):
        collect(simulator, PolicyScript(), follow)
    blind = PolicyScript()
    blind.sensors = frozenset({"rgb"})
    with pytest.raises(PolicyError, match="rgb"):
        collect(simulator, blind, episode)


# ------------------------------------------------------------------------------ datasets


def settings_of(**other: object) -> BuildSettings:
    return BuildSettings(
        chunk=2,
        pictures=PictureSettings(layout="none"),
        dagger=DaggerSettings(**{**DRIVE, **other}),
    )


@pytest.fixture(scope="module")
def driven(data_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """A collection in one process."""
    return build_dagger(data_suite, tmp_path_factory.mktemp("d") / "data", settings_of(beta=0.4))


def test_a_collection_is_a_dataset_like_any_other(driven: Dataset, data_suite: Suite) -> None:
    dataset = open_dataset(driven.folder)
    assert dataset.about.rows == sum(len(dataset.rows(e.id)) for e in data_suite.episodes)
    for episode in data_suite.episodes:
        rows = dataset.rows(episode.id)
        assert rows.source == "dagger" and len(rows.policy_actions) == len(rows)
        assert (rows.pixels >= 0).all()
        rollout = dataset.rollout(episode.id)
        assert len(rollout.poses) == len(rows) + 1


def test_the_sum_counts_what_is_in_it(driven: Dataset, data_suite: Suite) -> None:
    found = sum_up(driven)
    rows = [driven.rows(episode.id) for episode in data_suite.episodes]
    said = np.concatenate([[codes[0] for codes in block.policy_actions] for block in rows])
    label = np.concatenate([block.actions[:, 0] for block in rows])
    assert (found.episodes, found.skipped) == (6, 0)
    assert found.states == len(label) and found.agreed == int((said == label).sum())
    assert found.collided == sum(int(block.collided.sum()) for block in rows)
    assert f"{found.states:,} states" in describe_summary(found)


def test_two_workers_write_the_same_bytes_as_one(
    driven: Dataset,
    data_suite: Suite,
    tmp_path: Path,
    files_of: Callable[[Path], dict[str, bytes]],
) -> None:
    build_dagger(data_suite, tmp_path / "two", settings_of(beta=0.4), workers=2)
    assert files_of(tmp_path / "two") == files_of(driven.folder)


@pytest.mark.parametrize("variant", ["exact", "mpc", "gn0-release", "field"])
def test_any_number_of_agents_writes_the_same_bytes(
    data_suite: Suite,
    tmp_path: Path,
    files_of: Callable[[Path], dict[str, bytes]],
    variant: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What cannot be driven is skipped in both, in the same order."""
    found = Dataset.episode
    lost = data_suite.episodes[1]
    follow = MissionFollow(goal=lost.goal, instruction="Follow me.", human="somebody")
    lost = msgspec.structs.replace(lost, mission=follow)
    monkeypatch.setattr(
        Dataset, "episode", lambda self, name: lost if name == lost.id else found(self, name)
    )
    halting = "gn0-release" if variant == "gn0-release" else "paper"
    settings = BuildSettings(
        chunk=4,
        labels=LabelSettings(variant=variant),  # type: ignore[arg-type]
        pictures=PictureSettings(layout="none"),
        dagger=DaggerSettings(**{**DRIVE, "halting": halting, "beta": 0.3}),
    )
    build_dagger(data_suite, tmp_path / "1", settings)
    want = files_of(tmp_path / "1")
    for agents in (2, 16):
        build_dagger(data_suite, tmp_path / str(agents), settings, agents=agents)
        assert files_of(tmp_path / str(agents)) == want
    assert [s.id for p in open_dataset(tmp_path / "2").about.parts for s in p.skipped] == [lost.id]


_CHILD = """
import sys
from gn0.suites.suite import load_suite
from gn0.data.collect import build_dagger
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
settings = BuildSettings(chunk=2, pictures=PictureSettings(layout="none"), dagger=DaggerSettings(
    policy="straight", halting="none", max_steps=60, beta=0.4))
build_dagger(load_suite(sys.argv[1]), sys.argv[2], settings)
"""


def test_a_collection_that_is_killed_goes_on_to_the_same_bytes(
    driven: Dataset,
    data_suite: Suite,
    tmp_path: Path,
    files_of: Callable[[Path], dict[str, bytes]],
) -> None:
    out = tmp_path / "broken"
    process = subprocess.Popen([sys.executable, "-c", _CHILD, str(data_suite.folder), str(out)])
    until = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < until:
        journal = out / "journal.jsonl"
        if journal.exists() and journal.stat().st_size:
            os.kill(process.pid, signal.SIGKILL)
            break
        time.sleep(0.001)
    process.wait()
    build_dagger(data_suite, out, settings_of(beta=0.4))
    assert files_of(out) == files_of(driven.folder)


def test_another_collection_is_not_mixed_in(driven: Dataset, data_suite: Suite) -> None:
    with pytest.raises(DataError, match="another dataset"):
        build_dagger(data_suite, driven.folder, settings_of(beta=0.5))


def test_settings_that_make_no_collection_are_refused(data_suite: Suite, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no policy"):
        build_dagger(data_suite, tmp_path / "a", BuildSettings())
    with pytest.raises(ConfigError, match="nobody"):
        build_dagger(data_suite, tmp_path / "b", settings_of(policy="nobody"))
    with pytest.raises(ConfigError, match=r"dataset\.json"):
        build_dagger(data_suite, tmp_path / "c", settings_of(options={"api_key": "x"}))
    with pytest.raises(ConfigError, match="no_such_module"):
        build_dagger(data_suite, tmp_path / "e", settings_of(plugins=("no_such_module",)))
    with pytest.raises(ConfigError, match="options"):
        build_dagger(data_suite, tmp_path / "d", settings_of(options={"speed": 3}))


def test_a_policy_that_misbehaves_ends_the_collection_with_its_name(
    data_suite: Suite, tmp_path: Path
) -> None:
    for name, options, word in (
        ("glides", {}, "displacement"),
        ("script", {"actions": "x"}, "cannot be built: ValueError"),
        ("script", {"actions": "9"}, "act failed: ValueError"),
    ):
        asked = settings_of(policy=name, options=options, plugins=("dagger_policies",))
        with pytest.raises(PolicyError, match=f"'{name}'.*{word}"):
            build_dagger(data_suite, tmp_path / name / str(options), asked)


def test_the_command_collects_and_sums_up(
    data_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["data", "dagger", str(data_suite.folder), "--policy", "script", "--out"]
    assert main([*command, str(out), "--policy-option", 'actions="22"', "--beta", "0.9"]) == 0
    said = capsys.readouterr().out
    assert "states of 6 episodes" in said and "gn0 data balance" in said
    about = open_dataset(out).about.settings
    assert about.dagger is not None and about.dagger.success_radius == 3.0
    assert about.labels.variant == "exact" and about.dagger.max_steps == 60
    release = [*command, str(tmp_path / "rel"), "--halting", "gn0-release", "--beta", "1"]
    assert main(release) == 0
    assert open_dataset(tmp_path / "rel").about.settings.labels.variant == "gn0-release"
    assert main([*command, str(out)]) == 2  # another beta: another collection
    assert "another dataset" in capsys.readouterr().err


def test_the_oracle_agrees_with_the_expert(simulator: Simulator, data_suite: Suite) -> None:
    agreed = states = 0
    for episode in data_suite.episodes:
        rows = collect(simulator, PolicyOracle(), episode, beta=0.0)
        assert rows.executed[-1] == Action.STOP and rows.distance[-1] <= 0.25
        agreed += int((rows.executed == rows.actions[:, 0]).sum())
        states += len(rows)
    assert agreed / states > 0.95
