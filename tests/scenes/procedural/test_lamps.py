"""Light and colour: a lamp's flux and tint, what light passes, patterns as large as they are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gn0.scenes.mesh import SceneMesh
from gn0.scenes.procedural.assembly import Assembly, Placed
from gn0.scenes.procedural.catalogue.light import TABLE_FLUX, build_table_lamp, glow, lamp_light
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.materials import evaluate_materials
from gn0.scenes.procedural.palette import STYLES, WHITE, Palette, lamp_colour
from gn0.scenes.procedural.surface import ProceduralSurface


def test_warm_lamps_are_red_and_cold_ones_are_blue() -> None:
    red, green, blue = lamp_colour(2700.0)
    assert red == 1.0 > green > blue > 0
    red, green, blue = lamp_colour(9000.0)
    assert blue == 1.0 > green > red
    assert min(lamp_colour(6500.0)) > 0.9


def test_the_flux_of_a_lamp_is_spread_over_its_area() -> None:
    for area in (0.01, 0.09, 0.6):
        assert max(lamp_light(3000.0, 5.0, area)) * math.pi * area == pytest.approx(5.0, rel=1e-2)


def test_a_table_lamp_gives_its_flux_from_a_bulb_or_a_panel() -> None:
    """All round from a ball of area π d², or down from a rectangle."""
    shapes = set()
    for seed in range(6):
        rng = np.random.default_rng(seed)
        (lamp,) = build_table_lamp(rng, Palette(STYLES[0]), kelvin=2700.0).lamps
        wide, deep = lamp.size
        area = math.pi * wide**2 if lamp.shape == "sphere" else wide * deep
        assert max(lamp.colour) * math.pi * area == pytest.approx(TABLE_FLUX, rel=1e-2)
        shapes.add(lamp.shape)
    assert shapes == {"sphere", "rectangle"}


def test_a_lamp_shines_through_its_own_shade_and_through_panes() -> None:
    item = build_table_lamp(np.random.default_rng(0), Palette(STYLES[0]), kelvin=2700.0)
    assembly = Assembly()
    assembly.add_item(Placed(item, 0, 0), None)
    mesh, materials = assembly.finish()
    opaque = ProceduralSurface(mesh, materials).opaque()
    shade = np.array([m.pattern == "lampshade" for m in materials])[mesh.material]
    assert shade.any() and not opaque[shade].any() and opaque[~shade].any()
    bulb = Material(
        name="bulb", pattern="plastic", colour=(1.0, 1.0, 1.0), emission=(2.0, 2.0, 1.5)
    )
    pane = Material(name="pane", pattern="glass", colour=(0.8, 0.9, 0.9))
    one = SceneMesh(
        np.eye(3), np.tile(np.arange(3, dtype=np.int32), (4, 1)), np.zeros((4, 3, 2), np.float32),
        np.arange(4, dtype=np.int32), np.zeros(4, np.int32),
    )  # fmt: skip
    table = (bulb, pane, glow(3000.0, 2.0), WHITE)
    assert ProceduralSurface(one, table).opaque().tolist() == [False, False, False, True]


def test_a_window_shows_a_sky_and_not_one_colour() -> None:
    sky = Material(
        name="daylight", pattern="sky", colour=(0.55, 0.7, 0.95), colour2=(0.25, 0.33, 0.22),
        scale=1.2, emission=(1.0, 1.05, 1.15), seed=4,
    )  # fmt: skip
    uv = np.random.default_rng(0).uniform(0, 1, (2000, 2))
    albedo, light = evaluate_materials([sky], np.zeros(2000, int), uv)
    assert light.std(axis=0).min() > 0.02
    darker = albedo.max(axis=1) < 0.94  # albedo ends at 0.95, light does not
    np.testing.assert_allclose(light[darker], albedo[darker] * sky.emission, atol=1e-6)
    assert np.median(light[uv[:, 1] > 0.8, 2]) > np.median(light[uv[:, 1] < 0.1, 2])


def test_the_gaps_of_a_floor_are_millimetres_wide() -> None:
    floor = Material(
        name="floor", pattern="planks", colour=(0.5, 0.4, 0.3), scale=0.14, contrast=0.0
    )
    uv = np.random.default_rng(1).uniform(0, 4, (40_000, 2))
    level = evaluate_materials([floor], np.zeros(len(uv), int), uv, 0.0005)[0][:, 0]
    dark = (level < 0.8 * np.median(level)).mean()
    assert 0.01 < dark < 0.06  # 3.5 mm of each 14 cm, and the ends of the boards
