"""Whether an exporter keeps the protocol: run a plug-in's class against it.

from gn0.testing.exporter_check import check_exporter
check_exporter(MyExporter, "path/to/an/example")
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gn0.errors import Gn0Error
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.missions.sets.episode_set import EpisodeSet, Exporter, place_task
from gn0.seeds import random_stream
from gn0.sim.presets import find_preset
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes

TOLERANCE = 1e-6  # m and rad


def check_exporter(
    factory: Callable[[], Exporter],
    example: Path | str | None = None,
    *,
    suffix: str = "",
    same: Callable[[EpisodeSet, EpisodeSet], bool] | None = None,
) -> None:
    """Check an exporter on episodes of ours and, if given, on a file of its format.

    Args:
        factory: builds the exporter (a class without required arguments will do).
        example: a file or folder of its format.
        suffix: ending of the files it writes, for example ".json.gz".
        same: whether two sets are the same file; by default equal tasks must do.

    Raises:
        AssertionError: the first rule that is broken, in plain words.
    """
    exporter = factory()
    assert exporter.name and exporter.title, "the exporter has no name or title"
    find_preset(exporter.camera)
    grid = build_floor_plan(1, width=8.0, depth=6.0, clutter=4)
    names = [placement.name for placement in exporter.placements(grid)]
    assert names and len(set(names)) == len(names), "placements are missing or share a name"
    episodes = build_point_episodes(build_map_scene(grid), NavigationMap(grid), 4, seed=2)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        _refuses_strangers(exporter, folder)
        built = exporter.build(episodes, {e.scene_id: grid for e in episodes}, "check")
        _goes_and_comes(exporter, built, folder / f"built{suffix}", same)
        _means_the_same(exporter, built, episodes, grid)
        if example is not None:
            assert exporter.recognises(Path(example)), f"it does not recognise {example}"
            read = exporter.load(Path(example))
            assert read.tasks, "the example holds no task"
            _goes_and_comes(exporter, read, folder / f"example{suffix}", same)


def _refuses_strangers(exporter: Exporter, folder: Path) -> None:
    rng = random_stream(0, "check exporter")
    (folder / "empty").write_bytes(b"")
    (folder / "noise").write_bytes(rng.bytes(512))
    (folder / "folder").mkdir()
    for name in ("absent", "empty", "noise", "folder"):
        path = folder / name
        assert exporter.recognises(path) is False, f"it claims to recognise {name}"
        try:
            exporter.load(path)
        except Gn0Error:
            continue
        except Exception as error:
            raise AssertionError(
                f"reading {name} raised {type(error).__name__}, not a Gn0Error"
            ) from error
        raise AssertionError(f"reading {name} did not fail")


def _goes_and_comes(
    exporter: Exporter,
    episodes: EpisodeSet,
    path: Path,
    same: Callable[[EpisodeSet, EpisodeSet], bool] | None,
) -> None:
    assert episodes.format == exporter.name, "a set does not name its exporter"
    exporter.save(episodes, path)
    assert exporter.recognises(path), "it does not recognise what it wrote"
    again = exporter.load(path)
    assert again.tasks == episodes.tasks, "tasks change on the way through a file"
    assert same is None or same(episodes, again), "the file's content changes on the way"
    rows = list(range(0, len(episodes.tasks), 2))
    part = EpisodeSet(
        episodes.format,
        episodes.name,
        tuple(episodes.tasks[row] for row in rows),
        exporter.take(episodes.native, rows),
    )
    other = path.with_name(f"part-{path.name}")
    exporter.save(part, other)
    ids = [task.id for task in exporter.load(other).tasks]
    assert ids == [task.id for task in part.tasks], "taking some rows takes others"


def _means_the_same(
    exporter: Exporter, built: EpisodeSet, episodes: list[Episode], grid: OccupancyGrid
) -> None:
    """A task placed in the scene again is the episode it was made of."""
    placement = exporter.placements(grid)[0]
    assert len(built.tasks) == len(episodes), "episodes were lost in building"
    for task, episode in zip(built.tasks, episodes, strict=True):
        placed = place_task(task, placement, episode.agent)
        assert placed.instruction == episode.instruction, "the instruction changes"
        assert placed.scene_id == episode.scene_id, "the scene changes"
        values = np.array([*placed.start[:2], *placed.goal])
        wanted = np.array([*episode.start[:2], *episode.goal])
        off = float(np.abs(values - wanted).max())
        assert off <= TOLERANCE, f"start or goal moves by {off} m"
        turned = math.remainder(placed.start[2] - episode.start[2], 2 * math.pi)
        assert abs(turned) <= TOLERANCE, f"the start turns by {turned} rad"
