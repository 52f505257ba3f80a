"""Asking another process for pictures gives what the renderer gives, and its errors."""

from __future__ import annotations

import io
import shutil
import socket
import sys
import threading
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from PIL import Image

from gn0.device.host import DeviceHost
from gn0.errors import DeviceError, DeviceMemoryError, FormatError, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.renderer import RendererCuda, RendererVisibleCuda
from gn0.render.depth import to_millimetres
from gn0.render.encoding import Dots, DrawnViews, Encode, MapPicture
from gn0.render.host import RendererHost
from gn0.render.instance import Instance
from gn0.render.open import open_renderer
from gn0.render.renderer import DrawnScene
from gn0.render.share.client import RendererShared, SceneEncoder
from gn0.render.share.connection import DrawConnection
from gn0.render.share.messages import Draw, Floor, lay_out
from gn0.render.share.parts import Cloud, PartRows
from gn0.render.share.server import Server, open_listener
from gn0.render.visible import RendererVisible
from gn0.render.visible_places import VisibleOptions
from gn0.scenes.parts import build_ball
from gn0.sim.sensors import GREEN, RED, draw_disc
from gn0.storage import content_hash
from gn0.testing.renderer_check import random_cloud as many_shapes

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="Unix sockets"),
    pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++"),
]
CAMERA = Camera.from_hfov(48, 36, 90.0)
BLACK = (0.0, 0.0, 0.0)


def random_cloud(seed: int) -> GaussianCloud:
    rng = np.random.default_rng(seed)
    n = 300
    quats = rng.normal(size=(n, 4))
    return GaussianCloud(
        means=rng.uniform(-2, 2, (n, 3)).astype(np.float32),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.uniform(0.02, 0.2, (n, 3)).astype(np.float32),
        opacities=rng.uniform(0.2, 1, n).astype(np.float32),
        sh=rng.normal(size=(n, 1, 3)).astype(np.float32),
    )


def load(source: dict[str, Any]) -> GaussianCloud:
    if source["seed"] < 0:
        raise RenderError("no such cloud", where="seed", remedy="give another")
    return random_cloud(source["seed"])


def views(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([view_from_pose(*rng.uniform(-1, 1, 2), 0.5, a, 0.0)
                     for a in rng.uniform(-3, 3, count)])  # fmt: skip


class BatchWithLimit(RendererHost):
    """As the CPU's, with memory for so many views; counts calls and their views."""

    def __init__(self, limit: int = 10**9) -> None:
        super().__init__("cpu", RendererCpu, None, RendererVisible)
        self.limit, self.calls = limit, []

    def draw(self, camera, matrices, keys, **more):  # type: ignore[no-untyped-def, override]
        self.calls.append((len(matrices), len(set(keys))))
        if len(matrices) > self.limit:
            raise DeviceMemoryError("not so much")
        return super().draw(camera, matrices, keys, **more)


class Serving:
    """A server in threads of this process, and connections to it."""

    def __init__(self, batch: Any, most: int = 256) -> None:
        self.notes: list[str] = []
        self.server = Server(batch, load, most, self.notes.append)
        self.listener, self.address = open_listener()
        self.open: list[DrawConnection] = []
        threading.Thread(target=self.server.listen, args=(self.listener,), daemon=True).start()
        self.thread = threading.Thread(target=self.work, daemon=True)
        self.thread.start()

    def work(self) -> None:
        try:
            while True:
                self.server.serve_once()
        except DeviceError:
            pass

    def renderer(self, seed: int) -> DrawnScene:
        self.open.append(DrawConnection(self.address))
        return RendererShared(self.open[-1], "cpu").add_source(f"scene {seed}", {"seed": seed})

    def close(self) -> None:
        for connection in self.open:
            connection.close()
        self.listener.close()


@pytest.fixture
def serve():
    made = []

    def start(*args, **more) -> Serving:
        made.append(Serving(*args, **more))
        return made[-1]

    yield start
    for serving in made:
        serving.close()


def render_files(drawn: DrawnScene, *args: Any, **more: Any) -> DrawnViews:
    """Files of a scene, whether or not its renderer says that it makes any."""
    return SceneEncoder(drawn.renderer, drawn.key, drawn.visible).render_files(*args, **more)


def expect_same(one, other, outputs=("rgb", "depth", "alpha")) -> None:
    for name in ("rgb", "depth", "alpha"):
        if name in outputs:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        else:
            assert getattr(one, name) is None


def test_pictures_are_those_of_the_renderer(serve) -> None:
    shared = serve(open_renderer("cpu")).renderer(1)
    alone = RendererCpu(random_cloud(1))
    for count in (1, 5, 40):  # 40: more than one request holds
        expect_same(shared.render(CAMERA, views(count)), alone.render(CAMERA, views(count)))
    small = Camera.orthographic(33, 17, 0.1, near=0.0)
    expect_same(
        shared.render(small, views(2), outputs=("depth",), background=(1.0, 0.0, 0.0)),
        alone.render(small, views(2), outputs=("depth",), background=(1.0, 0.0, 0.0)),
        ("depth",),
    )
    none = shared.render(CAMERA, np.zeros((0, 4, 4)), outputs=("rgb",))
    assert none.rgb is not None and none.rgb.shape == (0, 36, 48, 3) and none.depth is None


@pytest.mark.parametrize("drawn_by", ["cpu", "cuda"])
def test_labels_go_over_with_those_of_moving_parts(serve, monkeypatch, drawn_by: str) -> None:
    batch = open_renderer("cpu") if drawn_by == "cpu" else RendererBatch(DeviceHost())
    label = (np.arange(300) % 9 - 1).astype(np.int32)
    cloud = replace(random_cloud(1), label=label, categories=np.arange(1, 9, dtype=np.int32))
    body = replace(random_cloud(2), label=label + 30, categories=np.arange(1, 40, dtype=np.int32))
    serving = serve(batch)
    monkeypatch.setattr(serving.server, "_load", lambda source: cloud)
    shared, alone = serving.renderer(1), RendererCpu(cloud)
    assert shared.traits.labels
    for renderer in (shared, alone):
        renderer.name_cloud("body", body)
    wanted: Any = ("rgb", "semantic", "instance")
    for parts in ((), [Instance("body", np.eye(4))]):
        got = shared.render(CAMERA, views(3), outputs=wanted, parts=parts)
        want = alone.render(CAMERA, views(3), outputs=wanted, parts=parts)
        for name in ("semantic", "instance"):
            mine, theirs = getattr(got, name), getattr(want, name)
            assert mine.dtype == np.uint32 and (mine == theirs).mean() >= 0.999
        assert (got.instance > 29).any() == bool(parts)


def test_many_ask_at_once_and_get_their_own(serve) -> None:
    serving = serve(BatchWithLimit(), most=64)
    renderers = [serving.renderer(seed % 3) for seed in range(9)]
    wanted = [
        RendererCpu(random_cloud(seed % 3)).render(CAMERA, views(6, seed)) for seed in range(9)
    ]
    wrong: list[Exception] = []

    def ask(number: int) -> None:
        try:
            for _ in range(5):
                found = renderers[number].render(CAMERA, views(6, number))
                expect_same(found, wanted[number])
        except Exception as error:
            wrong.append(error)

    threads = [threading.Thread(target=ask, args=(n,)) for n in range(9)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    calls = serving.server._batch.calls
    assert max(count for count, _ in calls) > 6 and max(kinds for _, kinds in calls) > 1
    assert max(count for count, _ in calls) <= 64
    assert serving.server.tally.views == 9 * 5 * 6


def test_too_little_memory_means_smaller_batches_said_once(serve) -> None:
    serving = serve(BatchWithLimit(3))
    shared = serving.renderer(2)
    expect_same(
        shared.render(CAMERA, views(20)), RendererCpu(random_cloud(2)).render(CAMERA, views(20))
    )
    shared.render(CAMERA, views(20))
    assert len(serving.notes) == 1 and "too little device memory" in serving.notes[0]
    broke = serve(BatchWithLimit(0)).renderer(2)
    with pytest.raises(DeviceMemoryError, match="not so much"):
        broke.render(CAMERA, views(2))


def test_one_that_fails_takes_nobody_with_it(serve) -> None:
    serving = serve(open_renderer("cpu"))
    good, bad = serving.renderer(1), serving.renderer(-1)
    for _ in range(2):
        with pytest.raises(RenderError, match="no such cloud") as caught:
            bad.render(CAMERA, views(1))
        assert (caught.value.where, caught.value.remedy) == ("seed", "give another")
    expect_same(
        good.render(CAMERA, views(2)), RendererCpu(random_cloud(1)).render(CAMERA, views(2))
    )
    with pytest.raises(RenderError, match="not finite"):
        good.render(CAMERA, np.full((1, 4, 4), np.nan))
    with pytest.raises(RenderError, match="moving splats"):
        good.render(CAMERA, views(1), extra=random_cloud(1))


class BatchLost(RendererHost):
    def draw(self, *args, **more):  # type: ignore[no-untyped-def, override]
        raise DeviceError("the card fell off the bus")


def test_scenes_are_read_while_others_are_drawn(serve, monkeypatch) -> None:
    """Once each, by whoever asks first; a slow one holds nobody up but those who want it."""
    serving = serve(open_renderer("cpu"))
    read: list[int] = []
    gate = threading.Event()

    def slow(source: dict[str, Any]) -> GaussianCloud:
        read.append(source["seed"])
        if source["seed"] == 5:
            assert gate.wait(10)
        if source["seed"] == 6:
            raise ValueError("a broken file")
        return random_cloud(source["seed"])

    monkeypatch.setattr(serving.server, "_load", slow)
    waiting = [serving.renderer(5) for _ in range(3)]
    threads = [
        threading.Thread(target=renderer.render, args=(CAMERA, views(1))) for renderer in waiting
    ]
    for thread in threads:
        thread.start()
    serving.renderer(1).render(CAMERA, views(2))  # not held up
    assert not gate.is_set()
    for _ in range(2):
        with pytest.raises(RenderError, match="ValueError: a broken file"):
            serving.renderer(6).render(CAMERA, views(1))
    gate.set()
    for thread in threads:
        thread.join(10)
        assert not thread.is_alive()
    assert sorted(read) == [1, 5, 6, 6]


def test_a_lost_device_is_told_to_those_who_wait(serve) -> None:
    serving = serve(BatchLost("cpu", RendererCpu))
    with pytest.raises(DeviceError, match="fell off the bus"):
        serving.renderer(1).render(CAMERA, views(1))
    serving.thread.join(5)
    assert not serving.thread.is_alive()


def test_what_is_no_message_ends_its_connection_alone(serve) -> None:
    serving = serve(open_renderer("cpu"))
    for data in (b"\xff\xff\xff\xff", b"\x03\x00\x00\x00abc", b"\x01"):
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as rude:
            rude.connect(serving.address.replace("@", "\0", 1))
            rude.sendall(data)
            rude.shutdown(socket.SHUT_WR)
            assert rude.recv(1) == b""
    serving.renderer(1).render(CAMERA, views(1))


class BatchOnDevice(RendererHost):
    """Pictures of the CPU renderer, on a device."""

    def __init__(self, device: DeviceHost) -> None:
        super().__init__("cpu", RendererCpu)
        self.device, self.traits = device, replace(self.traits, device=device)

    def draw(self, *args, **more):  # type: ignore[no-untyped-def, override]
        found = super().draw(*args, **more)
        for name in ("rgb", "depth", "alpha"):
            if (array := getattr(found, name)) is not None:
                object.__setattr__(found, name, self.device.upload(array))
        return found


def test_pictures_of_a_device_come_through_pinned_memory(serve) -> None:
    shared = serve(BatchOnDevice(DeviceHost()), most=8).renderer(1)
    for count in (3, 20, 3):
        expect_same(
            shared.render(CAMERA, views(count)),
            RendererCpu(random_cloud(1)).render(CAMERA, views(count)),
        )


@pytest.mark.parametrize("most", [64, 3])
@pytest.mark.parametrize("on_device", [False, True])
def test_depth_comes_in_millimetres_beside_the_same_pictures(serve, on_device, most) -> None:
    """Made where the pictures are; with files and without, in batches of any size."""
    batch = BatchOnDevice(DeviceHost()) if on_device else open_renderer("cpu")
    shared = serve(batch, most=most).renderer(1)
    alone = RendererCpu(random_cloud(1)).render(CAMERA, views(7))
    wanted = to_millimetres(alone.depth)
    assert (wanted == 0).any() and (wanted > 0).any()
    found = shared.render(CAMERA, views(7), outputs=("rgb", "depth"), millimetres=True)
    np.testing.assert_array_equal(found.rgb, alone.rgb)
    assert found.depth.dtype == np.uint16
    np.testing.assert_array_equal(found.depth, wanted)
    found = shared.render(CAMERA, views(7)[:2], outputs=("depth",), millimetres=True)
    assert found.rgb is None
    np.testing.assert_array_equal(found.depth, wanted[:2])
    expect_same(shared.render(CAMERA, views(7)), alone)  # metres, as ever
    steps = np.arange(7, dtype=np.int32).tobytes()
    wish = Encode(85, 200_000, (16, 12), 4, 2, steps)
    made = render_files(shared, CAMERA, views(7), wish, None, ("rgb", "depth"))
    np.testing.assert_array_equal(made.pictures["depth"], wanted)
    plain = render_files(shared, CAMERA, views(7), wish)
    assert "depth" not in plain.pictures
    assert (made.files, made.mosaics) == (plain.files, plain.mosaics)
    assert made.files == ([jpeg_of(picture) for picture in alone.rgb] if on_device else [])
    if on_device:
        assert made.hashes["depth"] == [content_hash(depth) for depth in wanted]
        assert plain.hashes["depth"] == []
        assert plain.hashes["rgb"] == made.hashes["rgb"] == [content_hash(p) for p in alone.rgb]
        assert plain.hashes["mosaics"] == made.hashes["mosaics"] and len(plain.mosaics) == 7


def jpeg_of(picture: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=85, subsampling=2)
    return stream.getvalue()


@pytest.mark.parametrize("most", [64, 3])
def test_files_of_views_and_of_what_was_seen_before(serve, most) -> None:
    """Requests go on where the last one ended, whatever the batches and whoever else asks."""
    serving = serve(BatchOnDevice(DeviceHost()), most=most)
    assert serving.server.encodes
    alone = RendererCpu(random_cloud(1)).render(CAMERA, views(7)).rgb
    expected: list[bytes] = []
    laid: list[str] = []
    tiles: list[np.ndarray] = []
    order = [0, 1, 1, 2, 3, 4, 5, 6]  # a turn back shows the same view again
    for number in order:
        mosaic = np.zeros((24, 32, 3), np.uint8)
        for place, tile in enumerate(tiles[::-1][:4]):
            y, x = divmod(place, 2)
            mosaic[y * 12 : y * 12 + 12, x * 16 : x * 16 + 16] = tile
        expected.append(jpeg_of(mosaic))
        laid.append(content_hash(mosaic))
        small = Image.fromarray(alone[number]).resize((16, 12), Image.Resampling.BOX)
        tiles.append(np.asarray(small))

    def walk(renderer: RendererShared) -> None:
        files: list[bytes] = []
        mosaics: list[bytes] = []
        hashes: list[str] = []
        for begin, end, steps in ((0, 4, [0, 1, 1, 2, 3]), (4, 7, [0, 1, 2])):
            wish = Encode(
                85, 200_000, (16, 12), 4, 2, np.array(steps, np.int32).tobytes(), begin == 0
            )
            found = render_files(renderer, CAMERA, views(7)[begin:end], wish)
            np.testing.assert_array_equal(found.pictures["rgb"], alone[begin:end])
            for index, number in enumerate(range(begin, end)):
                wanted = Image.fromarray(alone[number]).resize((16, 12), Image.Resampling.BOX)
                np.testing.assert_array_equal(found.pictures["tiles"][index], np.asarray(wanted))
            files += found.files
            mosaics += found.mosaics
            hashes += found.hashes["mosaics"]
            assert found.hashes["rgb"] == [content_hash(p) for p in alone[begin:end]]
        assert hashes == laid
        assert files == [jpeg_of(picture) for picture in alone]
        assert mosaics == expected

    wrong: list[BaseException] = []

    def attempt(renderer: RendererShared) -> None:
        try:
            walk(renderer)
            walk(renderer)
        except BaseException as error:
            wrong.append(error)

    threads = [threading.Thread(target=attempt, args=(serving.renderer(1),)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong, wrong[0]


def test_files_without_room_are_left_to_who_asked(serve) -> None:
    renderer = serve(BatchOnDevice(DeviceHost())).renderer(1)
    found = render_files(renderer, CAMERA, views(2), Encode(85, 10))
    assert found.files == [] and not found.hashes and found.pictures["rgb"].shape == (2, 36, 48, 3)
    none = serve(open_renderer("cpu")).renderer(1)
    assert render_files(none, CAMERA, views(2), Encode(85, 10**6, (16, 12))).files == []
    bad = Encode(85, 10**5, (16, 12), steps=np.int32([2]).tobytes())
    with pytest.raises(RenderError, match="step 0 has no view 2"):
        render_files(renderer, CAMERA, views(2), bad)
    odd = Encode(85, 10**5, (17, 12), steps=np.int32([0]).tobytes())
    with pytest.raises(RenderError, match="not a multiple"):
        render_files(renderer, CAMERA, views(2), odd)
    assert len(render_files(renderer, CAMERA, views(2), Encode(85, 10**5)).files) == 2


def paint(shown: MapPicture, dots: Dots) -> list[np.ndarray]:
    """The occupancy pictures that are wanted, as the simulator paints them."""
    found = []
    for start, agent in np.frombuffer(dots.places, np.int32).reshape(-1, 2, 2).tolist():
        found.append(np.repeat(shown.pixels[:, :, None], 3, axis=2))
        draw_disc(found[-1], *start, dots.radius, GREEN)
        draw_disc(found[-1], *agent, dots.radius, RED)
    return found


@pytest.mark.parametrize("most", [64, 3])
@pytest.mark.parametrize("encode", [True, False])
@pytest.mark.parametrize("depth", [True, False])
def test_occupancy_pictures_come_with_the_views(serve, most, encode, depth) -> None:
    """Each asks for its own map, of its own size, at the same time; maps are sent once."""
    serving = serve(BatchOnDevice(DeviceHost()), most=most)
    outputs = ("rgb", "depth") if depth else ("rgb",)

    def walk(renderer: RendererShared, seed: int) -> None:
        rng = np.random.default_rng(seed)
        sizes = [(30, 41), (41, 30), (30, 41)]
        for turn in range(4):
            height, width = sizes[(seed + turn // 2) % 3]
            grey = np.random.default_rng(seed + turn // 2).integers(0, 256, (height, width))
            shown = MapPicture.of_pixels(grey.astype(np.uint8))
            places = rng.integers(-3, 40, (turn + 1, 2, 2)).astype(np.int32)
            dots = Dots(places.tobytes(), 3, encode)
            steps = np.arange(5, dtype=np.int32).tobytes()
            wish = Encode(85, 200_000, (16, 12), 4, 2, steps, dots=dots)
            found = render_files(renderer, CAMERA, views(5), wish, None, outputs, shown)
            wanted = paint(shown, dots)
            assert found.hashes["maps"] == [content_hash(picture) for picture in wanted]
            assert found.maps == ([jpeg_of(picture) for picture in wanted] if encode else [])
            assert len(found.files) == len(found.mosaics) == len(found.hashes["mosaics"]) == 5
            assert len(found.hashes["depth"]) == (5 if depth else 0)
            plain = render_files(renderer, CAMERA, views(5), Encode(85, 200_000))
            assert plain.files == found.files and not plain.maps and not plain.hashes["maps"]

    wrong: list[BaseException] = []

    def attempt(renderer: RendererShared, seed: int) -> None:
        try:
            walk(renderer, seed)
        except BaseException as error:
            wrong.append(error)

    threads = [
        threading.Thread(target=attempt, args=(serving.renderer(1), seed)) for seed in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong, wrong[0]


@pytest.mark.parametrize("most", [64, 3])
def test_views_stay_on_the_device_where_files_stand_for_them(serve, most) -> None:
    """They come after all where there was no room for files, or nobody makes any."""
    renderer = serve(BatchOnDevice(DeviceHost()), most=most).renderer(1)
    alone = RendererCpu(random_cloud(1)).render(CAMERA, views(7))
    steps = np.arange(7, dtype=np.int32).tobytes()
    for outputs in (("rgb",), ("depth", "rgb")):
        wish = Encode(85, 200_000, (16, 12), 4, 2, steps)
        whole = render_files(renderer, CAMERA, views(7), wish, None, outputs)
        spare = msgspec.structs.replace(wish, pixels=False)
        found = render_files(renderer, CAMERA, views(7), spare, None, outputs)
        assert found.pictures.keys() == whole.pictures.keys() - {"rgb"}
        for name, array in found.pictures.items():
            np.testing.assert_array_equal(array, whole.pictures[name])
        assert (found.files, found.mosaics, found.hashes) == (
            whole.files, whole.mosaics, whole.hashes,
        )  # fmt: skip
        tight = msgspec.structs.replace(spare, room=10)
        found = render_files(renderer, CAMERA, views(7), tight, None, outputs)
        assert found.files == [] and not found.hashes and found.pictures.keys() == set(outputs)
        np.testing.assert_array_equal(found.pictures["rgb"], alone.rgb)
        if "depth" in outputs:
            np.testing.assert_array_equal(found.pictures["depth"], to_millimetres(alone.depth))
    plain = render_files(serve(open_renderer("cpu")).renderer(1), CAMERA, views(7), spare)
    np.testing.assert_array_equal(plain.pictures["rgb"], alone.rgb)


def test_dots_without_a_map_or_room(serve) -> None:
    renderer = serve(BatchOnDevice(DeviceHost())).renderer(1)
    one = Dots(bytes(16), 3, True)
    with pytest.raises(RenderError, match="without a map"):
        render_files(renderer, CAMERA, views(1), Encode(85, 10**5, dots=one))
    shown = MapPicture.of_pixels(np.random.default_rng(0).integers(0, 256, (40, 40), np.uint8))
    for bad in (Dots(bytes(15), 3, True), Dots(bytes(16), 101, True), Dots(bytes(16), -1, True)):
        with pytest.raises(RenderError, match="without a map"):
            render_files(renderer, CAMERA, views(1), Encode(85, 10**5, dots=bad), shown=shown)
    size = len(render_files(renderer, CAMERA, views(1), Encode(85, 10**5)).files[0])
    tight = render_files(renderer, CAMERA, views(1), Encode(85, size, dots=one), shown=shown)
    assert (tight.files, tight.maps, tight.hashes) == ([], [], {})
    none = render_files(
        renderer, CAMERA, views(1), Encode(85, 10**5, dots=Dots(b"", 3, True)), shown=shown
    )
    assert len(none.files) == 1 and none.maps == none.hashes["maps"] == []
    broken = msgspec.structs.replace(shown, name="broken", shape=(3, 3))
    with pytest.raises(FormatError, match="size differs"):
        render_files(renderer, CAMERA, views(1), Encode(85, 10**5, dots=one), shown=broken)
    plain = serve(open_renderer("cpu")).renderer(1)
    found = render_files(plain, CAMERA, views(1), Encode(85, 10**5, dots=one), shown=shown)
    assert found.files == [] and not found.hashes


FLOOR = OccupancyGrid(np.zeros((16, 16), np.uint8), 0.25, (-2.0, -2.0))


def test_visible_sets_are_found_and_drawn_from_where_the_splats_are(
    serve, tmp_path, monkeypatch
) -> None:
    """The pictures of `RendererVisible`; a scene may have the sets of several floors in turn."""
    monkeypatch.setenv("GN0_CACHE", str(tmp_path))
    serving = serve(BatchWithLimit())
    cloud = random_cloud(1)
    plain = serving.renderer(1)
    other = OccupancyGrid(np.tile(np.uint8([0, 1]), (16, 8)), 0.25, (-2.0, -2.0))
    wanted, shared = [], []
    for floor, height in ((FLOOR, 0.5), (other, 0.5), (FLOOR, 0.7)):
        alone = RendererVisible(RendererCpu(cloud), cloud.content_hash, floor, height, cache=False)
        wanted.append(alone.render(CAMERA, views(4)))
        shared.append(serving.renderer(1).limit_to_visible(cloud.content_hash, floor, height))
    expect_same(wanted[2], RendererCpu(cloud).render(CAMERA, views(4)))  # eyes are too low for it
    assert shared[0].name == "cpu-visible" and shared[0].encoder is None
    found: dict[int, Any] = {}

    def ask(number: int) -> None:
        for _ in range(3):
            found[number] = shared[number].render(CAMERA, views(4))

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for number in range(3):
        expect_same(found[number], wanted[number])
    expect_same(plain.render(CAMERA, views(4)), RendererCpu(cloud).render(CAMERA, views(4)))
    assert list((tmp_path / "visible").rglob("*.set"))


def test_a_floor_that_is_none_is_refused(serve) -> None:
    renderer = serve(open_renderer("cpu")).renderer(1)
    floor = Floor.of_grid("0" * 32, FLOOR, 0.5)
    assert floor.grid.content_hash == FLOOR.content_hash
    bad = msgspec.structs.replace(floor, name="bad", shape=(3, 3))
    with pytest.raises(FormatError, match="size differs"):
        renderer.renderer._connection.draw(
            "scene 1", {"seed": 1}, CAMERA, views(1), ("rgb",), None, floor=bad
        )
    draw = Draw(1, "scene 1", {"seed": 1}, CAMERA, views(1).tobytes(), ("rgb",), None, 1,
                visible=True)  # fmt: skip
    lonely = serve(open_renderer("cpu")).renderer(1).renderer._connection
    lonely._open_area(lay_out(CAMERA, ("rgb",), 1)[1])
    with pytest.raises(RenderError, match="without a floor"):
        lonely._ask(draw)


@pytest.mark.usefixtures("empty_cache")
def test_visible_sets_on_a_device_are_those_of_its_own_renderer(serve, monkeypatch) -> None:
    options = VisibleOptions(pixels=16, places=1)
    limit = RendererBatch.limit_to_visible
    monkeypatch.setattr(
        RendererBatch, "limit_to_visible", lambda own, *args: limit(own, *args, options)
    )
    cloud = random_cloud(1)
    serving = serve(RendererBatch(DeviceHost()))
    shared = serving.renderer(1)
    assert shared.traits.drawn_by == "cuda on host"
    limited = shared.limit_to_visible(cloud.content_hash, FLOOR, 0.5)
    full = RendererCuda(cloud, device=DeviceHost())
    alone = RendererVisibleCuda(full, cloud.content_hash, FLOOR, 0.5, options, cache=False)
    expect_same(limited.render(CAMERA, views(3)), alone.render(CAMERA, views(3)))
    exact = shared.render(CAMERA, views(3))
    expect_same(exact, full.render(CAMERA, views(3)))
    assert serving.server._batch._sets["scene 1"].built


def test_a_scene_that_gave_way_is_read_ahead_again(serve, monkeypatch) -> None:
    """By the thread that hears of it, not by the one that draws; each time once."""
    batch = open_renderer("cpu")
    monkeypatch.setattr("gn0.render.host.KEPT", 1)
    serving = serve(batch)
    by: list[str] = []

    def note(source: dict[str, Any]) -> GaussianCloud:
        by.append(threading.current_thread().name)
        return random_cloud(source["seed"])

    monkeypatch.setattr(serving.server, "_load", note)
    one, other = serving.renderer(1), serving.renderer(2)
    for _ in range(2):
        for seed, renderer in ((1, one), (2, other)):
            expect_same(
                renderer.render(CAMERA, views(2)),
                RendererCpu(random_cloud(seed)).render(CAMERA, views(2)),
            )
    assert len(by) == 4 and serving.thread.name not in by
    one.render(CAMERA, views(1))  # by now the last of them has been let go of
    assert "scene 2" not in serving.server._loading


def test_outputs_lie_apart_in_an_area() -> None:
    places, size = lay_out(CAMERA, ("rgb", "depth"), 3)
    assert places == [0, -(-3 * 48 * 36 * 3 // 64) * 64] and size >= places[1] + 3 * 48 * 36 * 4


def part(x: float, gain: Any = None, cloud: str = "ball", nearer: float = 0.0) -> Instance:
    pose = np.eye(4)
    pose[:3, 3] = x, 0.3, 0.4
    return Instance(cloud, pose, gain, nearer)


def test_moving_parts_are_sent_once_and_drawn_as_they_are_here(serve, monkeypatch) -> None:
    """Poses and gains go over with each request, splats once; the bytes are those drawn here."""
    serving = serve(open_renderer("cpu"))
    ball, other = build_ball(0.2, spacing=0.03), many_shapes(40, seed=3, sh_degree=3)
    shade = np.float32([[0.5, 0.6, 0.7], [0, 0, 0], [0, 0, 0], [0.4, 0.3, 0.2]])
    moving = [(), (part(0.5),), (part(1.0, np.float32([1, 0.5, 0])), part(0.2, shade, "other")),
              (part(-1, shade, nearer=0.3),)] * 10  # fmt: skip
    alone = open_renderer("cpu")
    alone.keep("scene", random_cloud(1))
    taken: list[str] = []
    take = serving.server._take_part
    holders = {}

    def note(connection, sent, fd):  # type: ignore[no-untyped-def]
        taken.append(sent.name)
        holders[connection.number] = connection
        take(connection, sent, fd)

    monkeypatch.setattr(serving.server, "_take_part", note)
    first, second = serving.renderer(1), serving.renderer(1)
    for drawn in (first, second):
        for renderer in (drawn, alone):
            renderer.name_cloud("ball", ball)
            renderer.name_cloud("other", other)
        for _ in range(2):
            found = drawn.render(CAMERA, views(40), parts=moving)
            expect_same(found, alone.render(CAMERA, views(40), "scene", parts=moving))
    assert len(taken) == 4 and len(set(taken)) == 2  # each connection sends each cloud once
    plain = first.render(CAMERA, views(40))
    assert (plain.rgb != found.rgb).any() and (plain.rgb[::4] == found.rgb[::4]).all()
    first.name_cloud("ball", other)  # another cloud under its name: never the old one
    again = first.render(CAMERA, views(3), parts=[part(0.5)])
    expect_same(again, alone.render(CAMERA, views(3), "scene", parts=[part(0.5, cloud="other")]))
    # what is sent under a name again takes the place of what was there: names bound what is held
    assert {tuple(sorted(one.parts)) for one in holders.values()} == {("ball", "other")}
    with pytest.raises(RenderError, match="no cloud is named 'box'"):
        first.render(CAMERA, views(1), parts=[part(0.0, cloud="box")])
    with pytest.raises(RenderError, match="pose is not finite"):
        first.render(CAMERA, views(1), parts=[part(np.nan)])


def test_parts_that_nobody_sent_are_refused(serve) -> None:
    drawn = serve(open_renderer("cpu")).renderer(1)
    connection = drawn.renderer._connection
    drawn.name_cloud("ball", build_ball(0.2, spacing=0.03))
    rows = PartRows.of_parts([(part(0.5),)], {"ball": "0" * 32})
    assert [one.cloud for one in rows.read(1)[0]] == ["0" * 32]

    def draw(sent: PartRows) -> None:
        connection.draw("scene 1", {"seed": 1}, CAMERA, views(1), ("rgb",), None, parts=sent)

    with pytest.raises(RenderError, match="was not sent"):
        draw(rows)
    drawn.render(CAMERA, views(1), parts=[part(0.5)])
    (known,) = connection._clouds
    good = msgspec.structs.replace(rows, clouds=(known,))
    draw(good)
    for field, value, match in (
        ("poses", good.poses[:-8], "shape differs"),
        ("ends", np.int32([2]).tobytes(), "shape differs"),
        ("ends", np.int32([1, 1]).tobytes(), "shape differs"),
        ("cloud_of", np.int32([1]).tobytes(), "shape differs"),
        ("cloud_of", b"\0\0\0", "shape differs"),
        ("ends", good.ends + b"\0", "shape differs"),
        ("poses", np.full(16, np.inf).tobytes(), "not finite"),
    ):
        with pytest.raises((FormatError, RenderError), match=match):
            draw(msgspec.structs.replace(good, **{field: value}))
    for bad in (Cloud("x", -1, 1, False), Cloud("x", 5, 2, False), Cloud("x", 5, 1, True)):
        with pytest.raises(FormatError):
            bad.read(np.zeros(200, np.uint8))
    draw(good)  # who was refused may go on
