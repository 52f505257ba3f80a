"""The map picture: metric scale, north up, ceiling cut, and a cache that cannot mislead."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.errors import RenderError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.render.bev import BEV_LIMIT, BevPicture, bev_camera, render_bev
from gn0.render.open import build_renderer
from gn0.render.renderer import RenderOptions
from gn0.testing.renderer_check import random_cloud

BOUNDS = np.array([[-2.0, -1.5, 0.0], [2.0, 1.5, 3.0]])


def marks(points: list[tuple[float, float, float]]) -> GaussianCloud:
    n = len(points)
    return GaussianCloud(
        means=np.array(points, np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        scales=np.full((n, 3), 0.005, np.float32),
        opacities=np.ones(n, np.float32),
        sh=np.full((n, 1, 3), 0.5 / SH_C0, np.float32),
    )


class Counting:
    """A renderer that counts its calls."""

    name = "cpu"

    def __init__(self, cloud: GaussianCloud, options: RenderOptions | None = None) -> None:
        self.inner = build_renderer(cloud, "cpu", options)
        self.traits = self.inner.traits
        self.calls = 0

    def render(self, *args, **kwargs):
        self.calls += 1
        return self.inner.render(*args, **kwargs)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "bev"


def test_marks_lie_where_the_conversion_says(cache) -> None:
    points = [(-1.975, -1.475, 0.1), (1.975, 1.475, 0.2), (0.525, -0.275, 1.0)]
    for point in points:
        cloud = marks([point])
        bev = render_bev(cloud.content_hash, build_renderer(cloud, "cpu"), BOUNDS, 0.05, 2.0)
        assert bev.size == (80, 60)
        column, row = np.floor(bev.pixel_from_world(np.array(point[:2]))).astype(int)
        assert np.unravel_index(bev.rgb[..., 0].argmax(), (60, 80)) == (row, column)
        assert bev.rgb[row, column, 0] > 250
    # north is up: the mark at high y is in the top row
    assert np.floor(bev.pixel_from_world(np.array([0, 1.475])))[1] == 0


def test_ceiling_is_cut_by_the_height_of_centres(cache) -> None:
    cloud = marks([(0.025, 0.025, 2.1), (1.025, 0.025, 1.9)])
    low = render_bev(cloud.content_hash, build_renderer(cloud, "cpu"), BOUNDS, 0.05, 2.0)
    high = render_bev(cloud.content_hash, build_renderer(cloud, "cpu"), BOUNDS, 0.05, 2.2)
    assert low.rgb[29, 40, 0] == 0 and low.rgb[29, 60, 0] > 250
    assert high.rgb[29, 40, 0] > 250 and high.rgb[29, 60, 0] > 250


@given(
    x=st.floats(-500, 500),
    y=st.floats(-500, 500),
    scale=st.sampled_from([0.01, 0.02, 0.025, 0.05, 0.1, 1 / 3]),
    column=st.integers(0, 299),
    row=st.integers(0, 199),
)
def test_conversions_are_inverse(x, y, scale, column, row) -> None:
    bev = BevPicture(np.zeros((200, 300, 3), np.uint8), scale, (x, y))
    centre = np.array([column + 0.5, row + 0.5])
    back = bev.pixel_from_world(bev.world_from_pixel(centre))
    assert np.floor(back).tolist() == [column, row]
    assert np.abs(back - centre).max() < 1e-6
    corners = bev.world_from_pixel(np.array([[0, 200], [300, 0]]))
    assert np.allclose(corners, [[x, y], [x + 300 * scale, y + 200 * scale]], atol=1e-9)


def test_picture_covers_the_bounds_in_whole_pixels() -> None:
    for extent, pixels in [((10.0, 7.5), (200, 150)), ((10.01, 7.49), (201, 150))]:
        camera, view = bev_camera(np.array([(1.0, 2.0), (1 + extent[0], 2 + extent[1])]), 0.05, 2.3)
        assert (camera.width, camera.height) == pixels
        low = view @ np.array([1.0, 2.0, 0.0, 1.0])
        u, v = camera.fx * low[0] + camera.cx, camera.fy * low[1] + camera.cy
        assert abs(u) < 1e-9 and abs(v - pixels[1]) < 1e-9
        assert low[2] == 2.3


def test_second_time_comes_from_the_cache(cache) -> None:
    cloud = random_cloud(200, seed=1)
    renderer = Counting(cloud)
    first = render_bev(cloud.content_hash, renderer, BOUNDS, 0.05, 2.0)
    again = render_bev(cloud.content_hash, Counting(cloud), BOUNDS, 0.05, 2.0)
    render_bev(cloud.content_hash, renderer, BOUNDS, 0.05, 2.0)
    assert renderer.calls == 1
    assert (first.rgb == again.rgb).all() and first.rgb.any()
    assert not first.rgb.flags.writeable and not again.rgb.flags.writeable
    assert len(list(cache.iterdir())) == 1


def test_whatever_changes_the_picture_changes_the_key(cache) -> None:
    cloud, other = random_cloud(200, seed=1), random_cloud(200, seed=2)
    render_bev(cloud.content_hash, Counting(cloud), BOUNDS, 0.05, 2.0)
    variants = [
        (other, {}, BOUNDS, 0.05, 2.0),
        (cloud, {}, BOUNDS + np.array([0.01, 0, 0]), 0.05, 2.0),
        (cloud, {}, BOUNDS, 0.04, 2.0),
        (cloud, {}, BOUNDS, 0.05, 2.1),
        (cloud, {"background": (0.0, 0.0, 1.0)}, BOUNDS, 0.05, 2.0),
    ]
    for which, more, bounds, scale, cut in variants:
        renderer = Counting(which)
        render_bev(which.content_hash, renderer, bounds, scale, cut, **more)
        assert renderer.calls == 1
    sharp = Counting(cloud, RenderOptions(antialiased=True))
    render_bev(cloud.content_hash, sharp, BOUNDS, 0.05, 2.0)
    assert sharp.calls == 1


@pytest.mark.parametrize("damage", ["cut", "flip", "empty", "foreign", "shape", "folder"])
def test_damaged_cache_is_rendered_again(cache, damage: str, caplog) -> None:
    cloud = random_cloud(200, seed=1)
    first = render_bev(cloud.content_hash, build_renderer(cloud, "cpu"), BOUNDS, 0.05, 2.0)
    (path,) = cache.iterdir()
    data = bytearray(path.read_bytes())
    if damage == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif damage == "flip":
        data[-20] ^= 4
        path.write_bytes(data)
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "foreign":
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    elif damage == "shape":
        path.write_bytes(bytes(data).replace(b"[60, 80, 3]", b"[80, 60, 3]"))
    else:
        path.unlink()
        path.mkdir()
    with caplog.at_level(logging.WARNING, "gn0.render.bev"):
        again = render_bev(cloud.content_hash, build_renderer(cloud, "cpu"), BOUNDS, 0.05, 2.0)
    assert (again.rgb == first.rgb).all()
    assert "rendered again" in caplog.text
    if damage != "folder":
        renderer = Counting(cloud)
        render_bev(cloud.content_hash, renderer, BOUNDS, 0.05, 2.0)
        assert renderer.calls == 0  # the cache is whole again


def test_without_a_place_for_the_cache_it_still_renders(tmp_path, monkeypatch, caplog) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("GN0_CACHE", str(blocked))
    cloud = random_cloud(50, seed=1)
    with caplog.at_level(logging.WARNING, "gn0.render.bev"):
        bev = render_bev(cloud.content_hash, build_renderer(cloud, "cpu"), BOUNDS, 0.05, 2.0)
    assert bev.rgb.any()
    assert "not cached" in caplog.text


def test_float_renderers_give_the_same_map(cache) -> None:
    cloud = random_cloud(200, seed=1)
    as_u8 = render_bev(
        cloud.content_hash, build_renderer(cloud, "cpu"), BOUNDS, 0.05, 2.0, cache=False
    )
    renderer = build_renderer(cloud, "cpu", RenderOptions(rgb_float=True))
    as_float = render_bev(cloud.content_hash, renderer, BOUNDS, 0.05, 2.0, cache=False)
    assert (as_u8.rgb == as_float.rgb).all()
    assert not cache.exists()


@pytest.mark.parametrize(
    ("bounds", "scale", "cut", "message"),
    [
        ([[0, 0], [0, 1]], 0.05, 2.0, "extent"),
        ([[0, 0], [-1, 1]], 0.05, 2.0, "extent"),
        ([[0, 0], [np.nan, 1]], 0.05, 2.0, "finite"),
        ([[0, 0, 0]], 0.05, 2.0, "corners"),
        ([[0, 0], [1, 1]], 0.0, 2.0, "metres_per_pixel"),
        ([[0, 0], [1, 1]], float("nan"), 2.0, "metres_per_pixel"),
        ([[0, 0], [1, 1]], 0.05, float("inf"), "cut_height"),
        ([[0, 0], [500, 1]], 0.05, 2.0, "m a pixel"),
    ],
)
def test_maps_without_meaning_are_refused(bounds, scale, cut, message: str) -> None:
    with pytest.raises(RenderError, match=message):
        bev_camera(np.array(bounds, float), scale, cut)


def test_the_largest_map_is_drawn_in_one_call() -> None:
    cloud = marks([(0.0051, 0.0051, 0.5), (40.9549, 20.4749, 0.5)])
    bounds = np.array([[0, 0], [BEV_LIMIT * 0.01, 20.48]])
    bev = render_bev(
        cloud.content_hash, build_renderer(cloud, "cpu"), bounds, 0.01, 2.0, cache=False
    )
    assert bev.size == (BEV_LIMIT, 2048)
    assert bev.rgb[2047, 0, 0] > 200 and bev.rgb[0, BEV_LIMIT - 1, 0] > 200
