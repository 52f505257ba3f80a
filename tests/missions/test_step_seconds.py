"""How long an action takes is the body's: kept unless it is half a second, unseen where it is."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from gn0.data.dataset import DatasetFile, DatasetScene, SuiteOrigin, compute_seal
from gn0.data.settings import BuildSettings
from gn0.errors import EpisodeError
from gn0.missions.episode import AgentSpec, Episode, MissionGoal, tell_pace
from gn0.missions.episode_files import episodes_digest_bytes, load_episodes, save_episodes
from gn0.scenes.folder import save_scene
from gn0.storage import content_hash
from gn0.suites.suite import Suite, SuiteFile, SuiteScene, build_suite, load_suite
from gn0.testing.scenes import build_room_scene

QUICK = AgentSpec(step_seconds=0.2)
OTHER = AgentSpec(radius=0.1, camera_height=1.25, turn_degrees=30.0, sliding=True)


def episode(agent: AgentSpec) -> Episode:
    return Episode(
        id="a",
        scene_id="flat",
        mission=MissionGoal(
            goal=(3.0, 2.0), object_id="7", category="sofa", instruction="Go to the sofa."
        ),
        start=(1.0, 2.0, 0.5),
        path=((1.0, 2.0), (3.0, 2.0)),
        seed=3,
        agent=agent,
    )


def suite(agent: AgentSpec) -> Suite:
    scene = SuiteScene(id="flat", folder="scenes/flat", hash="0" * 64)
    about = SuiteFile(
        layout=1, name="pinned", version="1", scenes=(scene,), camera="gn_bench", agent=agent,
        episodes=1,
    )  # fmt: skip
    return Suite(Path("."), about, (episode(agent),))


def dataset(agent: AgentSpec) -> DatasetFile:
    return DatasetFile(
        layout=1, samples=1, suite=SuiteOrigin(name="pinned", version="1", hash="0" * 32),
        camera="gn_bench", agent=agent, settings=BuildSettings(),
        scenes=(DatasetScene(id="flat", folder="scenes/flat", hash="0" * 32, splits=("test",),
                             episodes=1),),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("agent", "whole", "episodes"),
    [
        (AgentSpec(), "91a2207644f041945035bb37a98f1353", "0d0416e5bf082395b992736360f8ac67"),
        (OTHER, "221369dc66324a888246508e2f3713ec", "25fe26b12a56716e215c7ffae70bf332"),
    ],
)
def test_hashes_are_those_of_before_bodies_had_a_clock(
    agent: AgentSpec, whole: str, episodes: str
) -> None:
    """Worked out by the code of before there was the field."""
    assert suite(agent).hash == whole
    assert content_hash(episodes_digest_bytes([episode(agent)])) == episodes


def test_so_are_the_seal_of_a_dataset_and_what_digests_are_made_of() -> None:
    assert compute_seal(dataset(AgentSpec())) == "3fb9b1ec37142072875a952e13a85dd4"
    assert repr(AgentSpec()) == (
        "AgentSpec(radius=0.2, camera_height=1.3, forward_step=0.25, turn_degrees=15.0, "
        "sliding=UNSET)"
    )
    assert msgspec.to_builtins(AgentSpec()) == {
        "radius": 0.2, "camera_height": 1.3, "forward_step": 0.25, "turn_degrees": 15.0,
    }  # fmt: skip


@pytest.mark.parametrize("half", [0.5, 5 * 0.1, 0.1 + 0.4, np.float64(0.5)])
def test_half_a_second_however_it_was_reached_is_the_default(half: float) -> None:
    changed = msgspec.structs.replace(QUICK, step_seconds=half)
    decoded = msgspec.json.decode(json.dumps({"step_seconds": float(half)}), type=AgentSpec)
    for agent in (AgentSpec(step_seconds=half), changed, decoded):
        assert agent == AgentSpec() and "step_seconds" not in msgspec.to_builtins(agent)
        assert suite(agent).hash == suite(AgentSpec()).hash


def test_bodies_that_differ_only_in_it_differ_everywhere() -> None:
    assert AgentSpec(step_seconds=3 * 0.1).step_seconds == 0.3  # not 0.30000000000000004
    assert AgentSpec(step_seconds=1) == AgentSpec(step_seconds=1.0) != AgentSpec()
    assert "step_seconds=0.2" in repr(QUICK)
    assert len({suite(AgentSpec(step_seconds=k / 10)).hash for k in range(1, 12)}) == 11
    assert compute_seal(dataset(QUICK)) != compute_seal(dataset(AgentSpec()))
    assert content_hash(episodes_digest_bytes([episode(QUICK)])) != content_hash(
        episodes_digest_bytes([episode(AgentSpec())])
    )


def test_time_is_of_whole_ticks_and_no_error_adds_up() -> None:
    assert QUICK.step_ticks == 2 and AgentSpec().step_ticks == 5
    assert [QUICK.time_after(n) for n in (0, 1, 3, 500)] == [0.0, 0.2, 0.6, 100.0]
    assert all(AgentSpec().time_after(n) == 0.5 * n for n in range(1000))


def test_cards_tell_of_it_where_older_cards_would_be_wrong() -> None:
    assert tell_pace(AgentSpec()) == "" and tell_pace(QUICK) == ", 0.2 s an action"


@pytest.mark.parametrize(
    "seconds",
    [0.25, 0.05, 0.0, -0.5, float("nan"), float("inf"), 60.1, 1e300, 10**400, "0.2", None, True],
)
def test_what_is_no_duration_of_an_action_is_refused(seconds: object) -> None:
    with pytest.raises(EpisodeError, match=r"step_seconds is .*multiple of 0\.1") as caught:
        AgentSpec(step_seconds=seconds)  # type: ignore[arg-type]
    assert caught.value.where == "agent" and caught.value.remedy


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    root = tmp_path_factory.mktemp("quick")
    save_scene(build_room_scene(spacing=0.2), root / "flat")
    return build_suite([root / "flat"], root / "suite", 2, 3, minimum_length=1.0, agent=QUICK)


def test_a_suite_of_a_quick_body_reads_back(quick: Suite) -> None:
    again = load_suite(quick.folder)
    assert again.hash == quick.hash and again.about.agent.step_seconds == 0.2
    assert {e.agent.step_seconds for e in again.episodes} == {0.2}
    assert json.loads((quick.folder / "suite.json").read_text())["agent"]["step_seconds"] == 0.2
    assert "agent_step_seconds" in pq.read_schema(quick.folder / "episodes.parquet").names


def test_files_of_before_have_half_a_second(quick: Suite, tmp_path: Path) -> None:
    table = pq.read_table(quick.folder / "episodes.parquet").drop_columns("agent_step_seconds")
    pq.write_table(table, tmp_path / "older.parquet")
    older = load_episodes(tmp_path / "older.parquet")
    assert {e.agent.step_seconds for e in older} == {0.5}
    grids = {s.id: build_room_scene(spacing=0.2).grid for s in quick.about.scenes}
    save_episodes(tmp_path / "now.parquet", older, grids)
    assert "agent_step_seconds" not in pq.read_schema(tmp_path / "now.parquet").names
    mixed = [*older[:1], msgspec.structs.replace(older[1], agent=QUICK)]
    save_episodes(tmp_path / "mixed.parquet", mixed, grids)
    assert load_episodes(tmp_path / "mixed.parquet") == mixed


@pytest.mark.parametrize("seconds", [0.25, -1.0, 0.0, float("nan"), 1e9])
def test_a_file_with_another_is_named_with_its_row(
    quick: Suite, tmp_path: Path, seconds: float
) -> None:
    table = pq.read_table(quick.folder / "episodes.parquet")
    cells = [seconds] * len(table)
    place = table.column_names.index("agent_step_seconds")
    field = table.schema.field(place)
    broken = table.set_column(place, field, [cells])
    pq.write_table(broken, tmp_path / "broken.parquet")
    with pytest.raises(EpisodeError, match=r"broken\.parquet, row 1.*step_seconds is"):
        load_episodes(tmp_path / "broken.parquet")


def test_a_suite_file_with_another_is_named(quick: Suite, tmp_path: Path) -> None:
    import shutil

    folder = Path(shutil.copytree(quick.folder, tmp_path / "copy"))
    about = json.loads((folder / "suite.json").read_text())
    about["agent"]["step_seconds"] = 0.25
    (folder / "suite.json").write_text(json.dumps(about))
    with pytest.raises(EpisodeError, match=r"suite\.json, agent: step_seconds is 0\.25"):
        load_suite(folder)
