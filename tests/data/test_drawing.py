"""One process draws for all: the bytes of before, whoever encodes, whatever is killed."""

from __future__ import annotations

import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gn0.data import cache_webdataset, part, picture_cache
from gn0.data.build import build_dataset
from gn0.data.dataset import load_dataset_file, open_dataset
from gn0.data.drawing_process import choose_drawing, count_workers, open_drawing, with_backend
from gn0.data.episode_frames import read_frames
from gn0.data.part_pictures import look_ahead
from gn0.data.picture_build import choose_cache, render_dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.data.verify import verify_dataset
from gn0.errors import ConfigError, DataError, DeviceError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.missions.goal import sample_goal_episodes
from gn0.render.share.connection import DrawConnection
from gn0.render.share.server_process import DrawServer
from gn0.scenes.folder import load_scene
from gn0.sim import presets
from gn0.suites import scene_drawing
from gn0.suites.scene_drawing import LOADER
from gn0.suites.suite import Suite, save_suite
from gn0_trials import people_samples

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Unix sockets")

PROGRAM = """
import sys
from gn0.suites import scene_drawing
from gn0.data import build
from gn0.data.settings import BuildSettings
scene_drawing.SHARED = frozenset({"cpu"})
build.build_dataset(sys.argv[1], sys.argv[2], BuildSettings(chunk=1), workers=2)
"""


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> None:
    """Datasets of the CPU backend are drawn by one process as well."""
    monkeypatch.setattr(scene_drawing, "SHARED", frozenset({"cpu", "cuda"}))


@pytest.fixture(scope="session")
def walks(data_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """Three walks, two of them in evening light."""
    scene = load_scene(data_suite.scene_folder("example-flat"))
    return save_suite(
        tmp_path_factory.mktemp("short") / "suite", [scene], data_suite.episodes[:3], name="short",
        max_steps=60,
    )  # fmt: skip


@pytest.fixture(scope="session")
def alone(walks: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of those walks, drawn by the worker itself."""
    out = tmp_path_factory.mktemp("alone") / "d"
    build_dataset(walks, out, BuildSettings(chunk=1))
    return out


@pytest.mark.usefixtures("served")
@pytest.mark.parametrize(
    ("workers", "batch"),
    [(2, 7), *(pytest.param(*few, marks=pytest.mark.slow) for few in ((1, 0), (4, 1)))],
)
def test_one_process_that_draws_gives_the_same_bytes(
    walks, alone, tmp_path, files_of, workers, batch
) -> None:
    build_dataset(walks, tmp_path / "d", BuildSettings(chunk=1), workers=workers, batch=batch)
    assert files_of(tmp_path / "d") == files_of(alone)


@pytest.mark.usefixtures("served")
def test_pictures_are_drawn_again_by_the_process_that_draws(alone, tmp_path, files_of) -> None:
    import shutil

    folder = Path(shutil.copytree(alone, tmp_path / "d"))
    shutil.rmtree(folder / "pictures")
    render_dataset(folder, workers=2)
    assert files_of(folder) == files_of(alone)


@pytest.mark.slow
@pytest.mark.usefixtures("served")
def test_pixels_are_compared_by_the_process_that_draws(alone, monkeypatch) -> None:
    """One device for all workers, and no file is encoded that nobody reads."""
    servers: list[DrawServer] = []
    entered = DrawServer.__enter__

    def enter(server: DrawServer) -> DrawServer:
        servers.append(entered(server))
        return servers[-1]

    monkeypatch.setattr(DrawServer, "__enter__", enter)
    report = verify_dataset(alone, pixels=True, workers=2)
    assert report.ok and report.pixels == open_dataset(alone).about.rows
    with DrawServer("cpu", LOADER) as server:
        assert verify_dataset(alone, pixels=True, workers=2, server=server).ok
    assert len(servers) == 2 and servers[1] is server


@pytest.mark.slow
@pytest.mark.usefixtures("served")
def test_visible_sets_give_the_same_bytes_whoever_draws(
    walks, long_walk, tmp_path, files_of, monkeypatch
) -> None:
    """The sets are found by the drawing process; the dataset says that they were used."""
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    few = save_suite(tmp_path / "few", [load_scene(walks.scene_folder("example-flat"))],
                     [long_walk], name="few")  # fmt: skip
    settings = BuildSettings(pictures=PictureSettings(visible_sets=True))
    build_dataset(few, tmp_path / "shared", settings)
    assert list((tmp_path / "cache" / "visible").rglob("*.set"))
    monkeypatch.setattr(scene_drawing, "SHARED", frozenset({"cuda"}))
    build_dataset(few, tmp_path / "alone", settings)
    assert files_of(tmp_path / "shared") == files_of(tmp_path / "alone")
    assert verify_dataset(tmp_path / "shared", pixels=True).ok
    build_dataset(few, tmp_path / "exact", BuildSettings())
    shard = "pictures/webdataset/example-flat-0000.tar"
    assert files_of(tmp_path / "exact")[shard] != files_of(tmp_path / "shared")[shard]


@pytest.mark.slow
def test_a_build_that_was_killed_goes_on(walks, alone, tmp_path, files_of) -> None:
    out = tmp_path / "d"
    for wait in (2.5, 4.0):  # in the midst of it, or so
        command = [sys.executable, "-c", PROGRAM, str(walks.folder), str(out)]
        with subprocess.Popen(command, start_new_session=True) as process:
            time.sleep(wait)
            process.send_signal(signal.SIGKILL)
    process = subprocess.run(command, check=True, timeout=120)
    assert files_of(out) == files_of(alone)


@pytest.mark.usefixtures("served")
def test_a_drawing_process_that_dies_is_said_and_the_build_goes_on(
    walks, alone, tmp_path, files_of, monkeypatch
) -> None:
    written = part.write_part
    servers: list[DrawServer] = []
    entered = DrawServer.__enter__

    def enter(server: DrawServer) -> DrawServer:
        servers.append(entered(server))
        return servers[-1]

    def write(*args):
        if len(servers) == 1:
            os.kill(servers[0].pid, signal.SIGKILL)
        return written(*args)

    monkeypatch.setattr(DrawServer, "__enter__", enter)
    monkeypatch.setattr(part, "write_part", write)
    with pytest.raises(DeviceError, match="drawing process is gone") as caught:
        build_dataset(walks, tmp_path / "d", BuildSettings(chunk=1))
    assert "same command again" in caught.value.remedy
    build_dataset(walks, tmp_path / "d", BuildSettings(chunk=1))
    assert files_of(tmp_path / "d") == files_of(alone)


@pytest.mark.usefixtures("served")
def test_a_slow_encoder_holds_the_views_back(walks, tmp_path, monkeypatch) -> None:
    """What waits is bounded; and the bytes are right, however slow encoding is."""
    from gn0.data import part_pictures

    waiting, most, encoded = [0], [0], [0]
    ahead, encode = part_pictures.look_ahead, picture_cache.encode_picture

    def counted(source, limit):
        def items():
            for item in source:
                waiting[0] += 1
                most[0] = max(most[0], waiting[0])
                yield item

        for item in ahead(items(), limit):
            waiting[0] -= 1
            yield item

    def slow(*args):
        encoded[0] += 1
        if encoded[0] < 10:
            time.sleep(0.1)
        return encode(*args)

    monkeypatch.setattr(part_pictures, "look_ahead", counted)
    monkeypatch.setattr(part_pictures, "AHEAD", 3)
    monkeypatch.setattr(picture_cache, "encode_picture", slow)
    build_dataset(walks, tmp_path / "d", BuildSettings())
    assert 3 <= most[0] <= 3 + 2  # one in each hand


def test_looking_ahead_keeps_order_bounds_and_errors() -> None:
    made: list[int] = []

    def count():
        for number in range(100):
            made.append(number)
            yield number
        raise ValueError("the end")

    items = look_ahead(count(), 4)
    assert [next(items) for _ in range(3)] == [0, 1, 2]
    time.sleep(0.2)
    assert len(made) <= 3 + 4 + 1
    before = threading.active_count()
    items.close()
    assert threading.active_count() == before - 1
    with pytest.raises(ValueError, match="the end"):
        list(look_ahead(count(), 4))


def test_the_dataset_says_who_drew_it(alone, walks, tmp_path) -> None:
    assert b"backend" not in (alone / "dataset.json").read_bytes()
    drawn = with_backend(PictureSettings(), "cuda")
    assert drawn.drawn_by == "cuda" and PictureSettings().drawn_by == "cpu"
    about = load_dataset_file(alone)
    settings = msgspec.structs.replace(about.settings, pictures=drawn)
    encoded = msgspec.json.encode(msgspec.to_builtins(settings))
    assert msgspec.json.decode(encoded, type=BuildSettings) == settings
    with pytest.raises(DataError, match="drawn by backend 'cpu'; those of 'cuda'") as caught:
        choose_cache(open_dataset(alone), drawn)
    assert "leave --backend out, or give cpu" in caught.value.remedy
    assert choose_drawing("auto", alone) == ("cpu", "the dataset was begun with it")
    assert choose_drawing("cuda", alone)[0] == "cuda"
    assert PictureSettings(visible_sets=True, backend="cuda").visible_sets


def test_workers_are_as_many_as_cores_where_a_gpu_draws() -> None:
    drawn = with_backend(PictureSettings(), "cuda")
    assert count_workers(3, drawn) == 3
    assert count_workers(0, PictureSettings()) == 1
    assert count_workers(0, drawn) >= 1
    assert count_workers(0, msgspec.structs.replace(drawn, layout="none")) == 1


def test_machines_of_a_cluster_do_not_share_this_gpu() -> None:
    drawn = with_backend(PictureSettings(), "cuda")
    with (
        pytest.raises(ConfigError, match="cannot use this one's GPU"),
        open_drawing(drawn, executor="ray"),
    ):
        pass


def test_a_backend_that_is_not_here_is_named_with_the_reason(
    walks, tmp_path, monkeypatch, files_of
) -> None:
    monkeypatch.setenv("GN0_DEVICE", "cuda:99")
    drawn = BuildSettings(pictures=with_backend(PictureSettings(), "cuda"))
    with pytest.raises(DataError, match="backend 'cuda', which does not run here") as caught:
        build_dataset(walks, tmp_path / "d", drawn)
    assert "doctor" in caught.value.remedy or "cpu" in caught.value.remedy


def test_a_server_that_is_gone_cannot_be_reached() -> None:
    with DrawServer("cpu", LOADER) as server:
        address = server.address
        DrawConnection(address).close()
    with pytest.raises(DeviceError, match="cannot be reached"):
        DrawConnection(address)


@pytest.fixture(scope="module")
def long_walk(walks) -> Episode:
    """An episode of more views than a mosaic holds, in evening light."""
    scene = load_scene(walks.scene_folder("example-flat"))
    navigation = NavigationMap(scene.grid, 0.2)
    (episode,) = sample_goal_episodes(
        scene, navigation, 1, 3, minimum_length=4.0, maximum_length=6.0
    )
    light = walks.episodes[1].light
    return msgspec.structs.replace(episode, path_id="long", split="train", light=light)


class BatchOnHost:
    """The CPU's pictures on an emulated device, so that files are made there as on a GPU."""

    name = "cuda"

    def __init__(self) -> None:
        from gn0.device.host import DeviceHost
        from gn0.render.open import open_renderer

        self.device, self._batch = DeviceHost(), open_renderer("cpu")
        self.traits = replace(self._batch.traits, drawn_by="cuda on host", device=self.device)
        self.add, self.holds, self.prepare = (
            self._batch.add, self._batch.holds, self._batch.prepare
        )  # fmt: skip
        self.name_cloud = self._batch.name_cloud

    def draw(self, *args, **more):  # type: ignore[no-untyped-def]
        found = self._batch.draw(*args, **more)
        for name in ("rgb", "depth"):
            if (array := getattr(found, name)) is not None:
                object.__setattr__(found, name, self.device.upload(array))
        return found


def serve_here(batch: Any) -> tuple[socket.socket, str]:
    """A server in threads of this process: its listener and its address."""
    from gn0.render.share.server import Server, open_listener

    server = Server(batch, scene_drawing.load_look)
    listener, address = open_listener()
    threading.Thread(target=server.listen, args=(listener,), daemon=True).start()
    threading.Thread(target=server.serve, daemon=True).start()
    return listener, address


def start_at(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let that server stand for every one that is started."""

    def enter(own: DrawServer) -> DrawServer:
        own.address, own.card = address, "emulated"
        return own

    monkeypatch.setattr(DrawServer, "__enter__", enter)
    monkeypatch.setattr(DrawServer, "end", lambda own: None)


@pytest.fixture
def small_camera(monkeypatch: pytest.MonkeyPatch) -> str:
    """Name of a camera of 48x36, which the emulation draws in a moment."""
    from gn0.missions.episode import AgentSpec
    from gn0.render.camera import Camera
    from gn0.sim import presets

    small = Camera.from_hfov(48, 36, 90.0)
    preset = presets.CameraPreset(name="small", rgb=small, depth=small, agent=AgentSpec())
    monkeypatch.setitem(presets._BY_NAME, "small", preset)
    return "small"


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_a_dataset_of_visible_sets_found_on_a_device_is_drawn_again_from_them(
    walks, tmp_path, monkeypatch, files_of, small_camera
) -> None:
    """Found again when the cache is gone, with the same bytes; and not those of all splats."""
    from gn0.device.host import DeviceHost
    from gn0.render.cuda.batch import RendererBatch
    from gn0.render.visible_places import VisibleOptions

    monkeypatch.setenv("GN0_DEVICE", "host")
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    few_looks = VisibleOptions(pixels=24, places=1)
    limit = RendererBatch.limit_to_visible
    monkeypatch.setattr(
        RendererBatch, "limit_to_visible", lambda own, *args: limit(own, *args, few_looks)
    )
    scene = load_scene(walks.scene_folder("example-flat"))
    shortest = min(walks.episodes, key=lambda e: math.dist(e.start[:2], e.goal))
    few = save_suite(tmp_path / "few", [scene], [shortest], name="few", camera=small_camera)
    drawn = with_backend(PictureSettings(visible_sets=True), "cuda")
    first, again = RendererBatch(DeviceHost()), RendererBatch(DeviceHost())
    listener, address = serve_here(first)
    start_at(address, monkeypatch)
    build_dataset(few, tmp_path / "d", BuildSettings(pictures=drawn))
    made = files_of(tmp_path / "d")
    assert b'"visible_sets": true' in made["dataset.json"]
    assert sum(sets.built for sets in first._sets.values()) > 2
    listener.close()
    shutil.rmtree(tmp_path / "d" / "pictures")
    shutil.rmtree(tmp_path / "cache" / "visible")
    listener, address = serve_here(again)
    start_at(address, monkeypatch)
    render_dataset(tmp_path / "d")
    assert files_of(tmp_path / "d") == made
    assert verify_dataset(tmp_path / "d", pixels=True).ok
    exact = with_backend(PictureSettings(), "cuda")
    build_dataset(few, tmp_path / "exact", BuildSettings(pictures=exact))
    shard = "pictures/webdataset/example-flat-0000.tar"
    assert files_of(tmp_path / "exact")[shard] != made[shard]
    listener.close()


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
@pytest.mark.parametrize(
    ("maps", "depth"), [("once", True), ("once", False), ("every", True), ("every", False)]
)
def test_files_made_on_a_device_are_the_bytes_of_before(
    walks, long_walk, alone, tmp_path, files_of, monkeypatch, maps, depth
) -> None:
    """A whole dataset with its pictures encoded and hashed by kernels: no byte of a shard differs.

    Nor of its depth, which a kernel makes millimetres of. Nothing is left to the worker but what
    an episode has once: what its goal looks like, and the map from above.
    """
    from gn0.data import part_pictures, sample_pictures
    from gn0.render.share.client import SceneEncoder

    listener, address = serve_here(BatchOnHost())
    made, maps_made, left = [0], [0], [0]
    render_files, encode = SceneEncoder.render_files, picture_cache.encode_picture

    def counted(*args):
        found = render_files(*args)
        made[0] += len(found.mosaics)
        maps_made[0] += len(found.hashes["maps"])
        assert len(found.maps) == (len(found.hashes["maps"]) if maps == "every" else 0)
        return found

    def encoded_here(*args):
        left[0] += 1
        return encode(*args)

    monkeypatch.setattr(SceneEncoder, "render_files", counted)
    start_at(address, monkeypatch)
    few = save_suite(tmp_path / "few", [load_scene(walks.scene_folder("example-flat"))],
                     [long_walk], name="few")  # fmt: skip
    settings = BuildSettings(pictures=PictureSettings(quality=85, depth=depth, maps=maps))
    build_dataset(few, tmp_path / "cpu", settings)
    drawn = msgspec.structs.replace(settings, pictures=with_backend(settings.pictures, "cuda"))
    for module in (picture_cache, cache_webdataset):  # what goals look like is put into the shard
        monkeypatch.setattr(module, "encode_picture", encoded_here)
    built = build_dataset(few, tmp_path / "cuda", drawn)
    assert made[0] == built.about.rows > 16
    assert made[0] >= maps_made[0] > 8  # a turn leaves the dots where they are
    assert left[0] == (2 if maps == "every" else 1)
    assert verify_dataset(tmp_path / "cuda", pixels=True).ok  # hashed by the worker, from pixels
    assert made[0] == built.about.rows
    build_dataset(few, tmp_path / "again", drawn)
    assert files_of(tmp_path / "again") == files_of(tmp_path / "cuda")
    listener.close()
    one, other = files_of(tmp_path / "cpu"), files_of(tmp_path / "cuda")
    shards = [name for name in one if name.endswith((".tar", ".index.parquet", ".png", ".jpg"))]
    assert shards and all(one[name] == other[name] for name in shards)
    assert b'"backend": "cuda"' in other["dataset.json"]
    assert sample_pictures.BATCH == 32 and part_pictures.AHEAD == 64


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_files_of_people_made_on_a_device_are_the_bytes_of_before(
    small_camera, tmp_path, files_of, monkeypatch
) -> None:
    """With people in the views, and a history that is black where somebody is followed."""
    from gn0.render.share.client import SceneEncoder

    camera = msgspec.structs.replace(
        presets.find_preset(small_camera), agent=people_samples.BODY, history_tile=(12, 9)
    )
    monkeypatch.setitem(presets._BY_NAME, small_camera, camera)
    monkeypatch.setattr(people_samples, "CAMERA", small_camera)
    bank = people_samples.save_bank(tmp_path / "bank")
    suite = people_samples.save_peopled(tmp_path / "suite", bank)
    listener, address = serve_here(BatchOnHost())
    start_at(address, monkeypatch)
    made, render_files = [0], SceneEncoder.render_files

    def counted(*args):
        found = render_files(*args)
        made[0] += len(found.mosaics)
        return found

    monkeypatch.setattr(SceneEncoder, "render_files", counted)
    settings = BuildSettings(pictures=PictureSettings(depth=True))
    build_dataset(suite, tmp_path / "cpu", settings, bank=bank)
    drawn = msgspec.structs.replace(settings, pictures=with_backend(settings.pictures, "cuda"))
    built = build_dataset(suite, tmp_path / "cuda", drawn, bank=bank)
    assert made[0] == built.about.rows >= 30
    assert verify_dataset(tmp_path / "cuda", pixels=True).ok
    listener.close()
    one, other = files_of(tmp_path / "cpu"), files_of(tmp_path / "cuda")
    same = [name for name in one if name.endswith((".tar", ".index.parquet", ".parquet"))]
    assert len(same) >= 4 and all(one[name] == other[name] for name in same)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
@pytest.mark.parametrize("maps", ["once", "every"])
def test_what_had_no_room_is_made_by_the_worker(
    walks, long_walk, tmp_path, files_of, monkeypatch, maps
) -> None:
    """In the midst of a walk: its mosaics go on."""
    from gn0.data import sample_pictures
    from gn0.render.share.client import SceneEncoder

    listener, address = serve_here(BatchOnHost())
    start_at(address, monkeypatch)
    few = save_suite(tmp_path / "few", [load_scene(walks.scene_folder("example-flat"))],
                     [long_walk], name="few")  # fmt: skip
    render_files = SceneEncoder.render_files
    made: list[bool] = []

    def cramped(own, camera, views, wish, *args):
        if len(made) % 2:
            wish = msgspec.structs.replace(wish, room=1000)
        found = render_files(own, camera, views, wish, *args)
        made.append(bool(found.files))
        return found

    drawn = with_backend(PictureSettings(maps=maps), "cuda")
    build_dataset(few, tmp_path / "roomy", BuildSettings(pictures=drawn))
    monkeypatch.setattr(SceneEncoder, "render_files", cramped)
    monkeypatch.setattr(sample_pictures, "BATCH", 5)
    build_dataset(few, tmp_path / "cramped", BuildSettings(pictures=drawn))
    listener.close()
    assert made[:4] == [True, False, True, False]
    assert files_of(tmp_path / "cramped") == files_of(tmp_path / "roomy")


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_maps_too_large_for_a_device_are_painted_by_the_worker(
    walks, long_walk, tmp_path, files_of, monkeypatch
) -> None:
    from gn0.data import part_pictures

    listener, address = serve_here(BatchOnHost())
    start_at(address, monkeypatch)
    few = save_suite(tmp_path / "few", [load_scene(walks.scene_folder("example-flat"))],
                     [long_walk], name="few")  # fmt: skip
    pictures = with_backend(PictureSettings(maps="every"), "cuda")
    for name, most in (("painted", part_pictures.PAINTED), ("left", 10)):
        monkeypatch.setattr(part_pictures, "PAINTED", most)
        build_dataset(few, tmp_path / name, BuildSettings(pictures=pictures))
    listener.close()
    assert files_of(tmp_path / "painted") == files_of(tmp_path / "left")


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
def test_a_dataset_drawn_on_a_device_is_drawn_again_there_alone(
    walks, tmp_path, monkeypatch, files_of, small_camera
) -> None:
    """End to end on the emulation, with pictures of 48x36."""
    monkeypatch.setenv("GN0_DEVICE", "host")
    scene = load_scene(walks.scene_folder("example-flat"))
    shortest = min(walks.episodes, key=lambda e: math.dist(e.start[:2], e.goal))
    few = save_suite(tmp_path / "few", [scene], [shortest], name="few", camera=small_camera)
    backend, why = choose_drawing("auto", tmp_path / "d")
    assert backend == "cuda" and why
    settings = BuildSettings(pictures=with_backend(PictureSettings(depth=True), backend))
    built = build_dataset(few, tmp_path / "d", settings)
    first = files_of(tmp_path / "d")
    shutil.rmtree(tmp_path / "d" / "pictures")
    render_dataset(tmp_path / "d")
    assert files_of(tmp_path / "d") == first
    assert verify_dataset(tmp_path / "d", pixels=True).ok
    frame = next(read_frames(built, built.sampled[0], ("rgb", "depth"), exact=True))
    assert frame["rgb"].shape == (36, 48, 3)
    stored = next(read_frames(built, built.sampled[0], ("depth",)))["depth"]
    assert 0 < np.abs(stored - frame["depth"]).max() < 0.0005 + 1e-5
    monkeypatch.setenv("GN0_DEVICE", "none")
    built.kept.clear()
    with pytest.raises(DataError, match="drawn by backend 'cuda', which does not run here"):
        next(read_frames(built, built.sampled[0], ("rgb",), exact=True))
    shutil.rmtree(tmp_path / "d" / "pictures")
    with pytest.raises(DataError, match="backend 'cuda', which does not run here"):
        render_dataset(tmp_path / "d")
    assert not verify_dataset(tmp_path / "d").damages
