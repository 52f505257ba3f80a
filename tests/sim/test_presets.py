"""Camera presets carry the numbers of the benchmarks they are named after."""

from __future__ import annotations

import msgspec
import pytest

from gn0.config import check_config
from gn0.errors import ConfigError
from gn0.sim.history import mosaic_size
from gn0.sim.presets import CameraPreset, find_preset, preset_names


def test_gn_bench_is_vertical_seventy() -> None:
    preset = find_preset("gn_bench")
    assert preset.picture_size == (480, 360)
    assert preset.rgb.vfov == pytest.approx(70.0)
    assert preset.rgb.hfov == pytest.approx(86.07, abs=0.005)
    assert preset.rgb.fx == pytest.approx(257.07, abs=0.005)
    assert (preset.rgb.cx, preset.rgb.cy, preset.rgb.near, preset.rgb.far) == (240, 180, 0.01, 100)
    assert preset.agent.camera_height == 1.30
    assert preset.pitch_degrees == 0
    assert preset.depth_range == (0, 10)
    assert preset.background == (1, 1, 1)


@pytest.mark.parametrize(
    ("name", "size", "hfov", "turn"),
    [
        ("gn0_ce", (480, 360), 79, 15),
        ("vlnce_r2r", (224, 224), 90, 15),
        ("vlnce", (224, 224), 90, 15),
        ("vlnce_rxr", (640, 480), 79, 30),
        ("streamvln", (640, 480), 79, 15),
        ("navid", (640, 480), 90, 30),
        ("uninavid", (640, 480), 120, 30),
        ("sage", (640, 480), 90, 15),
        ("datagen", (960, 720), 86.067, 15),
        ("gn_bench_tools", (960, 720), 86.067, 10),
    ],
)
def test_sizes_angles_and_turns(name: str, size: tuple[int, int], hfov: float, turn: float) -> None:
    preset = find_preset(name)
    assert preset.picture_size == size
    assert preset.rgb.hfov == pytest.approx(hfov, abs=0.005)
    assert preset.agent.turn_degrees == turn
    assert preset.agent.forward_step == 0.25


def test_depth_may_have_its_own_size() -> None:
    preset = find_preset("vlnce_r2r")
    assert (preset.depth.width, preset.depth.height) == (256, 256)


def test_bodies_and_tilts() -> None:
    assert find_preset("vlnce_rxr").agent.camera_height == 0.88
    assert find_preset("vlnce_rxr").agent.radius == 0.18
    assert find_preset("n1_60cm_30deg").agent.camera_height == 0.60
    assert find_preset("n1_60cm_30deg").pitch_degrees == -30
    assert find_preset("datagen").pitch_degrees == pytest.approx(-2.86, abs=0.005)


@pytest.mark.parametrize(("name", "side"), [("tiny_128", 128), ("tiny_160", 160)])
def test_small_eyes_are_square_and_their_mosaic_is_a_view(name: str, side: int) -> None:
    preset = find_preset(name)
    assert preset.picture_size == (side, side) == mosaic_size(preset.history_tile)
    assert preset.rgb == preset.depth and preset.rgb.hfov == preset.rgb.vfov == pytest.approx(90)
    assert preset.agent == find_preset("gn_bench").agent
    assert preset.background == find_preset("gn_bench").background


def test_tiles_are_those_of_the_preset_unless_told_otherwise() -> None:
    assert {
        find_preset(name).history_tile for name in preset_names() if not name.startswith("tiny_")
    } == {(160, 120)}
    assert find_preset("vlnce", history_tile=(56, 40)).history_tile == (56, 40)
    assert find_preset("vlnce").history_tile == (160, 120)
    with pytest.raises(ConfigError, match="history_tile"):
        find_preset("vlnce", history_tile=(0, 40))


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_survives_the_wire(name: str) -> None:
    preset = check_config(find_preset(name))
    assert msgspec.json.decode(msgspec.json.encode(preset), type=CameraPreset) == preset


def test_an_unknown_name_lists_the_known() -> None:
    with pytest.raises(ConfigError, match=r"vlnce_r2r"):
        find_preset("habitat")


@pytest.mark.parametrize(
    "change",
    [
        {"depth_range": (5.0, 1.0)},
        {"depth_range": (0.0, float("nan"))},
        {"pitch_degrees": 90.0},
        {"rgb_size": (9999, 360)},
        {"history_tile": (160, 0)},
        {"history_tile": (5000, 120)},
    ],
)
def test_settings_without_meaning_are_refused(change: dict) -> None:
    with pytest.raises(ConfigError):
        msgspec.structs.replace(find_preset("gn_bench"), **change).__post_init__()
