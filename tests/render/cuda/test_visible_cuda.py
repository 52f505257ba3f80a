"""Visible sets on a device: the CPU's sets, kept as numbers, and never a surprise."""

from __future__ import annotations

import logging
import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import DeviceMemoryError, RenderError, StorageError
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import view_from_above, view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cpu_pack import CHUNK
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.renderer import RendererCuda, RendererVisibleCuda
from gn0.render.open import choose_backend, visible_backend
from gn0.render.renderer import VISIBLE_CUDA, RenderOptions
from gn0.render.visible import RendererVisible, VisibleOptions
from gn0.seeds import random_stream
from gn0.sim.open import open_simulator
from gn0.sim.vector import VectorEnv
from gn0.testing.renderer_check import check_renderer, psnr, random_cloud
from gn0.testing.scenes import build_room_scene

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
either = pytest.mark.usefixtures("either_drawer")

EYE = 1.3
QUICK = VisibleOptions(places=2, pixels=32)


def wall(x: float, seed: int, count: int = 500) -> GaussianCloud:
    """A closed wall of coloured discs at x, from y -4 to 4 m and 3 m high."""
    stream = random_stream(seed, "wall")
    y, z = stream.uniform(-4, 4, count), stream.uniform(0, 3, count)
    return GaussianCloud(
        means=np.column_stack([np.full(count, x), y, z]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.tile(np.array([0.003, 0.2, 0.2], np.float32), (count, 1)),
        opacities=np.where(np.arange(count) % 9, 0.95, 0.003).astype(
            np.float32
        ),  # some are left out
        sh=stream.normal(0, 0.6, (count, 1, 3)).astype(np.float32),
    )


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch) -> None:
    # compiled kernels stay where they are; sets go to the test's own folder
    for name in ("gn0.render.visible_files", "gn0.render.bev"):
        monkeypatch.setattr(f"{name}.cache_dir", lambda: tmp_path / "cache")


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
    def build(
        options: VisibleOptions = QUICK, cache: bool = True, antialiased: bool = False
    ) -> RendererVisibleCuda:
        full = RendererCuda(cloud, RenderOptions(antialiased=antialiased), DeviceHost())
        return RendererVisibleCuda(full, cloud.content_hash, floor, EYE, options, cache=cache)

    return build


def views(count: int = 4) -> np.ndarray:
    stream = random_stream(1, "views")
    return np.stack(
        [
            view_from_pose(*stream.uniform(-0.45, 0.45, 2), EYE, stream.uniform(-3, 3))
            for _ in range(count)
        ]
    )


@either
def test_marks_are_the_cpus(make, cloud, floor) -> None:
    """Up to one splat in a thousand: kernels may round a weight across the threshold."""
    ours = make(cache=False)
    theirs = RendererVisible(RendererCpu(cloud), cloud.content_hash, floor, EYE, QUICK, cache=False)
    assert ours.cells == theirs.cells
    found = ours.sets.find(ours.cells, ours.full.cloud)
    for cell, bits in zip(ours.cells, found, strict=True):
        marks, want = np.unpackbits(bits, count=len(cloud)), theirs.find(cell)
        assert int((marks != want).sum()) <= len(cloud) // 1000
        assert 0 < want.sum() < 0.8 * len(cloud)


@either
def test_what_is_near_counts_and_hides_nothing(floor) -> None:
    """A splat at the eye is cut off by every picture's near plane, and yet in the set."""
    at_eye = wall(0.0, 3, 400)
    at_eye.means[:] = at_eye.means * np.float32(0.02) + np.float32([0, 0, EYE - 0.03])
    both = join_clouds([at_eye, wall(2.0, 1)])
    full = RendererCuda(both, None, DeviceHost())
    ours = RendererVisibleCuda(full, "near", floor, EYE, QUICK, cache=False)
    theirs = RendererVisible(RendererCpu(both), "near", floor, EYE, QUICK, cache=False)
    for cell in ours.cells:
        got = np.unpackbits(ours.sets.find([cell], full.cloud)[0], count=len(both))
        assert (got[:400] == theirs.find(cell)[:400]).all()
        assert got[:400].any()


@either
def test_sets_are_packed_in_order_with_boxes_of_their_own(make, cloud, floor) -> None:
    ours = make()
    theirs = RendererVisible(RendererCpu(cloud), cloud.content_hash, floor, EYE, QUICK)
    opened = ours.sets.open(ours.cells, ours.full.cloud)
    for cell, part in opened.items():
        bits = ours.files.load(cell)
        theirs.files.save(cell, bits)
        want = theirs.open(cell)
        assert ours.size_of(cell) == want.size
        slots, order = part.slots.numpy(), part.order.numpy()
        assert len(slots) == part.chunks * CHUNK
        assert (slots[want.size :] == 0xFFFFFFFF).all()
        assert (np.diff(slots[: want.size].astype(np.int64)) > 0).all(), "in packed order"
        assert (order[slots[: want.size]] == want.cloud.order[: want.size]).all()
        boxes = part.boxes.numpy()
        assert (boxes[:, :6] == want.cloud.boxes[:, :6]).all()
        np.testing.assert_allclose(boxes[:, 6], want.cloud.boxes[:, 6], rtol=1e-4)
        assert part.splats is ours.full.cloud.splats, "splats are not copied"


@either
def test_pictures_from_sets_are_nearly_those_of_all(make, cloud) -> None:
    renderer = make(VisibleOptions(places=4, pixels=96))
    camera = Camera.from_hfov(80, 60, 90)
    seen = {cell for cell in renderer.sets.locate(camera, views()) if cell is not None}
    assert len(seen) > 1 and max(map(renderer.size_of, seen)) < 0.8 * len(cloud)
    got, want = (r.render(camera, views()) for r in (renderer, renderer.full))
    assert psnr(got.rgb, want.rgb, 255) > 60
    person = wall(1.0, 9, 100)
    moved = renderer.render(camera, views(), extra=person).rgb
    assert (moved != got.rgb).any()
    assert psnr(moved, renderer.full.render(camera, views(), extra=person).rgb, 255) > 45


@either
def test_views_from_elsewhere_use_all_splats(make) -> None:
    renderer = make()
    camera = Camera.from_hfov(40, 30, 90)
    elsewhere = np.stack(
        [view_from_pose(0.1, 0.1, EYE + 0.1, 0.4), view_from_pose(1.2, 1.2, EYE, 0.4)]
    )
    for cam, poses in (
        (camera, elsewhere),
        (Camera.orthographic(40, 40, 0.1, near=0.0), view_from_above(0.0, 0.0, EYE)),
    ):
        got, want = (r.render(cam, poses) for r in (renderer, renderer.full))
        for name in ("rgb", "depth", "alpha"):
            assert getattr(got, name).tobytes() == getattr(want, name).tobytes()
    assert renderer.built == 0


@either
def test_bytes_depend_on_neither_order_nor_cache_nor_memory(make) -> None:
    camera, poses = Camera.from_hfov(48, 36, 100), views()
    first = make()
    want = first.render(camera, poses).rgb.tobytes()
    assert first.built > 1
    second = make(cache=False)
    for cell in reversed(second.cells):
        second.size_of(cell)
    assert second.render(camera, poses).rgb.tobytes() == want
    third = make()
    assert third.render(camera, poses).rgb.tobytes() == want
    assert third.built == 0, "all came from the cache"
    tight = make(VisibleOptions(places=2, pixels=32, memory=1))
    for view in poses:
        tight.render(camera, view)
    assert len(tight.sets._sets) == 1
    assert tight.render(camera, poses).rgb.tobytes() == want


@either
def test_all_cells_can_be_found_beforehand(make) -> None:
    heard: list[tuple[object, ...]] = []
    renderer = make()
    assert list(renderer.build(lambda *step: heard.append(step))) == renderer.cells
    assert heard[-1][1:] == (len(renderer.cells), len(renderer.cells))
    assert renderer.built == len(renderer.cells)
    assert renderer.files.nbytes > 0
    again = make()
    assert list(again.build(most=2)) == again.cells[:2]
    assert again.built == 0
    half = iter(make(VisibleOptions(places=1, pixels=16)).build())
    next(half)
    half.close()
    with pytest.raises(RenderError, match="cache"):
        list(make(cache=False).build())


@either
def test_files_are_the_cpus_in_form_but_not_in_name(make, cloud, floor) -> None:
    ours = make()
    theirs = RendererVisible(RendererCpu(cloud), cloud.content_hash, floor, EYE, QUICK)
    cell = ours.cells[0]
    size = ours.size_of(cell)
    assert ours.key != theirs.key
    assert ours.key != make(antialiased=True).key
    theirs.files.path(cell).parent.mkdir(parents=True)
    theirs.files.path(cell).write_bytes(ours.files.path(cell).read_bytes())
    assert theirs.open(cell).size == size
    assert theirs.built == 0


@either
def test_a_damaged_file_is_found_again(make, caplog) -> None:
    renderer = make()
    cell = renderer.cells[0]
    size = renderer.size_of(cell)
    path = renderer.files.path(cell)
    raw = path.read_bytes()
    path.write_bytes(raw[:-5])
    again = make()
    with caplog.at_level(logging.WARNING):
        assert again.size_of(cell) == size
    assert "damaged visible set" in caplog.text
    assert path.read_bytes() == raw


@either
def test_a_cache_that_cannot_be_written_costs_a_warning(make, tmp_path, caplog) -> None:
    (tmp_path / "cache").write_text("a file where the cache should be")
    renderer = make()
    with caplog.at_level(logging.WARNING):
        renderer.render(Camera.from_hfov(16, 16, 90), views(1))
    assert "not cached" in caplog.text
    with pytest.raises(StorageError):
        list(renderer.build())


@either
def test_sets_of_a_batch_go_with_their_scene(cloud, floor) -> None:
    """Views with and without sets in one call; another hash drops splats and sets together."""
    batch = RendererBatch(DeviceHost())
    batch.add("a", lambda: cloud, "one")
    batch.add("b", lambda: wall(1.5, 5), "two")
    with pytest.raises(RenderError, match="no scene 'c'"):
        batch.limit_to_visible("c", "three", floor, EYE)
    sets = batch.limit_to_visible("a", "one", floor, EYE, QUICK, cache=False)
    camera, poses, keys = Camera.from_hfov(40, 30, 90), views(4), list("abab")
    mixed = batch.draw(camera, poses, keys, visible=True).numpy().rgb
    assert sets.built > 0
    cells = [c if k == "a" else None for c, k in zip(sets.locate(camera, poses), keys, strict=True)]
    named = batch.draw(camera, poses, keys, visible=cells).numpy().rgb
    assert named.tobytes() == mixed.tobytes()
    whole = batch.draw(camera, poses, keys).numpy().rgb
    assert (mixed[1::2] == whole[1::2]).all(), "a scene without sets is drawn whole"
    batch.store.give_way(["b"])
    again = batch.draw(camera, poses, keys, visible=True).numpy().rgb
    assert again.tobytes() == mixed.tobytes(), "numbers fit the cloud when it is loaded again"
    batch.add("a", lambda: wall(1.0, 6), "another")
    with pytest.raises(RenderError, match="no visible sets"):
        batch.draw(camera, poses, keys, visible=cells)
    assert batch.draw(camera, poses, keys, visible=True).rgb is not None


@either
def test_sets_of_all_scenes_share_a_memory(cloud, floor) -> None:
    """The scene not drawn for longest loses its sets; the bytes stay the same."""
    batch = RendererBatch(DeviceHost(), sets_memory=1)
    camera, poses = Camera.from_hfov(16, 16, 90), views(2)
    sets = {}
    for key in "ab":
        batch.add(key, lambda: cloud, key)
        sets[key] = batch.limit_to_visible(key, key, floor, EYE, QUICK)
    first = batch.draw(camera, poses, "a", visible=True).numpy().rgb
    assert (sets["a"].used, sets["b"].used) == (0, 0)
    assert batch.draw(camera, poses, "a", visible=True).numpy().rgb.tobytes() == first.tobytes()
    assert sets["a"].built == len(set(sets["a"].locate(camera, poses))), "read from the cache"
    batch.sets_memory = 2**30
    batch.draw(camera, poses, "a", visible=True)
    batch.sets_memory = sets["a"].used
    batch.draw(camera, poses, "b", visible=True)
    assert sets["a"].used == 0 < sets["b"].used


@either
def test_sets_give_way_once_when_nothing_else_can(make, monkeypatch) -> None:
    """A drawer that never has room ends in its error, not in a loop."""
    renderer = make(cache=False)
    drawer = type(renderer.full.batch.drawer)
    calls = []

    def draw(self, *args, **named) -> None:
        calls.append(len(renderer.sets._sets))
        raise DeviceMemoryError("no room", where="host emulation")

    monkeypatch.setattr(drawer, "draw", draw)
    with pytest.raises(DeviceMemoryError, match="no room"):
        renderer.render(Camera.from_hfov(16, 16, 90), views(2))
    assert len(calls) == 2


@either
def test_the_contract_of_renderers_holds(floor) -> None:
    def factory(cloud: GaussianCloud, options: RenderOptions) -> RendererVisibleCuda:
        full = RendererCuda(cloud, options, DeviceHost())
        return RendererVisibleCuda(full, cloud.content_hash, floor, EYE)

    check_renderer(factory)


@either
def test_names_and_refusals(make, floor) -> None:
    assert make().name == VISIBLE_CUDA == visible_backend("cuda") == visible_backend(VISIBLE_CUDA)
    assert choose_backend(VISIBLE_CUDA)[0] == VISIBLE_CUDA
    with pytest.raises(RenderError, match="no free place"):
        make().size_of((99, 99))


@either
def test_a_floor_without_a_free_cell_and_a_cloud_without_splats(make, cloud, floor) -> None:
    full = RendererCuda(cloud, None, DeviceHost())
    blocked = floor.with_cells(np.ones_like(floor.cells))
    nowhere = RendererVisibleCuda(full, "hash", blocked, EYE, QUICK)
    assert nowhere.cells == []
    nowhere.render(Camera.from_hfov(16, 16, 90), views(1))
    nothing = RendererCuda(cloud.select(slice(0, 0)), None, DeviceHost())
    empty = RendererVisibleCuda(nothing, "nothing", floor, EYE, QUICK)
    assert empty.size_of(empty.cells[0]) == 0
    assert not empty.render(Camera.from_hfov(16, 16, 90), views(1)).alpha.any()


def test_it_is_a_choice_wherever_backends_are_named(monkeypatch) -> None:
    """In a simulator and in a vector of environments, with the BEV of all splats."""
    monkeypatch.setenv("GN0_DEVICE", "host")
    scene = build_room_scene(spacing=0.4)
    simulator = open_simulator(scene, backend=VISIBLE_CUDA, sensors={"rgb"})
    drawn = simulator.suite.renderer
    assert drawn is not None and (drawn.name, drawn.visible) == (VISIBLE_CUDA, True)
    assert drawn.renderer.open_sets(drawn.key).cells
    env = VectorEnv(2, scene, backend="cuda", visible_sets=True)
    assert env._backend == VISIBLE_CUDA
    env.close()


@pytest.mark.parametrize("seed", [0, 3, 11])
def test_many_chunks_are_gathered_in_order(floor, seed: int) -> None:
    """More chunks than a scan takes at a time, in any order of threads; no drawing."""
    cloud = random_cloud(70_000, seed=5)
    full = RendererCuda(cloud, None, DeviceHost(seed))
    renderer = RendererVisibleCuda(full, "many", floor, EYE, QUICK)
    stream = random_stream(2, "marks")
    wanted = {}
    for share, cell in zip((0.3, 0.0, 1.0), renderer.cells, strict=False):
        wanted[cell] = (stream.uniform(size=len(cloud)) < share).astype(np.uint8)
        renderer.files.save(cell, wanted[cell])
    parts = renderer.sets.open(list(wanted), full.cloud)
    order = full.cloud.order.numpy()[: full.cloud.alive]
    splats = full.cloud.splats.numpy()
    for cell, marks in wanted.items():
        numbers = np.flatnonzero(marks[order])
        slots, boxes = parts[cell].slots.numpy(), parts[cell].boxes.numpy()
        assert (slots[: len(numbers)] == numbers).all()
        assert (slots[len(numbers) :] == 0xFFFFFFFF).all()
        assert len(slots) == len(boxes) * CHUNK == -(-len(numbers) // CHUNK) * CHUNK
        for chunk in range(0, len(boxes), 37):
            mine = splats[numbers[chunk * CHUNK : (chunk + 1) * CHUNK], :3]
            assert (boxes[chunk, :3] == mine.min(axis=0)).all()
            assert (boxes[chunk, 3:6] == mine.max(axis=0)).all()
    assert renderer.built == 0


def test_any_order_of_threads_finds_the_same_sets(cloud, floor) -> None:
    found = []
    for seed in (0, 3, 11):
        full = RendererCuda(cloud, None, DeviceHost(seed))
        sets = RendererVisibleCuda(full, "same", floor, EYE, QUICK, cache=False)
        found.append(sets.sets.find(sets.cells[:2], full.cloud).tobytes())
    assert len(set(found)) == 1


def test_the_device_finds_the_sets_of_its_views(cloud, floor, monkeypatch) -> None:
    """Views and scenes that only the device knows: once sets are there, the host knows no more."""
    batch = RendererBatch(DeviceHost(1))
    device = batch.device
    batch.add("a", lambda: cloud, "one")
    batch.add("b", lambda: wall(1.5, 5), "two")
    batch.add("c", lambda: cloud, "three")
    sets = [batch.limit_to_visible(key, key, floor, EYE, QUICK, cache=False) for key in "ac"]
    camera, poses, keys = Camera.from_hfov(40, 30, 90), views(7), list("abcacab")
    poses[4, :3, 3] += poses[4, :3, 2] * 0.5  # not at the height of eyes
    poses[5] = view_from_pose(9, 9, EYE, 0)  # over no floor
    poses[6] = view_from_pose(0.5, -0.5, EYE, 0.3)  # between cells
    want = batch.draw(camera, poses, keys, visible=True).numpy()
    shown = np.array(["cba".index(key) for key in keys], np.int32)
    there, chosen = device.upload(poses), device.upload(shown)

    def draw():
        return batch.draw(camera, there, list("cba"), chosen=chosen, visible=True)

    with monkeypatch.context() as no_waiting:
        no_waiting.setattr(device, "download", None)
        mine = draw(), draw()
    for pictures in mine:
        for name in ("rgb", "depth", "alpha"):
            assert getattr(pictures.numpy(), name).tobytes() == getattr(want, name).tobytes()
    with monkeypatch.context() as no_arranging:  # nor does it arrange its own view by view
        no_arranging.setattr(batch, "_render", None)
        own = batch.draw(camera, poses, keys, visible=True).numpy()
    assert own.rgb.tobytes() == want.rgb.tobytes()
    whole = batch.draw(camera, there, list("cba"), chosen=chosen).numpy()
    assert whole.rgb.tobytes() != want.rgb.tobytes()
    built = [some.built for some in sets]
    sets[0].clear()  # missing sets are brought by the host, and the next call knows them again
    for _ in range(2):
        assert draw().numpy().rgb.tobytes() == want.rgb.tobytes()
    assert sets[0].built == 2 * built[0]
    assert sets[1].built == built[1]
    with monkeypatch.context() as no_waiting:
        no_waiting.setattr(device, "download", None)
        draw()
    batch.store.give_way(["b"])  # clouds that come back are those that sets are drawn from
    assert draw().numpy().rgb.tobytes() == want.rgb.tobytes()
    alone = batch.draw(camera, there, "a", visible=True).numpy()
    host = batch.draw(camera, poses, "a", visible=True).numpy()
    assert alone.rgb.tobytes() == host.rgb.tobytes()
    above = Camera.orthographic(40, 30, 0.2)
    flat = batch.draw(above, there, list("cba"), chosen=chosen, visible=True).numpy()
    assert flat.rgb.tobytes() == batch.draw(above, poses, keys).numpy().rgb.tobytes()


def test_sets_that_never_fit_are_tried_seldom(cloud, floor) -> None:
    batch = RendererBatch(DeviceHost(), sets_memory=1)
    batch.add("a", lambda: cloud, "one")
    batch.limit_to_visible("a", "one", floor, EYE, QUICK)
    camera, poses = Camera.from_hfov(16, 16, 90), views(2)
    want = batch.draw(camera, poses, "a", visible=True).numpy().rgb.tobytes()
    there = batch.device.upload(poses)
    before = batch.drawer.batches
    for _ in range(24):
        assert batch.draw(camera, there, "a", visible=True).numpy().rgb.tobytes() == want
    assert batch.drawer.batches == before + 24
    assert batch._wait == 15
