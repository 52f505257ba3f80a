"""Numbers that a reader of an export takes as they are: cameras, limits, statistics, counts."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from gn0.export.cameras import camera_height, intrinsics, mount, mounted_poses
from gn0.export.clips import encode_frames, read_clip
from gn0.export.export_run import check_export, plan_export
from gn0.export.exporter import ExportSettings, Job, get_dataset_exporter
from gn0.export.lerobot21 import MetaEpisode, column_stats, write_meta
from gn0.export.trips import ExportSource
from gn0.render.camera import Camera
from gn0.render.light import LightCondition
from gn0.sim.presets import CameraPreset, find_preset


def test_a_picture_squeezed_on_one_side_has_a_focal_length_for_each() -> None:
    """Pinhole: half a side over the tangent of half its own angle of view."""
    camera = Camera.from_hfov(640, 480, 79.0)
    k = intrinsics(CameraPreset(name="square", rgb=camera, depth=camera, rgb_size=(320, 320)))
    half_wide, half_tall = math.radians(camera.hfov / 2), math.radians(camera.vfov / 2)
    assert k[0, 0] == pytest.approx(160 / math.tan(half_wide))
    assert k[1, 1] == pytest.approx(160 / math.tan(half_tall))


def test_the_card_tells_both_angles_of_view(exported: Callable[[str], Path]) -> None:
    """The toy camera is 96 x 72 pixels and 90° wide, so 2 atan(72 / 96) = 73.74° high."""
    card = (exported("navila") / "README.md").read_text()
    assert "96×72, horizontal field of view 90.00°, vertical 73.74°" in card


def test_an_episode_too_many_is_a_fault(exported: Callable[[str], Path], tmp_path: Path) -> None:
    folder = shutil.copytree(exported("vlnce-r2r"), tmp_path / "two")
    about = json.loads((folder / "export.json").read_text())
    assert check_export(folder) == [] and about["written"] == 2
    (folder / "export.json").write_text(json.dumps(about | {"written": 1}))
    assert check_export(folder) == ["2 episodes, export.json says 1"]


@pytest.mark.parametrize("steps", [3, 4, 498, 499])
def test_streamvln_gets_the_lengths_that_its_loader_takes(
    short_source: ExportSource, steps: int
) -> None:
    """Actions, the -1 in front included: over 498 are skipped, under 4 ignored."""
    trip = next(iter(short_source.trips()))
    body = replace(trip.episode.agent, forward_step=0.25, turn_degrees=15.0)
    walk = dataclasses.replace(
        trip,
        episode=replace(trip.episode, agent=body),
        poses=np.tile(trip.poses[:1], (steps, 1)),
        moves=np.full(steps - 1, 2, np.int8),
        ahead=np.zeros((steps, 6), np.int8),
    )
    why = get_dataset_exporter("streamvln").why_not(walk, ExportSettings())
    assert (why == "") == (4 <= steps <= 498), why


def test_a_path_by_day_and_by_night_is_two_walks(
    short_source: ExportSource, tmp_path: Path
) -> None:
    """NavDP has no words, so missions of one path are one walk, but only in one light."""
    day = next(iter(short_source.trips()))
    episode = replace(day.episode, path_id="path")
    dusk = replace(episode, id="dusk", light=LightCondition(name="dusk", exposure=-1.0))
    walks = [dataclasses.replace(day, episode=e) for e in (episode, dusk, replace(dusk, id="x"))]
    source = dataclasses.replace(short_source, trips=lambda: iter(walks))
    job = Job(source, ExportSettings(spacing=0.3), tmp_path)
    plan = plan_export(get_dataset_exporter("navdp"), job)
    assert [trip.id for trip in plan.trips] == [episode.id, "dusk"]


def test_statistics_are_deviations_of_the_values() -> None:
    """LeRobot divides by `std`: the population's, in the unit of the column."""
    found = column_stats({"x": np.array([[0.0], [4.0]])})["x"]
    assert (found["mean"], found["std"], found["count"]) == ([2.0], [2.0], [2])


def test_a_chunk_that_is_not_full_counts(tmp_path: Path) -> None:
    """LeRobot v2.1 has episode i in chunk i // chunks_size, so one episode needs one chunk."""
    for count, chunks in ((1, 1), (4, 1), (5, 2)):
        episodes = [MetaEpisode(n, 7, "go", {}) for n in range(count)]
        write_meta(tmp_path, episodes, {}, 30, chunk=4)
        info = json.loads((tmp_path / "meta/info.json").read_text())
        assert (info["total_chunks"], info["total_frames"]) == (chunks, 7 * count)


def test_the_eye_is_the_bodys_in_its_own_pictures_and_the_cameras_in_others() -> None:
    own, other = find_preset("gn_bench"), find_preset("n1_60cm_15deg")
    tall = replace(own.agent, camera_height=1.11)
    assert camera_height(own, own, tall) == 1.11
    assert camera_height(other, own, tall) == 0.60


def test_navdps_base_stands_on_the_floor_under_the_camera() -> None:
    """Its own arithmetic: base = camera · mount⁻¹, at the agent's place and on the ground."""
    poses = np.array([[2.0, -3.0, 0.7]])
    base = mounted_poses(poses, 1.3, -0.4)[0] @ np.linalg.inv(mount(1.3, -0.4))
    assert np.allclose(base[:3, 3], (2.0, -3.0, 0.0))


def test_so_many_frames_are_read_as_were_asked_for(tmp_path: Path) -> None:
    grey = (np.full((32, 48, 3), 40 * n, np.uint8) for n in range(5))
    (tmp_path / "clip.mp4").write_bytes(encode_frames(grey, 10).mp4)
    read = read_clip(tmp_path / "clip.mp4", 2, 2)
    assert [round(float(f.mean()) / 40) for f in read] == [2, 3]


def test_a_limit_is_the_number_of_episodes(short_source: ExportSource, tmp_path: Path) -> None:
    job = Job(short_source, ExportSettings(limit=1), tmp_path)
    plan = plan_export(get_dataset_exporter("vlnce-r2r"), job)
    assert len(plan.trips) == 1 and plan.skipped == {"beyond the limit of 1 episodes": 1}


def test_navdp_finds_as_many_pictures_as_an_episode_has_frames(
    exported: Callable[[str], Path],
) -> None:
    """Its loader takes pictures `min` to `max`, both included, of those of the scene."""
    scenes = sorted((exported("navdp") / "vln_n1").glob("*/*"))
    for scene in scenes:
        lines, stats = (
            [json.loads(line) for line in (scene / f"meta/{name}.jsonl").read_text().splitlines()]
            for name in ("episodes", "episodes_stats")
        )
        first = 0
        for line, told in zip(lines, stats, strict=True):
            last = first + line["length"] - 1
            assert told["image_index"] == {"min": first, "max": last}
            first = last + 1
    assert scenes
