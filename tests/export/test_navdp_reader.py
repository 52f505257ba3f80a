"""What NavDP's and InternVLA-N1's loaders make of our files: units, frames and orders of theirs.

Written down from InternRobotics/InternNav @7a5c62400ac45b313d9b709c740b64191556a242
(`internnav/dataset/navdp_lerobot_dataset.py`, `internnav/dataset/internvla_n1_lerobot_dataset.py`,
`internnav/habitat_extensions/vln/habitat_vln_evaluator.py` and `utils.py`) and InternRobotics/NavDP
@cb33ff81724033e9e9147c473950ba8d74d6ddac (`baselines/navdp/navdp_server.py`,
`utils_tasks/client_utils.py`). Nothing is shared with the exporter, so a unit that writer and
reader of ours change together is seen here.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from gn0.export.export_run import check_export, remark_export, run_export
from gn0.export.exporter import ExportSettings
from gn0.export.trips import RGBD, ExportSource, Trip
from gn0.sim.presets import find_preset
from gn0.testing.toy_trips import toy_source

STEPS_A_METRE = 10_000.0  # navdp_lerobot_dataset.py 179; navdp_server.py 82; client_utils.py 28
FARTHEST, NEAREST = 5.0, 0.1  # m, navdp_lerobot_dataset.py 188, 189: beyond it is no depth
STRIDE, AHEAD, SCALE = 4, 24, 4.0  # frames, steps, 446, 40, 524
MOST = 1.0  # of a label: its DDPM clips samples to it (navdp_policy.py, clip_sample)
OBSTACLE, LIKE = (0, 0, 0.5), 0.05  # 208, 209
DROP = 0.8  # of the camera's height: where a pixel goal lies, 233
# m along the way that a camera of NavDP's data looks ahead (KuroTaiga/Navdp_Datagen @3c09975)
LOOK_AHEAD = 0.5
MILLIMETRES = 1000  # internvla_n1_lerobot_dataset.py 1025
SETTING = (125, 0, 30)  # 845 to 850: height, level pitch, pitch that looks down


@pytest.fixture(scope="module")
def source() -> ExportSource:
    return toy_source(1, longest=14)


@pytest.fixture(scope="module")
def navdp(source: ExportSource, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("navdp") / "out"
    run_export(source, "navdp", out)
    return out


def navdp_trajectories(root: Path) -> list[dict[str, Any]]:
    """`__init__`, 53 to 116, and `process_data_parquet`, 194 to 202."""
    found = []
    for group in sorted(os.listdir(root)):
        for scene in sorted(os.listdir(root / group)):
            base = root / group / scene
            chunk = os.listdir(base / "data")[0]
            lines = (base / "meta/episodes_stats.jsonl").read_text().splitlines()
            tables = sorted(os.listdir(base / f"data/{chunk}"))
            rgb, depth = (
                [base / f"videos/{chunk}/observation.images.{name}" / p
                 for p in sorted(os.listdir(base / f"videos/{chunk}/observation.images.{name}"))]
                for name in ("rgb", "depth")
            )  # fmt: skip
            for number, line in enumerate(map(json.loads, lines)):
                first, last = line["image_index"]["min"], line["image_index"]["max"]
                table = pq.ParquetFile(base / f"data/{chunk}/{tables[number]}").read(
                    use_threads=False
                )
                columns = {name: table.column(name).to_pylist() for name in table.column_names}
                found.append(
                    {
                        "scene": scene,
                        "rgb": rgb[first : last + 1],
                        "depth": depth[first : last + 1],
                        "k": np.array(columns["observation.camera_intrinsic"][0]).reshape(3, 3),
                        "mount": np.array(columns["observation.camera_extrinsic"][0]).reshape(4, 4),
                        "poses": np.array(columns["action"], np.float64).reshape(-1, 4, 4),
                        "cloud": base / "meta/pointcloud.ply",
                    }
                )
    return found


def seen_depth(path: Path) -> np.ndarray:
    """`process_depth`, 178 to 189, before it is made smaller [m]; 0 where there is none."""
    with Image.open(path) as picture:
        depth = np.array(picture, np.uint16) / STEPS_A_METRE
    depth[(depth > FARTHEST) | (depth < NEAREST)] = 0
    return depth


def local_points(walk: dict[str, Any], start: int) -> np.ndarray:
    """`relative_pose`, 268 to 288: (forward, left) of all frames, seen from one [m]."""
    poses, base = walk["poses"], np.eye(4)
    base[:3, :3] = poses[start, :3, :3] @ np.linalg.inv(walk["mount"][:3, :3])
    base[:3, 3] = poses[start, :3, 3]
    local = (np.linalg.inv(base) @ poses[:, :, 3].T).T
    return np.column_stack([local[:, 1], -local[:, 0]])


def _way(trip: Trip) -> np.ndarray:
    """The places [N, 2] of a walk, each once."""
    steps = np.hypot(*np.diff(trip.poses[:, :2], axis=0).T)
    return trip.poses[np.r_[True, steps > 1e-9], :2]


def _along(way: np.ndarray, at: np.ndarray) -> np.ndarray:
    arcs = np.r_[0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T))]
    return np.column_stack([np.interp(at, arcs, way[:, axis]) for axis in (0, 1)])


def _of(source: ExportSource, scene: str) -> Trip:
    return next(trip for trip in source.trips() if trip.episode.scene_id == scene)


def test_depth_is_in_the_unit_that_navdp_divides_by(source: ExportSource, navdp: Path) -> None:
    for walk in navdp_trajectories(navdp / "vln_n1"):
        trip = _of(source, walk["scene"])
        yaw = np.arctan2(-walk["poses"][0, 1, 2], -walk["poses"][0, 0, 2])  # Blender looks back
        pose = np.array([[*walk["poses"][0, :2, 3], yaw]])
        real = next(source.eyes.look(trip, pose, source.preset, RGBD)).depth
        assert real is not None
        seen = seen_depth(walk["depth"][0])
        near = (real > NEAREST + 1e-3) & (real < FARTHEST - 1e-3)
        assert near.mean() > 0.5
        assert np.abs(seen - real)[near].max() <= 0.5 / STEPS_A_METRE + 1e-6
        assert (seen[real > FARTHEST + 1e-3] == 0).all()


def test_the_camera_looks_half_a_metre_ahead_along_the_way(
    source: ExportSource, navdp: Path
) -> None:
    for walk in navdp_trajectories(navdp / "vln_n1"):
        way = _way(_of(source, walk["scene"]))
        length = np.hypot(*np.diff(way, axis=0).T).sum()
        at = np.linspace(0, length, len(walk["poses"]))
        here, there = _along(way, at), _along(way, np.minimum(at + LOOK_AHEAD, length))
        assert np.allclose(walk["poses"][:, :2, 3], here, atol=1e-9)
        before = at < length - 1e-6
        forward = -walk["poses"][before, :2, 2]  # Blender's camera looks along −z
        aim = (there - here)[before]
        aim /= np.hypot(*aim.T)[:, None]
        assert np.allclose(forward, aim, atol=1e-9)


def test_labels_are_steps_that_its_decoder_can_say(source: ExportSource, navdp: Path) -> None:
    """`__getitem__`: 24 steps, four frames apart, times four; beyond 1 they would be clipped."""
    for walk in navdp_trajectories(navdp / "vln_n1"):
        count = len(walk["poses"])
        assert count == len(walk["rgb"]) == len(walk["depth"])
        assert count // 2 >= 1 and count - 1 > count // 2  # 437 to 439 draw from these
        for start in range(0, count - 2):
            points = local_points(walk, start)[start:]
            picked = np.clip(np.arange(AHEAD + 1) * STRIDE, 0, len(points) - 2)
            labels = np.diff(points[picked], axis=0) * SCALE
            assert np.hypot(*labels.T).max() <= MOST + 1e-6
            assert points[1, 0] > 0  # the first motion is forward
        trip = _of(source, walk["scene"])
        end = trip.poses[-1, :2] - trip.poses[0, :2]
        assert np.hypot(*local_points(walk, 0)[-1]) == pytest.approx(np.hypot(*end), abs=1e-9)


def test_steps_that_its_decoder_would_cut_are_told(
    source: ExportSource, navdp: Path, tmp_path: Path
) -> None:
    assert remark_export(navdp) == []
    run_export(source, "navdp", tmp_path / "out", ExportSettings(spacing=0.2, limit=1))
    (told,) = remark_export(tmp_path / "out")
    assert "in 4 frames" in told and "--spacing 0.0625" in told
    assert told.replace("|", "") in (tmp_path / "out/README.md").read_text()


def test_a_pixel_goal_falls_where_the_way_goes(source: ExportSource, navdp: Path) -> None:
    """`process_pixel_goal`, 233 to 236, against a camera of our own making."""
    for walk in navdp_trajectories(navdp / "vln_n1"):
        k, mount = walk["k"], walk["mount"]
        forward, left = local_points(walk, 0)[-1]
        seen = mount[:3, :3] @ np.array([-left, forward, mount[2, 3] * DROP])
        x = k[0, 2] + seen[0] / seen[2] * k[0, 0]
        y = k[1, 2] - seen[1] / seen[2] * k[1, 1]
        assert x == pytest.approx(k[0, 2] - left / forward * k[0, 0])
        assert y == pytest.approx(k[1, 2] + mount[2, 3] * DROP / forward * k[1, 1])
        body = _of(source, walk["scene"]).episode.agent
        assert mount[2, 3] == pytest.approx(body.camera_height)


def test_obstacles_have_the_colour_that_navdp_looks_for(source: ExportSource, navdp: Path) -> None:
    for walk in navdp_trajectories(navdp / "vln_n1"):
        head, _, body = walk["cloud"].read_bytes().partition(b"end_header\n")
        assert b"property uchar red" in head
        kind = [(c, "<f4") for c in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")]
        points = np.frombuffer(body, np.dtype(kind))
        colour = np.column_stack([points[c] / 255 for c in ("red", "green", "blue")])
        chosen = points[np.abs(colour - OBSTACLE).sum(axis=1) < LIKE]
        grid = source.grid(walk["scene"])
        places = np.column_stack([chosen["x"], chosen["y"]]).astype(float)
        cells = np.floor((places - grid.origin) / grid.resolution).astype(int)
        assert len(cells) > 10 and grid.blocked[cells[:, 1], cells[:, 0]].all()
        apart = np.abs(walk["poses"][:, None, :2, 3] - places).sum(axis=-1).min(axis=-1)
        assert (apart >= 0.1).mean() > 0.9  # else its critic calls the expert a crash, 483


@pytest.fixture(scope="module")
def interndata(source: ExportSource, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("n1") / "out"
    run_export(source, "interndata-n1", out, ExportSettings())
    return out


def n1_episodes(root: Path) -> list[dict[str, Any]]:
    """`get_annotations_from_lerobot_data`, 752 to 805."""
    setting = f"{SETTING[0]}cm_{SETTING[2]}deg"
    found = []
    for scene in sorted(os.listdir(root)):
        for line in (root / scene / "meta/episodes.jsonl").read_text().splitlines():
            episode = json.loads(line)
            number = episode["episode_index"]
            chunk = f"chunk-{number // 1000:03d}"
            table = pq.ParquetFile(
                root / scene / f"data/{chunk}/episode_{number:06d}.parquet"
            ).read(use_threads=False)
            assert table.num_rows == episode["length"]
            columns = {name: table.column(name).to_pylist() for name in table.column_names}
            for text in episode["tasks"][0].split("<INSTRUCTION_SEP>"):
                found.append(
                    {
                        "scene": scene,
                        "id": number,
                        "text": text,
                        "video": root / scene / "videos" / chunk,
                        "actions": [*columns["action"][1:], 0],  # 861
                        "poses": np.array(columns[f"pose.{setting}"]),
                        "ahead": columns[f"relative_goal_frame_id.{setting}"],
                        "goals": columns[f"goal.{setting}"],
                    }
                )
    return found


def robot_ways(cameras: np.ndarray, degrees: float) -> np.ndarray:
    """`get_trajectory_relative_to_frame`, 592 to 648: (x, y, yaw) from the first."""
    to_camera = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float)
    c, s = np.cos(-np.radians(degrees)), np.sin(-np.radians(degrees))
    down = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])
    robots = cameras @ np.linalg.inv(to_camera @ down)
    local = np.linalg.inv(robots[0]) @ robots
    return np.column_stack([local[:, :2, 3], np.arctan2(local[:, 1, 0], local[:, 0, 0])])


def test_n1_reads_the_walk_from_its_poses_and_actions(
    source: ExportSource, interndata: Path
) -> None:
    for episode in n1_episodes(interndata / "traj_data/gn0"):
        trip = _of(source, episode["scene"])
        assert episode["text"] == trip.episode.instruction
        assert episode["actions"] == trip.actions
        x, y, yaw = trip.poses[0]
        c, s = np.cos(yaw), np.sin(yaw)
        dx, dy = trip.poses[:, 0] - x, trip.poses[:, 1] - y
        found = robot_ways(episode["poses"], SETTING[2])
        assert np.allclose(found[:, :2], np.column_stack([c * dx + s * dy, c * dy - s * dx]))
        assert np.allclose(np.exp(1j * found[:, 2]), np.exp(1j * (trip.poses[:, 2] - yaw)))


def test_n1s_goal_is_said_as_x_and_y_of_a_place_on_the_way(interndata: Path) -> None:
    """Said as "{goal[0]} {goal[1]}" (1074); its evaluator takes the second for the row (436)."""
    camera = find_preset(f"n1_{SETTING[0]}cm_{SETTING[2]}deg").rgb
    checked = 0
    for episode in n1_episodes(interndata / "traj_data/gn0"):
        for now, (ahead, goal) in enumerate(zip(episode["ahead"], episode["goals"], strict=True)):
            if ahead == -1:
                assert goal == [-1, -1]
                continue
            said = re.findall(r"\d+", f"{goal[0]} {goal[1]}")
            v, u = int(said[1]), int(said[0])  # `pixel_to_gps`, utils.py 80 to 98
            name = f"episode_{episode['id']:06d}_{now}"
            colour = (episode["video"] / f"observation.images.rgb.{SETTING[0]}cm_{SETTING[1]}deg"
                      / f"{name}.jpg")  # fmt: skip
            grey = str(colour).replace(f"_{SETTING[1]}deg", f"_{SETTING[2]}deg")
            with Image.open(grey.replace("rgb", "depth").replace(".jpg", ".png")) as picture:
                z = np.array(picture)[v, u] / MILLIMETRES
            seen = [(u - camera.cx) * z / camera.fx, (v - camera.cy) * z / camera.fy, z, 1.0]
            place = (episode["poses"][now] @ seen)[:2]
            aim = episode["poses"][now + ahead][:2, 3]
            assert np.hypot(*(place - aim)) < 0.25, (now, place, aim)
            checked += 1
    assert checked >= 4


def test_a_path_that_n1s_loader_rewrites_is_told(
    source: ExportSource, interndata: Path, tmp_path: Path
) -> None:
    """It looks for depth where "rgb" is replaced in the whole path, 1021."""
    assert check_export(interndata) == [] and remark_export(interndata) == []
    import shutil

    named = shutil.copytree(interndata, tmp_path / "rgbd-data")
    assert any("rgb" in remark for remark in remark_export(named))
