"""Up, floor, scale and heading: found where they show, asked for where they do not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gn0.errors import ConfigError, SceneError
from gn0.gaussians.cloud import join_clouds
from gn0.gaussians.splat_files import load_cloud
from gn0.gaussians.transform import transform_cloud
from gn0.scenes.capture.gravity import name_direction, propose_up, sample_surface
from gn0.scenes.capture.pose import propose_pose
from gn0.scenes.capture.settings import (
    CaptureSettings,
    check_capture_settings,
    read_floor,
    read_scale_rule,
    read_up,
)

TURNS = {
    "+z": Rotation.identity(),
    "-z": Rotation.from_euler("x", 180, degrees=True),
    "+y": Rotation.from_euler("x", -90, degrees=True),
    "-y": Rotation.from_euler("x", 90, degrees=True),
    "+x": Rotation.from_euler("y", 90, degrees=True),
    "-x": Rotation.from_euler("y", -90, degrees=True),
}


def tilt_of(pose, turn) -> float:
    """Angle [degrees] between the proposed up and the true one."""
    return math.degrees(math.acos(min(1.0, float((pose.rotation @ turn.as_matrix())[2, 2]))))


@pytest.mark.parametrize("name", TURNS)
def test_up_is_found_along_every_axis(flat, name):
    turned = transform_cloud(flat, rotation=TURNS[name].as_matrix())
    pose = propose_pose(turned, CaptureSettings())
    assert pose.candidates[0].name == name
    assert tilt_of(pose, TURNS[name]) < 0.05
    assert pose.lift == pytest.approx(0.005, abs=0.002)


@pytest.mark.parametrize("name", ["+z", "-y"])
def test_lean_spin_size_and_place_are_undone(flat, shapes, name):
    """Five degrees off an axis, spun by 33°, in centimetres, elsewhere, noisy."""
    lean = Rotation.from_rotvec(np.radians(5) * np.array([0.6, 0.8, 0.0]))
    turn = lean * TURNS[name] * Rotation.from_euler("z", 33, degrees=True)
    moved = transform_cloud(
        shapes.noisy(flat), rotation=turn.as_matrix(), scale=100.0, shift=(300, -50, 800)
    )
    pose = propose_pose(moved, CaptureSettings())
    assert tilt_of(pose, turn) < 0.1
    assert pose.scale == pytest.approx(0.01, rel=0.01)  # the ceiling of 2.6 m speaks
    assert "scale" in pose.doubts
    scene = pose.apply(moved)
    floor = np.quantile(scene.means[:, 2], 0.05)
    assert abs(floor) < 0.02
    heading = math.degrees(math.atan2(*(pose.rotation @ turn.as_matrix())[[1, 0], 0]))
    assert abs(math.remainder(heading, 90)) < 0.2


def test_upright_metric_capture_keeps_its_bytes(flat):
    """What is already upright, in metres and along the axes is only lifted."""
    pose = propose_pose(flat, CaptureSettings())
    assert np.array_equal(pose.rotation, np.eye(3)) and pose.scale == 1.0
    assert np.array_equal(pose.apply(flat).quats, flat.quats)
    assert np.array_equal(pose.apply(flat).means[:, :2], flat.means[:, :2])


def test_noise_is_read_off_the_floor(flat, shapes):
    assert propose_pose(flat, CaptureSettings()).noise < 0.001
    assert propose_pose(shapes.noisy(flat), CaptureSettings()).noise == pytest.approx(
        0.006, rel=0.25
    )


def test_evidence_is_said_in_words(flat):
    pose = propose_pose(flat, CaptureSettings())
    assert "runner-up" in pose.evidence["up"] and "stand on" in pose.evidence["floor"]
    assert "ceiling is 2.6" in pose.evidence["scale"]
    shares = [c.share for c in pose.candidates]
    assert shares == sorted(shares, reverse=True) and sum(shares) == pytest.approx(1, abs=1e-3)


def test_without_anything_of_known_size_the_scale_is_a_doubt(shapes):
    """Ground and a ball on it; walls, doors and tables would have voted."""
    ball = transform_cloud(shapes.ball(0.5), shift=(3, 3, 0.5))
    ground = join_clouds([shapes.rectangle((0, 0, 0), (6, 0, 0), (0, 6, 0)), ball])
    pose = propose_pose(ground, CaptureSettings(up="z"))
    assert pose.scale == 1.0 and "--scale" in pose.doubts["scale"]
    assert pose.ceiling is None and "votes" not in pose.evidence


def test_known_lengths_give_the_scale(flat):
    big = transform_cloud(flat, scale=4.0)
    thin = big.select(slice(None, None, 9))
    for rule in (
        "ceiling:2.6",
        "two-points:7.0@0,1,1@28,1,1",
        "camera-height:1.5@4,4,6",
        "door-height:2.05@16,8,8.2",
    ):
        pose = propose_pose(thin, CaptureSettings(scale_from=rule))
        assert pose.scale == pytest.approx(0.25, rel=0.01), rule
        assert "scale" not in pose.doubts
    assert propose_pose(thin, CaptureSettings(scale=0.3)).scale == 0.3


def test_lengths_that_cannot_be_are_refused(shapes):
    bare = shapes.two_rooms(ceiling=False).select(slice(None, None, 9))
    with pytest.raises(SceneError, match="no ceiling"):
        propose_pose(bare, CaptureSettings(scale_from="ceiling:2.6"))
    with pytest.raises(SceneError, match="above the floor"):
        propose_pose(bare, CaptureSettings(scale_from="camera-height:1.5@1,1,-3"))


def test_given_up_is_levelled_by_the_floor(flat):
    lean = Rotation.from_rotvec((0.05, 0.0, 0.0))
    moved = transform_cloud(flat, rotation=lean.as_matrix())
    pose = propose_pose(moved, CaptureSettings(up="z"))
    assert tilt_of(pose, lean) < 0.05
    assert "as given" in pose.evidence["up"] and not pose.candidates


@pytest.mark.parametrize("name", ["+z", "-y"])
def test_a_room_told_to_stand_on_its_head_is_doubted(flat, name):
    """The user is obeyed, and told that the other end is likelier."""
    turned = transform_cloud(flat, rotation=TURNS[name].as_matrix())
    other = ("-" if name[0] == "+" else "+") + name[1]
    wrong = propose_pose(turned, CaptureSettings(up=other))
    assert "on its head" in wrong.doubts["up"] and f"--up={name}" in wrong.doubts["up"]
    assert "up" not in propose_pose(turned, CaptureSettings(up=name)).doubts


def test_a_statue_told_to_stand_on_its_head_is_doubted(shared_data):
    """Third-party scans: every one of them stands on a plinth at the +y end."""
    for path in sorted((shared_data / "splats" / "statues").glob("*.sog")):
        cloud = load_cloud(path).cloud
        wrong = propose_pose(cloud, CaptureSettings(up="y", floor="bottom"))
        assert "--up=-y the end that is then lowest" in wrong.doubts["up"], path.name
        right = propose_pose(cloud, CaptureSettings(up="-y", floor="bottom"))
        assert "up" not in right.doubts, path.name


def test_an_object_without_floor_is_refused_with_a_way_out(shapes):
    with pytest.raises(SceneError, match="no floor") as caught:
        propose_pose(shapes.ball(), CaptureSettings(up="z"))
    assert "--floor bottom" in caught.value.remedy
    pose = propose_pose(shapes.ball(), CaptureSettings(up="z", floor="bottom"))
    assert pose.ground and pose.lift == pytest.approx(1.0, abs=0.02)
    assert propose_pose(shapes.ball(), CaptureSettings(up="z", floor="-0.5")).lift == 0.5


def test_heading_is_kept_when_told(flat):
    spin = Rotation.from_euler("z", 20, degrees=True)
    moved = transform_cloud(flat, rotation=spin.as_matrix())
    kept = propose_pose(moved, CaptureSettings(yaw="keep"))
    assert np.array_equal(kept.rotation, np.eye(3))
    turned = propose_pose(moved, CaptureSettings())
    assert math.degrees(math.atan2(turned.rotation[1, 0], turned.rotation[0, 0])) == pytest.approx(
        -20, abs=0.1
    )


def test_same_bytes_twice(flat):
    thin = flat.select(slice(None, None, 5))
    a, b = (propose_pose(thin, CaptureSettings()) for _ in range(2))
    assert np.array_equal(a.rotation, b.rotation) and a.lift == b.lift
    assert [c.score for c in a.candidates] == [c.score for c in b.candidates]


def test_too_little_to_see_is_said(flat):
    with pytest.raises(SceneError, match="opaque"):
        sample_surface(flat.select(slice(0, 5)))
    here = flat.select(np.zeros(100, int))
    with pytest.raises(SceneError, match="one place"):
        sample_surface(here)


def test_up_candidates_are_unit_and_both_ways(flat):
    found = propose_up(sample_surface(flat))
    ups = np.array([c.up for c in found])
    np.testing.assert_allclose(np.linalg.norm(ups, axis=1), 1, atol=1e-9)
    for up in ups:
        assert (ups @ up < -0.999).any()


@pytest.mark.parametrize(
    ("text", "up"),
    [("z", (0, 0, 1)), ("-Y", (0, -1, 0)), ("+x", (1, 0, 0)), ("0,-2,0", (0, -1, 0))],
)
def test_ways_to_say_up(text, up):
    assert read_up(text) == pytest.approx(np.array(up))
    assert read_up("auto") is None


@pytest.mark.parametrize("text", ["w", "", "1,2", "0,0,0", "nan,0,1", "--z", "up"])
def test_nonsense_for_up(text):
    with pytest.raises(ConfigError, match="direction"):
        read_up(text)


def test_ways_to_say_floor():
    assert read_floor("auto") is None
    assert read_floor("bottom") == "bottom"
    assert read_floor("-0.4") == -0.4
    for text in ("top", "nan", "inf", ""):
        with pytest.raises(ConfigError, match="height"):
            read_floor(text)


@pytest.mark.parametrize(
    "text",
    [
        "ceiling", "ceiling:", "ceiling:-2", "ceiling:2@1,2,3", "two-points:1@1,2,3",
        "camera-height:1.5@1,2", "camera-height:1.5", "tag:0.1", "two-points:1@a,b,c@1,2,3",
        "ceiling:nan",
    ],
)  # fmt: skip
def test_nonsense_for_a_known_length(text):
    with pytest.raises(ConfigError) as caught:
        read_scale_rule(text)
    assert "two-points:1.2@x,y,z@x,y,z" in caught.value.remedy


def test_contradictions_are_refused():
    with pytest.raises(ConfigError, match="both"):
        check_capture_settings(CaptureSettings(scale=0.5, scale_from="ceiling:2.6"))
    for scale in (-1.0, math.nan, math.inf):
        with pytest.raises(ConfigError, match="scale"):
            check_capture_settings(CaptureSettings(scale=scale))


def test_directions_have_names():
    assert name_direction(np.array([0, 0, 1.0])) == "+z"
    lean = np.array([0, -math.cos(0.1), math.sin(0.1)])
    assert name_direction(lean) == "-y leaning by 5.7°"
