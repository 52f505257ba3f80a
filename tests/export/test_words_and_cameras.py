"""Moves in words, matrices in other people's frames, clips that are cut and joined."""

from __future__ import annotations

import io
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from gn0.errors import FormatError, Gn0Error
from gn0.export.cameras import (
    camera_poses,
    from_mounted,
    from_start_frame,
    intrinsics,
    mount,
    mounted_poses,
    project,
    to_start_frame,
)
from gn0.export.clips import cut_clip, encode_frames, inspect_clip, read_clip
from gn0.export.move_words import coarsen_turns, find_runs, merge_amounts
from gn0.export.navdp import encode_obstacles, load_obstacles, trace_way
from gn0.export.picture_files import encode_depth
from gn0.maps.grid import OccupancyGrid
from gn0.render.video import join_videos
from gn0.sim.presets import find_preset, preset_names

MOVES = st.lists(st.integers(1, 3), max_size=40)
POSES = st.lists(
    st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-3.1, 3.1)), min_size=1, max_size=6
).map(lambda rows: np.array(rows, np.float64))


@given(MOVES)
def test_runs_are_the_moves(moves: list[int]) -> None:
    runs = list(find_runs(moves))
    assert [m for run in runs for m in [run.move] * run.length] == moves
    assert all(a.move != b.move for a, b in pairwise(runs))


@given(MOVES)
def test_amounts_add_up(moves: list[int]) -> None:
    """Centimetres and degrees of all answers are those of all moves; each is of at most three."""
    decisions = merge_amounts([*moves, 0], 0.25, 15.0)
    assert decisions[-1] == (len(moves), "stop")
    centimetres = sum(int(d.answer.split()[2]) for d in decisions if d.answer.startswith("move"))
    degrees = {
        side: sum(int(d.answer.split()[2]) for d in decisions if f"turn {side}" in d.answer)
        for side in ("left", "right")
    }
    assert centimetres == 25 * moves.count(1)
    assert degrees == {"left": 15 * moves.count(2), "right": 15 * moves.count(3)}
    assert all(d.answer.split()[2] in ("25", "50", "75", "15", "30", "45") for d in decisions[:-1])


def test_amounts_are_told_as_navid_tells_them() -> None:
    answers = [d.answer for d in merge_amounts([1, 1, 1, 1, 2, 2, 3, 0], 0.25, 15.0)]
    assert answers == [
        "move forward 75 cm", "move forward 25 cm", "turn left 30 degrees",
        "turn right 15 degrees", "stop",
    ]  # fmt: skip


@given(MOVES)
def test_coarse_turns_lose_only_single_turns(moves: list[int]) -> None:
    coarse, lost = coarsen_turns(moves, 15.0, 30.0)
    odd = sum(run.length % 2 for run in find_runs(moves) if run.move != 1)
    assert lost == odd
    assert sum(step.move == 1 for step in coarse) == moves.count(1)
    assert 2 * sum(step.move != 1 for step in coarse) + lost == len(moves) - moves.count(1)
    assert all(moves[step.pose] == step.move for step in coarse)


def test_poses_are_those_that_interndata_publishes() -> None:
    """The first pose of an episode, as the peer's own issue tracker quotes it, for its cameras."""
    published = {
        (1.25, 0): [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1.25]],
        (1.25, -30): [[0, -0.5, 0.866, 0], [-1, 0, 0, 0], [0, -0.866, -0.5, 1.25]],
        (0.6, -15): [[0, -0.259, 0.966, 0], [-1, 0, 0, 0], [0, -0.966, -0.259, 0.6]],
    }
    for (height, pitch), rows in published.items():
        pose = to_start_frame(np.array([[3.0, -2.0, 0.7]]), height, math.radians(pitch))[0]
        assert np.allclose(pose[:3], rows, atol=5e-4)


@given(POSES, st.floats(0.1, 2), st.floats(-0.9, 0.9))
def test_camera_matrices_give_the_poses_back(
    poses: np.ndarray, height: float, pitch: float
) -> None:
    for back in (
        from_start_frame(to_start_frame(poses, height, pitch), poses[0]),
        from_mounted(mounted_poses(poses, height, pitch), mount(height, pitch)),
    ):
        assert np.allclose(back[:, :2], poses[:, :2], atol=1e-9)
        assert np.allclose(np.exp(1j * back[:, 2]), np.exp(1j * poses[:, 2]), atol=1e-9)


@given(POSES, st.floats(0.2, 2), st.floats(-0.5, 0.5))
def test_navdp_sees_forward_and_left(poses: np.ndarray, height: float, pitch: float) -> None:
    """By NavDP's own arithmetic: base = camera · mount⁻¹, then (y, −x) is (forward, left)."""
    matrices, extrinsic = mounted_poses(poses, height, pitch), mount(height, pitch)
    base = np.eye(4)
    base[:3, :3] = matrices[0, :3, :3] @ np.linalg.inv(extrinsic[:3, :3])
    base[:3, 3] = matrices[0, :3, 3]
    local = (np.linalg.inv(base) @ matrices[:, :, 3].T).T
    seen = np.column_stack([local[:, 1], -local[:, 0]])
    x, y, yaw = poses[0]
    step = poses[:, :2] - (x, y)
    c, s = np.cos(yaw), np.sin(yaw)
    wanted = np.column_stack([c * step[:, 0] + s * step[:, 1], -s * step[:, 0] + c * step[:, 1]])
    assert np.allclose(seen, wanted, atol=1e-9)
    assert np.allclose(matrices[:, 2, 3], height)


def test_a_place_ahead_is_below_the_middle_of_the_picture() -> None:
    preset = find_preset("n1_125cm_0deg")
    camera = camera_poses(np.array([[0.0, 0.0, 0.0]]), 1.25, 0.0)[0]
    points = np.array([[2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [-2.0, 0.0, 0.0]])
    pixels, depth = project(points, camera, intrinsics(preset))
    assert np.allclose(depth, [2, 2, -2])
    assert pixels[0, 0] == pytest.approx(320) and pixels[0, 1] > 240
    assert pixels[1, 0] < 320  # left in the world, left in the picture


@pytest.mark.parametrize("name", preset_names())
def test_a_picture_given_out_smaller_has_the_camera_of_its_own_size(name: str) -> None:
    """The pinhole camera: half the width over the tangent of half the angle of view."""
    preset = find_preset(name)
    drawn = preset.rgb
    half = math.atan(drawn.width / 2 / drawn.fx)
    width, height = preset.picture_size
    k = intrinsics(preset)
    assert k[0, 0] == pytest.approx(width / 2 / math.tan(half))
    assert (k[0, 2] / width, k[1, 2] / height) == pytest.approx((0.5, 0.5))


@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=2, max_size=8))
def test_a_traced_way_is_even_and_stays_on_it(points: list[tuple[float, float]]) -> None:
    poses = np.column_stack([np.array(points), np.zeros(len(points))])
    way = trace_way(poses, 0.0625)
    assert np.isfinite(way).all()
    steps = np.hypot(*np.diff(way[:, :2], axis=0).T)
    assert steps.max(initial=0.0) <= 0.0625 + 1e-9
    assert np.allclose(way[0, :2], poses[0, :2], atol=1e-9)
    length = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    if length.sum() > 1e-6:
        assert np.allclose(way[-1, :2], poses[-1, :2], atol=1e-6)


def test_a_way_looks_where_it_goes() -> None:
    square = np.array([[0, 0, 2.0], [2, 0, 2.0], [2, 2, 2.0]])
    way = trace_way(square, 0.0625)
    assert way[0, 2] == pytest.approx(0.0) and way[-1, 2] == pytest.approx(math.pi / 2)
    assert (np.diff(way[:, 2]) >= -1e-9).all()  # turns in before the corner, and only left
    assert len(trace_way(square[:1], 0.1)) == 1


def test_obstacles_are_found_by_their_colour(tmp_path: Path) -> None:
    cells = np.zeros((6, 8), np.uint8)
    cells[0], cells[3, 4], cells[5, 0] = 1, 1, 2
    grid = OccupancyGrid(cells, 0.5, (-1.0, 2.0))
    path = tmp_path / "pointcloud.ply"
    path.write_bytes(encode_obstacles(grid))
    found = load_obstacles(path)
    wanted = {grid.centre_of(r, c) for r, c in np.argwhere(grid.blocked).tolist()}
    assert {(round(float(x), 5), round(float(y), 5)) for x, y, _ in found} == wanted
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(FormatError, match="whole point cloud"):
        load_obstacles(path)


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    ramp = np.linspace(0, 255, 64, dtype=np.uint8)
    base = np.stack([np.tile(ramp, (48, 1))] * 3, axis=-1)
    return [np.roll(base, 4 * n, axis=1) for n in range(25)]


def test_cut_and_joined_clips_show_the_same_frames(
    pictures: list[np.ndarray], tmp_path: Path
) -> None:
    clip = encode_frames(pictures, 5)
    assert encode_frames(pictures, 5).mp4 == clip.mp4
    short = cut_clip(clip, 13)
    for name, data in (
        ("whole", clip.mp4), ("short", short), ("joined", join_videos([clip.mp4, short], 5)),
    ):  # fmt: skip
        (tmp_path / f"{name}.mp4").write_bytes(data)
    whole, joined = read_clip(tmp_path / "whole.mp4"), read_clip(tmp_path / "joined.mp4")
    assert np.array_equal(read_clip(tmp_path / "short.mp4"), whole[:13])
    assert np.array_equal(joined, [*whole, *whole[:13]])
    assert inspect_clip(tmp_path / "joined.mp4").frames == 38
    assert np.array_equal(read_clip(tmp_path / "joined.mp4", 30, 1)[0], whole[5])
    assert np.abs(whole[7].astype(int) - pictures[7]).mean() < 4


def test_a_damaged_clip_is_told(pictures: list[np.ndarray], tmp_path: Path) -> None:
    path = tmp_path / "clip.mp4"
    data = encode_frames(pictures[:5], 5).mp4
    for damaged in (b"", data[: len(data) // 2], bytes(reversed(data)), b"\0" * 100):
        path.write_bytes(damaged)
        with pytest.raises(Gn0Error):
            inspect_clip(path)
    with pytest.raises(Gn0Error, match="missing"):
        inspect_clip(tmp_path / "absent.mp4")


def test_depth_beyond_what_a_picture_holds_is_its_largest_step() -> None:
    """16 bits end at 6.5535 m in steps of 0.1 mm: what lies further must not come out near."""
    depth = np.array([[0.0, 1.0, 6.5535, 6.5536, 10.0, np.inf]], np.float32)
    steps = np.asarray(Image.open(io.BytesIO(encode_depth(depth, 1e-4))))
    assert steps.tolist() == [[0, 10_000, 65_535, 65_535, 65_535, 65_535]]


def test_a_way_looks_half_a_metre_ahead() -> None:
    """On a way with one corner, headings begin to turn half a metre before it."""
    way = trace_way(np.array([[0, 0, 0.0], [2, 0, 0.0], [2, 2, 0.0]]), 0.0625)
    before, turning = way[way[:, 0] < 1.49], way[(way[:, 0] > 1.51) & (way[:, 1] == 0.0)]
    assert np.abs(before[:, 2]).max() < 1e-9 and (turning[:, 2] > 1e-3).all()
