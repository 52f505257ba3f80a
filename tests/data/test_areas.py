"""How far labels of a dataset lead into rooms that are goals."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.cli.main import main
from gn0.data.build import build_dataset
from gn0.data.dataset import Dataset, open_dataset
from gn0.data.expert_labels import LabelSettings
from gn0.data.sample_table import decode_rows, load_sample_table
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
from gn0.data.verify import verify_dataset
from gn0.errors import ConfigError
from gn0.maps.goal_places import GoalSetInner
from gn0.missions.episode import Episode
from gn0.scenes.folder import load_scene
from gn0.scenes.scene import Scene
from gn0.suites.suite import Suite, save_suite
from gn0.testing.scenes import with_goal_sets

DEPTH = 0.5  # m, of squares of 1.4 m
OF_BUILD = ["--layout", "none", "--chunk", "3"]


def scene_of(suite: Suite) -> Scene:
    return load_scene(suite.scene_folder(suite.episodes[0].scene_id))


@pytest.fixture(scope="module")
def rooms(data_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """The six episodes, of which two end in a square of ground and two at either of two places."""
    scene = scene_of(data_suite)
    episodes = with_goal_sets(list(data_suite.episodes))
    return save_suite(
        tmp_path_factory.mktemp("rooms") / "suite", [scene], episodes,
        name="walks", camera="tiny_128", max_steps=60,
    )  # fmt: skip


def build(rooms: Suite, out: Path, **labels: object) -> Dataset:
    settings = BuildSettings(
        labels=LabelSettings(**labels),  # type: ignore[arg-type]
        chunk=3,
        pictures=PictureSettings(layout="none"),
    )
    return build_dataset(rooms, out, settings)


def ends_of(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """Where the expert says STOP, of each episode."""
    found = {}
    for part in dataset.about.parts:
        for rows in decode_rows(load_sample_table(dataset.folder / part.path)):
            assert rows.executed[-1] == 0 and rows.actions[-1, 0] == 0
            found[rows.episode_id] = (float(rows.poses[-1, 0]), float(rows.poses[-1, 1]))
    return found


def from_rim(episode: Episode, at: tuple[float, float]) -> float:
    """How far within its square of ground a place is [m]."""
    assert episode.goal_set is not None
    corners = np.array(episode.goal_set.areas[0])
    return float(np.minimum(np.array(at) - corners.min(0), corners.max(0) - np.array(at)).min())


@pytest.mark.parametrize("variant", ["exact", "field", "gn0-release", "mpc"])
def test_labels_stop_as_deep_in_an_area_as_they_are_told_to(
    rooms: Suite, tmp_path: Path, variant: str
) -> None:
    """Nothing changes where the goal is no area, nor in any file where nothing is asked for."""
    plain = build(rooms, tmp_path / "plain", variant=variant)
    deep = build(rooms, tmp_path / "deep", variant=variant, inside=DEPTH)
    assert b"inside" not in (plain.folder / "dataset.json").read_bytes()
    assert open_dataset(deep.folder).about.settings.labels.depth == DEPTH
    before, after = ends_of(plain), ends_of(deep)
    episodes = {episode.id: episode for episode in rooms.episodes}
    assert set(before) == set(after) == set(episodes)
    areas = [episode for episode in episodes.values() if episode.in_area]
    assert len(areas) == 2
    for episode in episodes.values():
        if not episode.in_area:
            assert after[episode.id] == before[episode.id]
    cell = scene_of(rooms).grid.resolution
    for episode in areas:  # a square's free ground is entered through its rim, or not at all
        assert from_rim(episode, before[episode.id]) >= 0
        assert from_rim(episode, after[episode.id]) >= DEPTH - 2 * cell
    assert any(after[e.id] != before[e.id] for e in areas)
    assert verify_dataset(deep.folder).ok


def test_driven_walks_end_as_deep(rooms: Suite, tmp_path: Path) -> None:
    """Whoever drives, labels say STOP so deep alone; agents side by side write the same bytes."""
    flags = [str(rooms.folder), "--policy", "random", "--chunk", "3", "--halting", "none"]
    flags += ["--inside", str(DEPTH)]
    made = []
    for agents, beta in (("1", "1"), ("3", "1"), ("3", "0.5")):
        out = tmp_path / f"{agents}-{beta}"
        more = ["--agents", agents, "--beta", beta, "--out", str(out)]
        assert main(["data", "dagger", *flags, *more]) == 0
        made.append(open_dataset(out))
    alone, together, driven = made
    assert alone.about.parts == together.about.parts
    assert alone.about.settings.labels.depth == DEPTH
    ends = ends_of(alone)
    cell = scene_of(rooms).grid.resolution
    for episode in rooms.episodes:
        if episode.in_area:
            assert from_rim(episode, ends[episode.id]) >= DEPTH - 2 * cell
    stops = {episode.id: stops_of(driven, episode) for episode in rooms.episodes if episode.in_area}
    assert any(stops.values()) and min(map(min, filter(None, stops.values()))) >= DEPTH - 2 * cell


def stops_of(dataset: Dataset, episode: Episode) -> list[float]:
    """How deep in its area each state is whose label is STOP [m]."""
    rows = [
        rows
        for part in dataset.about.parts
        for rows in decode_rows(load_sample_table(dataset.folder / part.path))
        if rows.episode_id == episode.id
    ]
    return [
        from_rim(episode, (float(x), float(y)))
        for block in rows
        for (x, y, _), actions in zip(block.poses, block.actions, strict=True)
        if actions[0] == 0
    ]


def test_the_command_line_says_how_deep(rooms: Suite, tmp_path: Path) -> None:
    for name, flags in (("none", []), ("zero", ["--inside", "0"]), ("deep", ["--inside", "0.5"])):
        out = str(tmp_path / name)
        assert main(["data", "build", str(rooms.folder), *OF_BUILD, *flags, "--out", out]) == 0
    none, zero, deep = (
        (tmp_path / n / "dataset.json").read_bytes() for n in ("none", "zero", "deep")
    )
    assert none == zero != deep and b'"inside":0.5' in deep.replace(b" ", b"")


@pytest.mark.parametrize("inside", [float("nan"), -1.0, 9.0, "deep"])
def test_a_depth_that_is_none_is_refused_before_anything_is_written(
    rooms: Suite, tmp_path: Path, inside: object
) -> None:
    with pytest.raises(ConfigError, match="inside"):
        build(rooms, tmp_path / "data", inside=inside)
    assert not list(tmp_path.rglob("*.json"))


def test_a_demonstration_ends_where_it_ended() -> None:
    shown = DaggerSettings(policy="recorded", beta=0, halting="none", demonstrate=True)
    with pytest.raises(ConfigError, match="ends where the policy stopped") as told:
        BuildSettings(labels=LabelSettings(inside=DEPTH), dagger=shown)
    assert "--inside" in told.value.remedy


def test_an_episode_is_led_into_its_area_alone(rooms: Suite) -> None:
    for episode in rooms.episodes:
        deeper = episode.into_area(DEPTH)
        assert episode.into_area(0.0) is episode
        if not episode.in_area:
            assert deeper is episode
            continue
        assert episode.goal_set is not None
        assert deeper.goal_set == GoalSetInner(areas=episode.goal_set.areas, depth=DEPTH)
        assert msgspec.structs.replace(deeper, goal_set=episode.goal_set) == episode
