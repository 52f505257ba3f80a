"""Patterns are colours, the same everywhere, and calm when seen from afar."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.errors import SceneError
from gn0.scenes.procedural.draft import Material
from gn0.scenes.procedural.materials import evaluate_materials, pattern_names
from gn0.scenes.procedural.noise import cells, fractal, random_cells, stripes

NAMES = [
    "paint", "plaster", "planks", "wood", "parquet_herringbone", "tiles", "marble", "concrete",
    "fabric", "knit", "leather", "carpet", "rug_stripes", "rug_border", "rug_persian", "curtain",
    "linen", "metal", "brushed_metal", "glass", "mirror", "ceramic", "plastic", "paper", "leaf",
    "bark", "soil", "book_spine", "picture_landscape", "picture_abstract", "picture_portrait",
    "screen", "wicker", "cork", "food", "sky", "lampshade",
]  # fmt: skip


def material(pattern: str, **more: object) -> Material:
    settings = {
        "name": pattern, "pattern": pattern, "colour": (0.5, 0.3, 0.2), "colour2": (0.2, 0.3, 0.5),
        "scale": 0.1, "seed": 3, "emission": (float(pattern == "sky"),) * 3,
    }  # fmt: skip
    return Material(**{**settings, **more})  # type: ignore[arg-type]


def look(m: Material, uv: np.ndarray, footprint: float = 0.01) -> np.ndarray:
    return evaluate_materials([m], np.zeros(len(uv), int), uv, footprint)[0]


def test_every_promised_pattern_exists() -> None:
    assert set(NAMES) <= set(pattern_names())


@pytest.mark.parametrize("name", pattern_names())
def test_pattern_is_a_colour_and_does_not_depend_on_its_company(name: str) -> None:
    rng = np.random.default_rng(0)
    uv = rng.uniform(0, 1, (4000, 2)).astype(np.float32)
    image = look(material(name), uv)
    assert np.isfinite(image).all() and image.min() >= 0 and image.max() <= 0.95
    np.testing.assert_array_equal(image[::7], look(material(name), uv[::7]))
    far = look(material(name), uv * 40 - 20)  # large and negative coordinates
    assert np.isfinite(far).all()


@pytest.mark.parametrize("name", ["planks", "wood", "fabric", "carpet", "knit", "wicker", "leaf"])
def test_coarse_footprint_hides_fine_detail(name: str) -> None:
    """Neighbouring points 4 mm apart differ less when detail below 5 cm is not seen."""
    rng = np.random.default_rng(1)
    uv = rng.uniform(0, 3, (20_000, 2))
    near = uv + np.array([0.0, 0.004])
    m = material(name)

    def roughness(footprint: float) -> float:
        return float(np.abs(look(m, uv, footprint) - look(m, near, footprint)).mean())

    assert roughness(0.05) < 0.6 * roughness(0.001)


def test_seed_changes_the_picture_and_emission_scales_it() -> None:
    uv = np.random.default_rng(2).uniform(0, 1, (500, 2))
    first, second = (look(material("picture_abstract", seed=s), uv) for s in (1, 2))
    assert np.abs(first - second).max() > 0.1
    _, dim = evaluate_materials([material("sky")], np.zeros(500, int), uv)
    _, bright = evaluate_materials(
        [material("sky", emission=(4.0, 4.0, 4.0))], np.zeros(500, int), uv
    )
    np.testing.assert_allclose(bright, 4 * dim)


def test_unknown_pattern_is_named() -> None:
    with pytest.raises(SceneError, match="unknown pattern 'velvet'"):
        look(material("velvet"), np.zeros((1, 2)))


def test_noise_is_integer_hashed() -> None:
    """Golden values: the same on every machine, or scenes would differ."""
    x = np.array([0.25, 7.5, -3.75, 1234.5])
    y = np.array([0.5, -2.25, 9.0, -77.125])
    np.testing.assert_array_equal(random_cells(x, y, 5), random_cells(np.floor(x), np.floor(y), 5))
    assert np.abs(fractal(x, y, 5)).max() < 1.5
    first, second, tone = cells(x, y, 5)
    assert (first <= second).all() and (tone >= 0).all() and (tone <= 1).all()


def test_noise_that_is_finer_than_what_is_seen_as_one_point_is_gone() -> None:
    x, y = np.random.default_rng(3).uniform(0, 40, (2, 2000))
    assert np.abs(fractal(x, y, 5, footprint=1.0)).max() == 0.0
    coarse = fractal(x, y, 5, octaves=1, footprint=0.1)
    np.testing.assert_array_equal(fractal(x, y, 5, octaves=1), coarse)
    both = fractal(x, y, 5, octaves=4, footprint=0.25)
    assert np.corrcoef(both, coarse)[0, 1] > 0.99 > np.corrcoef(fractal(x, y, 5), coarse)[0, 1]


def test_stripes_keep_their_share() -> None:
    x = np.linspace(0, 50, 100_001)
    for footprint in (0.0, 0.3, 1.0, 2.5):
        assert stripes(x, 0.2, footprint).mean() == pytest.approx(0.2, abs=2e-3)
