"""Scans as strangers have them: leaning, in units of their own, without a ceiling or a floor."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from gn0.cli.main import main
from gn0.errors import SceneError
from gn0.gaussians.cloud import join_clouds
from gn0.gaussians.ply import save_ply
from gn0.gaussians.transform import transform_cloud
from gn0.maps.navigation import NavigationMap
from gn0.scenes.capture.capture_source import evidence_lines
from gn0.scenes.capture.closed_doors import find_closed_doors
from gn0.scenes.capture.doorways import Doorway
from gn0.scenes.capture.enclosure import enclosed_share
from gn0.scenes.capture.levels import Level, Storey
from gn0.scenes.capture.patches import Patch
from gn0.scenes.capture.pose import propose_pose
from gn0.scenes.capture.scale import find_scale
from gn0.scenes.capture.settings import CaptureSettings
from gn0.scenes.capture.votes import count_votes
from gn0.scenes.folder import load_scene
from gn0.scenes.procedural.generate import GenerateSettings, build_generated
from gn0.scenes.scene_sources import import_scene
from gn0.testing.bare_capture import BareSettings, draw_frame, save_bare_capture

WITHIN = 0.05  # of the scale: what docs/capture.md promises where doors or tables vote


def leaning(cloud, scale, seed=0):
    """A cloud as a scan: off the -y axis by 8°, spun, in units of `scale` metres."""
    frame = draw_frame(cloud, BareSettings(scale=scale, seed=seed))
    return transform_cloud(cloud, rotation=frame.rotation, scale=1 / frame.scale, shift=frame.shift)


def floor_area(shapes) -> float:
    """Free ground of the two rooms in truth [m²]."""
    return float(shapes.truth_cells().sum()) * 0.05**2


@pytest.mark.parametrize(("scale", "height"), [(0.37, 2.6), (1.3, 3.1), (0.0254, 2.35)])
def test_a_high_or_low_ceiling_does_not_make_the_flat_too_small_or_large(shapes, scale, height):
    """A ceiling alone was taken for 2.6 m: 19 % wrong under one of 3.1 m."""
    pose = propose_pose(leaning(shapes.two_rooms(height=height), scale, 1), CaptureSettings())
    assert pose.scale == pytest.approx(scale, rel=WITHIN)
    assert pose.ceiling == pytest.approx(height, rel=WITHIN)
    assert "doors" in pose.evidence["votes"] and "ceiling" in pose.evidence["votes"]


def test_a_scan_without_its_ceiling_is_measured_by_walls_and_doors(shapes):
    scan = leaning(shapes.two_rooms(ceiling=False), 0.37, 2)
    pose = propose_pose(scan, CaptureSettings())
    assert pose.ceiling is None and pose.scale == pytest.approx(0.37, rel=WITHIN)
    assert "top of the walls" in pose.evidence["votes"]


def test_a_garden_round_the_flat_hides_neither_ceiling_nor_rooms(shapes, tmp_path):
    """No ceiling, a unit of one metre and the lawn for a map: what used to come of it, exit 0."""
    both = join_clouds([shapes.two_rooms(), shapes.lawn()])
    save_bare_capture(both, tmp_path / "scan.ply", BareSettings(scale=0.37, seed=4))
    scene = import_scene(tmp_path / "scan.ply", tmp_path / "scene")
    known = scene.source.settings
    assert known["frame_scale"] == pytest.approx(0.37, rel=WITHIN)
    assert known["ceiling"] == pytest.approx(2.6, rel=WITHIN)
    assert scene.grid.free_area == pytest.approx(floor_area(shapes), rel=0.12)
    assert "most of the ground lies outside the walls" in str(known["doubt_ground"])
    assert any("most of the ground lies outside" in line for line in evidence_lines(scene.source))
    # every vote is kept with the scene
    assert known["vote_doors"] == pytest.approx(0.37, rel=WITHIN)
    assert known["vote_ceiling"] == pytest.approx(0.37, rel=WITHIN)
    kept = json.loads((tmp_path / "scene" / "scene.json").read_text())["source"]["settings"]
    assert kept["evidence_votes"] == known["evidence_votes"]


def test_a_seed_outside_the_walls_is_obeyed_and_said(shapes, tmp_path):
    save_ply(join_clouds([shapes.two_rooms(), shapes.lawn()]), tmp_path / "scan.ply")
    told = CaptureSettings(up="z", scale=1.0, yaw="keep", seed_point=(-4.0, 2.0))
    scene = import_scene(tmp_path / "scan.ply", tmp_path / "scene", capture=told)
    assert scene.grid.is_free(-4.0, 2.0) and not scene.grid.is_free(5.5, 2.0)
    assert "starts there as told" in str(scene.source.settings["doubt_ground"])


def test_a_storey_above_is_no_ceiling(shapes):
    """Two storeys: the lower one's ceiling counts, the slab and the upper floor vote."""
    upper = transform_cloud(shapes.two_rooms(), shift=(0, 0, 2.9))
    pose = propose_pose(join_clouds([shapes.two_rooms(), upper]), CaptureSettings(up="z"))
    assert pose.scale == 1.0 and pose.ceiling == pytest.approx(2.61, abs=0.05)
    assert "floor to floor" in pose.evidence["votes"] and "slab" in pose.evidence["votes"]
    assert "a storey above at 2.9" in pose.evidence["levels"]


def door(head, width=0.9):
    return Doorway(head, (0.0, 0.0), (width, 0.1), 0, None)


def top(height, area=1.0):
    return Patch(height, area, (0, 0), (1, 1), 1.0)


def test_votes_that_disagree_are_named():
    """Doors for dwarfs under a usual ceiling cannot both be right."""
    storey = Storey(ceilings=(Level(26.0, 0.9),))
    tally = count_votes(storey, (door(17.0, 9), door(17.1, 9), door(17.0, 9)), ())
    assert tally is not None and [vote.kind for vote in tally.dissent] == ["ceiling"]
    found = find_scale(CaptureSettings(), np.array([0, 0, 1.0]), 0.0, storey, tally, 100.0)
    assert "disagree" in found.doubt and "ceiling 0.1 against 0.11" in found.doubt
    agreed = count_votes(storey, (door(20.3, 9), door(20.4, 9)), (top(7.4, 100), top(4.5, 20)))
    assert agreed is not None and not agreed.dissent
    assert agreed.scale == pytest.approx(0.1, rel=0.02)
    assert {vote.kind for vote in agreed.votes} == {"doors", "tables", "seats", "ceiling"}
    assert count_votes(Storey(), (door(2.03),), ()) is None
    # shelves alone are believed less, and that is said
    shelves = count_votes(storey, (), (top(7.4, 100), top(4.5, 20)))
    found = find_scale(CaptureSettings(), np.array([0, 0, 1.0]), 0.0, storey, shelves, 100.0)
    assert "no door was found" in found.doubt


def test_a_given_scale_that_all_votes_contradict_is_doubted(flat):
    pose = propose_pose(flat, CaptureSettings(scale=0.5))
    assert pose.scale == 0.5 and "doors" in pose.doubts["scale"]
    assert "scale" not in propose_pose(flat, CaptureSettings(scale=1.03)).doubts


def test_almost_nothing_walkable_asks_instead_of_ending_well(shapes, tmp_path, capsys):
    """A cupboard that one can stand in: written as a scene of 0.6 m², exit 0."""
    side = [shapes.rectangle((0, y, 0), (0.9, 0, 0), (0, 0, 2.4)) for y in (-0.005, 0.905)]
    ends = [shapes.rectangle((x, 0, 0), (0, 0.9, 0), (0, 0, 2.4)) for x in (-0.005, 0.905)]
    floor = shapes.rectangle((0, 0, 0), (0.9, 0, 0), (0, 0.9, 0))
    save_ply(join_clouds([floor, *side, *ends]), tmp_path / "scan.ply")
    command = ["scene", "import", str(tmp_path / "scan.ply"), "--up", "z", "--scale", "1"]
    out = tmp_path / "scene"
    assert main([*command, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "[SCENE]" in said and "m² of ground can be walked on; no scene was written" in said
    for word in (
        "scan.ply",
        "--scale",
        "--up",
        "--floor",
        "--height-band",
        "--least-area",
        "given",
    ):
        assert word in said, word
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scan.ply"]
    # far too small a scale leaves no open floor at all: the same is asked
    assert main([*command[:-1], "0.1", "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "no open floor" in said and "given: 0.1 m a unit" in said and "--scale-from" in said
    assert main([*command, "--out", str(out), "--least-area", "0.1"]) == 0
    assert main([*command, "--out", str(out), "--least-area", "nan"]) == 2


def test_a_flat_whose_floor_was_not_scanned_is_not_stood_on_its_head(shapes, tmp_path):
    """Its ceiling was taken for the floor, without a word."""
    rooms = shapes.two_rooms().select(slice(None, None, 2))
    whole = join_clouds([rooms, transform_cloud(rooms, shift=(0, shapes.DEPTH, 0))])
    scan = whole.select(np.flatnonzero(whole.means[:, 2] > 0.03))
    frame = save_bare_capture(scan, tmp_path / "scan.ply", BareSettings(tilt=0.0, scale=0.4))
    with pytest.raises(SceneError, match="no floor") as caught:
        import_scene(tmp_path / "scan.ply", tmp_path / "scene")
    assert "scan.ply" in str(caught.value) and "--up=-y --floor bottom" in caught.value.remedy
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scan.ply"]
    # the remedy, as given
    told = CaptureSettings(up="-y", floor="bottom", scale=frame.scale)
    scene = import_scene(tmp_path / "scan.ply", tmp_path / "scene", capture=told)
    assert scene.grid.free_area == pytest.approx(2 * floor_area(shapes), rel=0.6)


def test_a_door_found_closed_is_named_and_opens_when_told(shapes, tmp_path, capsys):
    """One room was mapped, the other left out, and nothing said why."""
    closed = join_clouds([shapes.two_rooms(), shapes.leaf()])
    frame = save_bare_capture(closed, tmp_path / "scan.ply", BareSettings(scale=0.4, seed=5))
    command = ["scene", "import", str(tmp_path / "scan.ply"), "--scale", str(frame.scale)]
    assert main([*command, "--out", str(tmp_path / "shut")]) == 0
    said = capsys.readouterr().out
    assert "doors  1 found closed, at (" in said and "give --open-doors" in said
    shut = load_scene(tmp_path / "shut")
    assert shut.grid.free_area < 0.75 * floor_area(shapes)
    assert main([*command, "--open-doors", "--out", str(tmp_path / "open")]) == 0
    said = capsys.readouterr().out
    assert "1 opened" in said and "still no way" not in said
    scene = load_scene(tmp_path / "open")
    assert scene.grid.free_area == pytest.approx(floor_area(shapes), rel=0.08)
    assert (NavigationMap(scene.grid, 0.2).region_areas > 1).sum() == 1
    # the leaf is gone from the splats, the walls, jambs and the floor are not
    gone = len(closed) - len(scene.gaussians)
    assert 0.97 * len(shapes.leaf()) <= gone <= 1.03 * len(shapes.leaf())
    assert scene.source.settings["doors_opened"] == 1


def test_cupboards_and_open_doors_are_no_closed_doors(shapes):
    wardrobe = shapes.box((4.1, 2.5, 0.0), (4.6, 3.4, 2.05))
    cloud = join_clouds([shapes.two_rooms(), wardrobe])
    assert find_closed_doors(cloud, 2.6) == ()
    (door,) = find_closed_doors(join_clouds([cloud, shapes.leaf()]), 2.6)
    assert door.leads and door.centre == pytest.approx((4.05, 1.95), abs=0.03)
    assert door.width == pytest.approx(0.9, abs=0.03) and abs(door.head - 2.05) < 0.02
    # a room behind that was never entered
    half = cloud.select(np.flatnonzero((cloud.means[:, 0] < 4.2) | (cloud.means[:, 2] > 0.1)))
    (door,) = find_closed_doors(join_clouds([half, shapes.leaf()]), 2.6)
    assert not door.leads and "no floor seen behind" in door.words


def test_opening_doors_where_none_is_closed_is_said(flat, tmp_path):
    save_ply(flat, tmp_path / "scan.ply")
    told = CaptureSettings(up="z", scale=1.0, open_doors=True)
    scene = import_scene(tmp_path / "scan.ply", tmp_path / "scene", capture=told)
    assert "no closed door was found" in str(scene.source.settings["evidence_doors"])
    assert len(scene.gaussians) == len(flat)


def test_walls_enclose_what_most_directions_from_it_end_at():
    wall = np.zeros((60, 80), bool)
    wall[10, 10:50] = wall[40, 10:50] = wall[10:41, 10] = wall[10:41, 49] = True
    wall[20:30, 49] = False  # a door left open
    share = enclosed_share(wall)
    assert share[12:39, 12:40].min() >= 0.8
    assert share[:8].max() < 0.65 and share[:, 60:].max() < 0.65
    assert enclosed_share(wall.T)[30, 25] == share[25, 30]
    assert math.isclose(share[25, 30], enclosed_share(wall[::-1])[34, 30])


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "scale", "suffix"), [(1, 0.37, ".splat"), (4, 1.31, ".ply")])
def test_generated_flats_of_unknown_size_come_out_as_they_were(seed, scale, suffix, tmp_path):
    """As `scene generate --as-capture` writes them, and with a lawn round the walls."""
    truth = build_generated(GenerateSettings(seed=seed, size="small", density=5000), "flat")
    ceiling = max(wall.height for wall in truth.walls)
    scan = tmp_path / f"scan{suffix}"
    save_bare_capture(truth.gaussians, scan, BareSettings(scale=scale, tilt=11.0, seed=seed))
    scene = import_scene(scan, tmp_path / "scene")
    known = scene.source.settings
    assert known["frame_scale"] == pytest.approx(scale, rel=WITHIN)
    assert known["ceiling"] == pytest.approx(ceiling, rel=WITHIN)
    assert scene.grid.free_area == pytest.approx(truth.grid.free_area, rel=0.12)
    assert {"vote_doors", "vote_ceiling"} <= set(known)


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--seed-point", "nan", "1"], "--seed-point: (nan, 1) is not a point"),
        (["--floor=1e9"], "--floor: 1e+09 lies far from the splats"),
        (["--floor=-1e9"], "along up"),
        (["--scale", "1e300"], "--scale: scale 1e+300 is not in 1e-06..1,000,000 m a unit"),
        (["--scale", "1e-30"], "1e-30 is not in"),
        (["--scale", "nan"], "nan is not in"),
        (["--scale-from", "two-points:1@0,0,0@0,0,0"], "give two points that lie apart"),
    ],
)
def test_numbers_beyond_reason_are_refused_by_name_and_nothing_is_written(
    flags, said, flat, tmp_path, capsys
):
    """NaN ended in a traceback, and a floor far away in a folder that no verb could read."""
    save_ply(flat, tmp_path / "scan.ply")
    scan, out = str(tmp_path / "scan.ply"), str(tmp_path / "scene")
    assert main(["scene", "import", scan, "--out", out, *flags]) == 2
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["scan.ply"]


def test_the_flag_that_was_typed_is_named(tmp_path, capsys):
    out = str(tmp_path / "scan.ply")
    command = ["scene", "generate", "--as-capture", "--out", out, "--capture-up", "upwards"]
    assert main(command) == 2
    assert "--capture-up: 'upwards' is not a direction" in capsys.readouterr().err
