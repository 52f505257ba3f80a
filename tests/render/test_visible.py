"""Visible sets: nearly the same pictures, never a surprise, and a cache that cannot lie."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from gn0.errors import ConfigError, RenderError, StorageError
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import view_from_above, view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.host import RendererHost
from gn0.render.instance import Instance, move_instance
from gn0.render.open import build_renderer, choose_backend
from gn0.render.renderer import ALONE, VISIBLE, DrawnScene, RenderOptions
from gn0.render.visible import RendererVisible, VisibleOptions
from gn0.seeds import random_stream
from gn0.testing.renderer_check import check_renderer, psnr
from gn0.testing.renderer_parts_check import ball_cloud, check_renderer_parts, pose_at

EYE = 1.3
QUICK = VisibleOptions(places=3, pixels=96)


def wall(x: float, seed: int, count: int = 6000) -> GaussianCloud:
    """A closed wall of coloured discs at x, from y −4 to 4 m and 3 m high."""
    stream = random_stream(seed, "wall")
    y, z = stream.uniform(-4, 4, count), stream.uniform(0, 3, count)
    return GaussianCloud(
        means=np.column_stack([np.full(count, x), y, z]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.tile(np.array([0.003, 0.06, 0.06], np.float32), (count, 1)),
        opacities=np.full(count, 0.95, np.float32),
        sh=stream.normal(0, 0.6, (count, 1, 3)).astype(np.float32),
    )


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def cloud() -> GaussianCloud:
    """Two walls, one behind the other, on both sides of the floor."""
    return join_clouds([wall(x, k) for k, x in enumerate((2.0, 3.0, -2.0, -3.0))])


@pytest.fixture(scope="module")
def floor() -> OccupancyGrid:
    """One metre by one metre of free floor round the origin."""
    cells = np.ones((60, 60), np.uint8)
    cells[20:40, 20:40] = 0
    return OccupancyGrid(cells, 0.05, (-1.5, -1.5))


@pytest.fixture
def make(cloud, floor):
    def build(options: VisibleOptions = QUICK, threads: int = 0, cache: bool = True):
        full = RendererCpu(cloud, RenderOptions(threads=threads))
        return RendererVisible(full, cloud.content_hash, floor, EYE, options, cache=cache)

    return build


def views(count: int = 6, pitch: float = 0.0) -> np.ndarray:
    stream = random_stream(1, "views")
    return np.stack(
        [
            view_from_pose(*stream.uniform(-0.45, 0.45, 2), EYE, stream.uniform(-3, 3), pitch)
            for _ in range(count)
        ]
    )


def test_hidden_splats_are_left_out_and_pictures_stay(make, cloud) -> None:
    """Less than two thirds are kept; views of other cameras, pitched and wide, agree too."""
    renderer = make(VisibleOptions(places=4, pixels=192))
    sizes = [renderer.open(cell).size for cell in renderer.cells]
    assert max(sizes) < 0.66 * len(cloud)
    for camera, pitch in (
        (Camera.from_hfov(160, 120, 90), 0.0),
        (Camera.from_hfov(200, 150, 120, near=0.01), -0.5),
        (Camera.from_hfov(128, 128, 60), 0.4),
    ):
        got, want = (r.render(camera, views(8, pitch)) for r in (renderer, renderer.full))
        assert psnr(got.rgb, want.rgb, 255) > 60
        solid = np.isfinite(want.depth) & np.isfinite(got.depth)
        assert np.median(np.abs(got.depth[solid] - want.depth[solid])) < 1e-4


def test_views_from_elsewhere_use_all_splats(make) -> None:
    """Another height, a place off the floor, from above: the full set's own bytes."""
    renderer = make()
    camera = Camera.from_hfov(80, 60, 90)
    elsewhere = np.stack(
        [view_from_pose(0.1, 0.1, EYE + 0.1, 0.4), view_from_pose(1.2, 1.2, EYE, 0.4)]
    )
    for cam, poses in (
        (camera, elsewhere),
        (Camera.orthographic(64, 64, 0.1, near=0.0), view_from_above(0.0, 0.0, EYE)),
    ):
        got, want = (r.render(cam, poses) for r in (renderer, renderer.full))
        for name in ("rgb", "depth", "alpha"):
            assert getattr(got, name).tobytes() == getattr(want, name).tobytes()
    assert renderer.built == 0


def test_bytes_depend_on_neither_threads_nor_order_nor_cache(make) -> None:
    camera, poses = Camera.from_hfov(90, 70, 100), views()
    first = make(threads=1)
    want = first.render(camera, poses).rgb.tobytes()
    assert first.built > 1
    second = make(threads=2, cache=False)
    for cell in reversed(second.cells):
        second.open(cell)
    assert second.render(camera, poses).rgb.tobytes() == want
    third = make()
    assert third.render(camera, poses).rgb.tobytes() == want
    assert third.built == 0, "all came from the cache"
    one_by_one = [third.render(camera, view).rgb[0] for view in poses]
    assert np.stack(one_by_one).tobytes() == want, "a view does not depend on its batch"


def test_little_memory_changes_no_byte(make) -> None:
    camera, poses = Camera.from_hfov(64, 48, 90), views()
    want = make().render(camera, poses).rgb.tobytes()
    tight = make(VisibleOptions(places=3, pixels=96, memory=1))
    assert tight.render(camera, poses).rgb.tobytes() == want
    assert len(tight._sets) == 1


def test_moving_splats_are_drawn_with_the_set(make) -> None:
    """What `extra` brings is in no set and always drawn, after the static splats."""
    renderer = make()
    camera, poses = Camera.from_hfov(90, 70, 100), views()
    person = wall(1.0, 9, 300)
    got = renderer.render(camera, poses, extra=person).rgb
    assert (got != renderer.render(camera, poses).rgb).any()
    assert psnr(got, renderer.full.render(camera, poses, extra=person).rgb, 255) > 45


def test_parts_are_drawn_with_the_set_and_hidden_by_its_walls(make) -> None:
    """A ball in front of the near wall shows as its moved splats would; behind it, it does not."""
    renderer = make()
    ball = ball_cloud(800, 1, radius=0.3, sh_degree=1)
    renderer.name_cloud("ball", ball)
    camera, poses = Camera.from_hfov(90, 70, 100), views()
    toward = np.stack([view_from_pose(0.1 * k, 0.1, EYE, 0.1 * k) for k in range(-2, 3)])
    bare = renderer.render(camera, toward)
    tint = np.array([[0.6, 0.9, 0.5], [0.5, 0, -0.9], [0, -0.4, 0.3], [0.2, 0.6, 0]])
    for x, shows in ((1.2, True), (2.5, False)):
        instance = Instance("ball", pose_at(x, 0.2, EYE, 4), tint)
        got = renderer.render(camera, toward, parts=[instance])
        moved = renderer.render(camera, toward, extra=move_instance(ball, instance))
        assert psnr(got.rgb, moved.rgb, 255) > 75
        assert np.abs(got.depth[got.alpha > 0.6] - moved.depth[got.alpha > 0.6]).max() < 1e-4
        full = renderer.full.render(camera, toward, parts=[instance])
        assert psnr(got.rgb, full.rgb, 255) > 45
        near = (got.depth < bare.depth - 0.1)[got.alpha > 0.6]
        assert near.mean() > 0.05 if shows else near.mean() < 0.005
    assert renderer.built > 0
    after = renderer.render(camera, poses).rgb.tobytes()
    assert after == make().render(camera, poses).rgb.tobytes(), "parts are in no set"


@pytest.mark.parametrize("damage", ["cut", "flip", "swap", "empty", "bomb"])
def test_a_damaged_file_is_found_again(make, caplog, damage: str) -> None:
    renderer = make()
    a, b = renderer.cells[:2]
    renderer.open(a)
    renderer.open(b)
    path = renderer.files.path(a)
    raw = path.read_bytes()
    changed = {
        "cut": raw[:-7],
        "flip": raw[:-9] + bytes([raw[-9] ^ 1]) + raw[-8:],
        "swap": renderer.files.path(b).read_bytes(),
        "empty": b"",
        "bomb": raw.replace(b'"splats"', b'"splat5"'),
    }[damage]
    path.write_bytes(changed)
    again = make()
    with caplog.at_level(logging.WARNING):
        found = again.open(a)
    assert again.built == 1
    assert "damaged visible set" in caplog.text
    assert found.cloud.pack.tobytes() == renderer.open(a).cloud.pack.tobytes()
    assert path.read_bytes() == raw, "written again, to the byte"


def test_coarse_pictures_only_add_to_a_set(make) -> None:
    """The places of the fine ones are the first of the coarse ones."""
    fine, both = (
        make(VisibleOptions(places=2, pixels=96, coarse=coarse), cache=False) for coarse in (0, 5)
    )
    added = 0
    for cell in both.cells[:4]:
        kept, found = fine.find(cell), both.find(cell)
        assert (found >= kept).all()
        added += int(found.sum()) - int(kept.sum())
    assert added > 0


def test_other_settings_have_other_files(make, cloud, floor) -> None:
    others = (VisibleOptions(places=3), VisibleOptions(pixels=96))
    keys = {make(o).key for o in (QUICK, *others, VisibleOptions(places=3, pixels=96, coarse=2))}
    full = RendererCpu(cloud)
    keys |= {
        RendererVisible(full, cloud.content_hash, floor, EYE + 0.2, QUICK).key,
        RendererVisible(full, "another cloud", floor, EYE, QUICK).key,
        RendererVisible(
            full, cloud.content_hash, floor.with_cells(np.zeros_like(floor.cells)), EYE, QUICK
        ).key,
    }
    assert len(keys) == 7


def test_the_cache_stays_within_its_size(make) -> None:
    renderer = make(VisibleOptions(places=1, pixels=64, disk=0))
    renderer.open(renderer.cells[0])
    assert not list(renderer.files.folder.glob("*.set"))


def test_a_cache_that_cannot_be_written_costs_a_warning(make, tmp_path, caplog) -> None:
    (tmp_path / "cache").write_text("a file where the cache should be")
    renderer = make()
    with caplog.at_level(logging.WARNING):
        renderer.render(Camera.from_hfov(32, 32, 90), views(1))
    assert "not cached" in caplog.text
    with pytest.raises(StorageError):
        list(renderer.build())


def test_all_cells_can_be_found_beforehand(make) -> None:
    heard = []
    renderer = make()
    assert list(renderer.build(lambda *step: heard.append(step))) == renderer.cells
    assert heard[-1][1:] == (len(renderer.cells), len(renderer.cells))
    assert renderer.built == len(renderer.cells)
    again = make()
    assert list(again.build()) == again.cells
    assert again.built == 0
    with pytest.raises(RenderError, match="cache"):
        list(make(cache=False).build())


def test_the_contract_of_renderers_holds(floor) -> None:
    """Everywhere but where sets apply it is the CPU renderer itself."""

    def factory(cloud: GaussianCloud, options: RenderOptions) -> DrawnScene:
        drawn = DrawnScene(build_renderer(cloud, "cpu", options))
        return drawn.limit_to_visible(cloud.content_hash, floor, EYE)

    check_renderer(factory)

    def of_parts(cloud: GaussianCloud, options: RenderOptions) -> RendererVisible:
        full = RendererCpu(cloud, options)
        return RendererVisible(full, cloud.content_hash, floor, EYE, QUICK, cache=False)

    check_renderer_parts(of_parts)


def test_refusals_say_what_to_do(make, cloud, floor) -> None:
    with pytest.raises(RenderError, match="no free place"):
        make().open((99, 99))
    with pytest.raises(RenderError, match="cells"):
        VisibleOptions(cell=0)
    with pytest.raises(RenderError, match="coarse places"):
        VisibleOptions(coarse=65)
    with pytest.raises(RenderError, match="threshold"):
        VisibleOptions(threshold=2)
    with pytest.raises(ConfigError, match="no visible sets"):
        RendererHost("mine", RendererCpu).limit_to_visible(ALONE, "hash", floor, EYE)
    with pytest.raises(RenderError, match="limit_to_visible first"):
        build_renderer(cloud, "cpu").open_sets(ALONE)
    assert choose_backend(VISIBLE)[0] == VISIBLE
    with pytest.raises(ConfigError, match="open_simulator"):
        build_renderer(cloud, VISIBLE)


def test_a_floor_without_a_free_cell_has_no_sets(cloud, floor) -> None:
    blocked = floor.with_cells(np.ones_like(floor.cells))
    renderer = RendererVisible(RendererCpu(cloud), cloud.content_hash, blocked, EYE)
    assert renderer.cells == []
    renderer.render(Camera.from_hfov(16, 16, 90), views(1))
    assert renderer.built == 0
