"""Episode files: lossless, strict, and readable by those who know GN-Matrix only."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import EpisodeError, FormatError, Gn0Error, StorageError
from gn0.maps.goal_places import GoalSet
from gn0.maps.grid import OccupancyGrid
from gn0.missions.episode import (
    AgentSpec,
    Episode,
    MissionFollow,
    MissionGoal,
    MissionInstruction,
    check_episode,
)
from gn0.missions.episode_files import (
    GN_MATRIX_COLUMNS,
    LATER_COLUMNS,
    OUR_COLUMNS,
    cells_to_pixels,
    episodes_digest_bytes,
    load_episodes,
    nav_to_world,
    save_episodes,
    world_to_nav,
)
from gn0.render.light import LightCondition

GRID = OccupancyGrid(np.zeros((120, 200), np.uint8), 0.05, (-3.0, 1.5))  # x −3..7, y 1.5..7.5
GRIDS = {"flat": GRID}


def goal(number: int = 0, **changes: Any) -> Episode:
    mission = MissionGoal(
        goal=(5.025, 6.525), object_id="o7", category="sofa", instruction="Go to the sofa."
    )
    start = (-2.0 + 0.1 * number, 2.0, -math.pi / 3)
    path = ((start[0], start[1]), (1.0, 4.0), (5.025, 6.525))
    fields: dict[str, Any] = {
        "id": f"flat_{number:04d}", "scene_id": "flat", "mission": mission, "start": start,
        "path": path, "seed": number, "agent": AgentSpec(radius=0.3, turn_degrees=30.0),
    }  # fmt: skip
    return Episode(**{**fields, **changes})


MIXED = [
    goal(0),
    goal(1, mission=MissionInstruction(goal=(5.0, 6.0), instruction="Turn left, then „halt“. 走")),
    goal(2, mission=MissionFollow(goal=(5.0, 6.0), instruction="Follow her.", human="h1")),
    goal(3, id="of another name", split="train"),
]
LATER = [
    goal(4, path_id="flat-p7", light=LightCondition(name="dusk", exposure=-1.2, kelvin=4100)),
    goal(
        5,
        path_id="flat-p7",
        mission=MissionInstruction(
            goal=(5.0, 6.0),
            instruction="Walk on.",
            object_id="o7",
            category="sofa",
            style="detailed",
        ),
    ),
]


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "episodes.parquet"
    save_episodes(path, MIXED, GRIDS)
    return path


def test_what_is_written_is_read_back_exactly(saved: Path) -> None:
    assert load_episodes(saved) == MIXED


def test_path_style_and_light_are_read_back(tmp_path: Path) -> None:
    save_episodes(tmp_path / "later.parquet", LATER, GRIDS)
    assert load_episodes(tmp_path / "later.parquet") == LATER


def test_the_same_episodes_give_the_same_bytes(saved: Path, tmp_path: Path) -> None:
    save_episodes(tmp_path / "again.parquet", MIXED, GRIDS)
    assert (tmp_path / "again.parquet").read_bytes() == saved.read_bytes()


def test_a_file_of_an_earlier_version_has_no_path_style_or_light(
    saved: Path, tmp_path: Path
) -> None:
    table = pq.read_table(saved).drop_columns([name for name, *_ in LATER_COLUMNS])
    pq.write_table(table, tmp_path / "earlier.parquet")
    found = load_episodes(tmp_path / "earlier.parquet")
    assert [e.id for e in found] == [e.id for e in MIXED]
    assert all(e.path_id == "" and e.light is None for e in found)


SETS = [
    goal(6, goal_set=GoalSet(points=((5.025, 6.525), (1.125, 2.0 / 3)))),
    goal(7, goal_set=GoalSet(areas=(((4.0, 6.0), (6.0, 6.0), (6.0, 7.0)),))),
    goal(8, tier="visible from above"),
]


def test_goal_sets_and_tiers_are_read_back_and_leave_other_files_as_they_were(
    saved: Path, tmp_path: Path
) -> None:
    save_episodes(tmp_path / "sets.parquet", [*SETS, *MIXED], GRIDS)
    assert load_episodes(tmp_path / "sets.parquet") == [*SETS, *MIXED]
    assert {"goal_set", "tier"} <= set(pq.read_schema(tmp_path / "sets.parquet").names)
    assert not {"goal_set", "tier"} & set(pq.read_schema(saved).names)


def test_a_goal_set_without_the_goal_is_refused() -> None:
    with pytest.raises(EpisodeError, match="not in its goal set"):
        check_episode(goal(0, goal_set=GoalSet(points=((0.0, 2.0), (1.0, 2.0)))))


def test_light_that_is_no_condition_is_named_with_its_row(saved: Path, tmp_path: Path) -> None:
    table = pq.read_table(saved)
    column = pa.array(["", "", '{"exposure": "much"}', ""])
    at = table.column_names.index("light")
    pq.write_table(table.set_column(at, table.schema.field(at), column), tmp_path / "odd.parquet")
    with pytest.raises(EpisodeError, match=r"row 3.*column 'light'"):
        load_episodes(tmp_path / "odd.parquet")


def test_what_says_nothing_leaves_the_digest_as_it_was() -> None:
    plain = episodes_digest_bytes([goal(0)])
    assert b"path_id" not in plain and b"light" not in plain
    assert episodes_digest_bytes([goal(0, path_id="p")]) != plain


finite = st.floats(-1e6, 1e6)


@given(st.lists(st.tuples(finite, finite, st.floats(-3.14, 3.14), st.integers(-(2**63), 2**63 - 1)),
                min_size=1, max_size=6))  # fmt: skip
@settings(deadline=None, max_examples=40)
def test_any_finite_values_survive(
    tmp_path_factory: pytest.TempPathFactory, values: list[tuple[float, float, float, int]]
) -> None:
    episodes = [
        goal(i, start=(x, y, yaw), seed=seed, path=((x, y), (0.1, 2.0)))
        for i, (x, y, yaw, seed) in enumerate(values)
        if abs(x) + abs(y) < 50
    ] or [goal()]
    path = tmp_path_factory.mktemp("any") / "e.parquet"
    save_episodes(path, episodes, GRIDS)
    assert load_episodes(path) == episodes


def test_gn_matrix_columns_come_first_by_their_exact_names(saved: Path) -> None:
    table = pq.read_table(saved)
    names = [name for name, _ in GN_MATRIX_COLUMNS]
    ours = [name for name, _ in OUR_COLUMNS] + [name for name, *_ in LATER_COLUMNS]
    assert table.column_names == names + ours
    published = (
        "scene trajectory_id instruction grounded_instruction label_ins_id label_label "
        "label_goal_pixel_x label_goal_pixel_y start_world_x start_world_y start_facing_unit_dx "
        "start_facing_unit_dy start_facing_heading_degrees goal_world_x goal_world_y "
        "path_raster_world_x path_raster_world_y path_raster_pixel_x path_raster_pixel_y"
    )
    assert " ".join(names) == published
    assert all(column.null_count == 0 for column in table.columns)
    row = table.to_pylist()[0]
    assert row["trajectory_id"] == "0000" and row["grounded_instruction"] == "Go to the sofa."
    assert f"{row['scene']}_{row['trajectory_id']}" == row["episode_id"]
    lists = {len(row[f"path_raster_{kind}_{axis}"]) for kind in ("world", "pixel") for axis in "xy"}
    assert len(lists) == 1 and lists.pop() > 100


def test_the_gn_matrix_frame_is_the_published_closed_form(saved: Path) -> None:
    """Formulas as published, from InteriorGS's lower and upper; ours must give the same numbers."""
    row = pq.read_table(saved).to_pylist()[0]
    lower, upper, scale = (-3.0, 1.5), (7.0, 7.5), 0.05
    for i in (0, 57, -1):
        px, py = row["path_raster_pixel_x"][i], row["path_raster_pixel_y"][i]
        assert row["path_raster_world_x"][i] == pytest.approx(-(lower[0] + (px + 0.5) * scale))
        assert row["path_raster_world_y"][i] == pytest.approx(-(upper[1] - (py + 0.5) * scale))
        x, y = upper[0] - (px + 0.5) * scale, lower[1] + (py + 0.5) * scale  # InteriorGS
        assert nav_to_world(
            GRID, np.array([[row["path_raster_world_x"][i], row["path_raster_world_y"][i]]])
        )[0] == pytest.approx((x, y))
    wx, wy = row["goal_world_x"], row["goal_world_y"]
    assert row["label_goal_pixel_x"] == round((-wx - lower[0]) / scale - 0.5)
    assert row["label_goal_pixel_y"] == round((upper[1] + wy) / scale - 0.5)
    heading = math.radians(row["start_facing_heading_degrees"])
    assert math.cos(heading) == pytest.approx(row["start_facing_unit_dx"])
    assert math.sin(heading) == pytest.approx(row["start_facing_unit_dy"])


def test_frames_invert_each_other_and_pixels_cover_the_picture() -> None:
    p = np.random.default_rng(0).uniform(-5, 5, (50, 2))
    assert nav_to_world(GRID, world_to_nav(GRID, p)) == pytest.approx(p)
    pixels = cells_to_pixels(GRID, np.argwhere(GRID.cells == 0))
    assert pixels.min(axis=0).tolist() == [0, 0] and pixels.max(axis=0).tolist() == [199, 119]


def test_a_file_of_gn_matrix_alone_is_read_through_the_scenes_grid(
    saved: Path, tmp_path: Path
) -> None:
    theirs = pq.read_table(saved).select([name for name, _ in GN_MATRIX_COLUMNS]).slice(0, 1)
    theirs = theirs.append_column("their_extra", pa.array([1]))
    theirs = theirs.set_column(1, "trajectory_id", pa.array([17]))  # an integer id is fine
    path = tmp_path / "theirs.parquet"
    pq.write_table(theirs.replace_schema_metadata(None), path)
    with pytest.raises(EpisodeError, match="needs the scene's grid"):
        load_episodes(path)
    (episode,) = load_episodes(path, GRIDS)
    assert episode.id == "flat_17" and episode.instruction == "Go to the sofa."
    assert episode.start == pytest.approx(MIXED[0].start)
    assert episode.goal == pytest.approx(MIXED[0].goal)
    away = np.abs(np.array(episode.path)[[0, -1]] - np.array(MIXED[0].path)[[0, -1]])
    assert away.max() <= GRID.resolution


def edited(saved: Path, change: Any) -> Path:
    table = change(pq.read_table(saved))
    pq.write_table(table, saved)
    return saved


def put(name: str, values: Any, kind: pa.DataType | None = None) -> Any:
    def change(table: pa.Table) -> pa.Table:
        index = table.column_names.index(name)
        return table.set_column(index, pa.field(name, kind or pa.array(values).type),
                                pa.array(values, kind))  # fmt: skip

    return change


NAN = float("nan")


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda t: t.drop_columns(["goal_world_x"]), FormatError, "'goal_world_x'.*is missing"),
        (lambda t: t.drop_columns(["split"]), FormatError, "'split'.*is missing"),
        (lambda t: t.append_column("oops", pa.array([1] * 4)), FormatError, "'oops'.*unknown"),
        (put("seed", ["a"] * 4), FormatError, "'seed'.*is string, expected int64"),
        (put("start_3dgs_x", ["1"] * 4), FormatError, "'start_3dgs_x'.*expected double"),
        (put("start_3dgs_x", [0.0, None, 0.0, 0.0]), FormatError, "'start_3dgs_x'.*row 2 is null"),
        (put("path_3dgs_x", [[0.0], [None], [0.0], [0.0]]), FormatError, "row 2 is null"),
        (put("path_3dgs_x", [[0.0]] * 4), FormatError, "'path_3dgs_y'.*row 1 has 3 values"),
        (put("start_3dgs_yaw", [0.0, 0.0, NAN, 0.0]), EpisodeError, "row 3.*NaN"),
        (put("goal_3dgs_y", [math.inf, 0.0, 0.0, 0.0]), EpisodeError, "row 1.*infinity"),
        (put("grounded_instruction", ["a", " ", "b", "c"]), EpisodeError, "row 2.*empty"),
        (put("mission", ["goal", "dance", "goal", "goal"]), EpisodeError, "row 2.*'dance'"),
        (put("agent_radius", [0.2, 0.2, -1.0, 0.2]), EpisodeError, "row 3.*radius"),
        (put("episode_id", ["a", "b", "a", "c"]), EpisodeError, "'a' is used by row 1 and row 3"),
        (put("episode_id", ["a", "../b", "c", "d"]), EpisodeError, "row 2.*not a plain name"),
        (put("episode_id", ["a", "b", "", "d"]), EpisodeError, "row 3.*not a plain name"),
    ],
)
def test_what_is_wrong_is_told_with_file_row_and_column(
    saved: Path, change: Any, error: type[Gn0Error], message: str
) -> None:
    edited(saved, change)
    with pytest.raises(error, match=message) as caught:
        load_episodes(saved)
    assert "episodes.parquet" in str(caught.value) and caught.value.remedy


@given(
    cut=st.floats(0, 1), flips=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=4)
)
@settings(deadline=None, max_examples=60)
def test_a_damaged_file_gives_an_error_of_ours_or_valid_episodes(
    tmp_path_factory: pytest.TempPathFactory, cut: float, flips: list[tuple[float, int]]
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    save_episodes(folder / "e.parquet", MIXED, GRIDS)
    data = bytearray((folder / "e.parquet").read_bytes())
    for place, value in flips:
        data[int(place * (len(data) - 1))] = value
    if not flips:
        data = data[: int(cut * (len(data) - 1))]
    (folder / "e.parquet").write_bytes(data)
    try:
        assert len(load_episodes(folder / "e.parquet")) <= 4
    except Gn0Error as error:
        assert "e.parquet" in str(error)


def test_missing_files_and_missing_grids_are_told(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="check that the path exists"):
        load_episodes(tmp_path / "none.parquet")
    with pytest.raises(EpisodeError, match="no grid for scene 'flat'"):
        save_episodes(tmp_path / "e.parquet", MIXED, {})
    with pytest.raises(EpisodeError, match="is used by row 1 and row 2"):
        save_episodes(tmp_path / "e.parquet", [goal(), goal()], GRIDS)
    with pytest.raises(EpisodeError, match="NaN"):
        bad = msgspec.structs.replace(goal(), start=(0.0, NAN, 0.0))
        save_episodes(tmp_path / "e.parquet", [bad], GRIDS)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads by /proc")
def test_reading_leaves_no_thread_behind(saved: Path) -> None:
    """A thread that lets go of our bytes while Python ends would abort the process."""
    code = (
        "import os, sys\n"
        "import gn0.missions.episode_files as files\n"
        "before = len(os.listdir('/proc/self/task'))\n"
        "files.load_episodes(sys.argv[1])\n"
        "print(len(os.listdir('/proc/self/task')) - before)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(saved)], capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip()) == (0, "0"), done.stderr
