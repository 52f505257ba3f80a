"""Figures of datasets drawn on a GPU: full samples a second, and what 47 million would take."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import msgspec
import numpy as np
from PIL import Image

from gn0.data.build import build_dataset
from gn0.data.drawing_process import count_workers, with_backend
from gn0.data.picture_cache import encode_depth, encode_picture
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.device.device import DeviceArray
from gn0.geometry import view_from_pose
from gn0.jobs.process import count_cores
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.depth import scale_on_device
from gn0.render.encoding import Dots, MapPicture
from gn0.render.renderer import Output
from gn0.render.share.digest import Mosaics, digest_on_device
from gn0.render.share.jpeg import JpegEncoder
from gn0.render.share.maps import MapPainter
from gn0.render.share.messages import Tally
from gn0.render.share.server_process import DrawServer
from gn0.scenes.folder import load_scene, save_scene
from gn0.scenes.scene import Scene
from gn0.sim.history import build_mosaic, reduce_picture
from gn0.sim.presets import find_preset
from gn0.storage import content_hash
from gn0.suites.scene_drawing import LOADER
from gn0.suites.suite import Suite, build_suite, load_suite
from gn0_figures.board import Figure, FigureContext, FigureRow, FigureSkipped, row_at_least
from gn0_figures.device import describe_device, is_emulation

SAMPLES = 47_000_000  # of the paper
LEAST = 3000.0  # full samples/s
GAUSSIANS = 300_000
QUALITY = 85
EPISODES = 600  # about 30,000 samples: ten seconds at the rate that is wanted
VIEWS = 256
Maps = Literal["every", "once"]
EVERY: tuple[Maps, bool] = ("every", False)  # maps, and whether depth is stored
ONCE: tuple[Maps, bool] = ("once", False)
EVERY_DEEP: tuple[Maps, bool] = ("every", True)
MAP = 512  # px: the map pictures that single costs are measured on


def build_walked_scene(ctx: FigureContext, *, tiny: bool) -> Scene:
    """The apartment in `--scenes`, else one made now with `GAUSSIANS` splats; tiny: a room."""
    if tiny:
        from gn0.testing.scenes import build_room_scene

        return build_room_scene()
    if ctx.scenes is not None and (ctx.scenes / "apartment-300k").is_dir():
        return load_scene(ctx.scenes / "apartment-300k")
    from gn0.scenes.procedural.finish import floor_area
    from gn0.scenes.procedural.generate import GenerateSettings, build_generated
    from gn0.scenes.procedural.kinds import KINDS

    area = floor_area(KINDS["apartment"].draft(7, size="medium", style=None))
    settings = GenerateSettings(kind="apartment", seed=7, density=GAUSSIANS / area, light="draft")
    return build_generated(settings, "apartment", ctx.progress)


def build_wide_scene(ctx: FigureContext) -> Scene:
    """The warehouse in `--scenes`, else one made now, thinned to `GAUSSIANS`: a map of 606x512."""
    if ctx.scenes is not None and (ctx.scenes / "warehouse-300k").is_dir():
        return load_scene(ctx.scenes / "warehouse-300k")
    from gn0.scenes.procedural.generate import GenerateSettings, build_generated

    settings = GenerateSettings(
        kind="warehouse", seed=7, size="large", density=1000.0, light="draft"
    )
    scene = build_generated(settings, "warehouse", ctx.progress)
    keep = np.random.default_rng(0).permutation(len(scene.gaussians))[:GAUSSIANS]
    thin = scene.gaussians.select(np.sort(keep))
    return replace(scene, load_cloud=lambda: thin, cloud_hash="")


class _Clock:
    """Hears how many samples are done, and when."""

    def __init__(self, progress: Callable[[str, int, int], None]) -> None:
        self._progress = progress
        self.heard: list[tuple[float, int]] = []

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Take note of it, and pass it on."""
        self._progress(stage, done, total)
        if stage == "samples":
            self.heard.append((time.perf_counter(), done))

    def rate(self) -> float:
        """Samples a second from the first tenth of them to the last nine tenths."""
        last = self.heard[-1][1]
        middle = [(at, done) for at, done in self.heard if 0.1 * last <= done <= 0.9 * last]
        if len(middle) < 2:
            (first, none), (end, done) = self.heard[0], self.heard[-1]
            return (done - none) / max(end - first, 1e-9)
        (begin, few), (end, many) = middle[0], middle[-1]
        return (many - few) / max(end - begin, 1e-9)


def _build(
    ctx: FigureContext, suite: Suite, pictures: PictureSettings, server: DrawServer, name: str
) -> tuple[float, float, int, Tally]:
    """Rates of a whole build, its samples, and what the process that drew did."""
    clock = _Clock(ctx.progress)
    before, begin = server.tally, time.perf_counter()
    dataset = build_dataset(
        suite, ctx.work / name, BuildSettings(chunk=4, pictures=pictures),
        workers=count_workers(0, pictures), server=server, progress=clock,
    )  # fmt: skip
    seconds = time.perf_counter() - begin
    spent = {
        field: getattr(server.tally, field) - getattr(before, field)
        for field in Tally.__struct_fields__
    }
    rows = dataset.about.rows
    return clock.rate(), rows / seconds, rows, Tally(**spent)


def _median_ms(call: Callable[[], object], rounds: int = 15) -> float:
    call()
    spent = []
    for _ in range(rounds):
        begin = time.perf_counter()
        call()
        spent.append(time.perf_counter() - begin)
    return float(np.median(spent)) * 1e3


def measure_stages(ctx: FigureContext, scene: Scene) -> list[FigureRow]:
    """What one sample costs in each stage: on the device, and on one core."""
    device, tiny = ctx.device, is_emulation(ctx.device)
    preset = find_preset("gn_bench")
    camera = preset.rgb if not tiny else preset.rgb.from_hfov(160, 120, 90.0)
    views_count = 2 if tiny else VIEWS
    batch = RendererBatch(device)
    batch.add("scene", lambda: scene.gaussians)
    rng = np.random.default_rng(0)
    rows_, cols = np.nonzero(scene.grid.cells == 0)
    picked = rng.integers(0, len(rows_), views_count)
    views = np.stack([
        view_from_pose(
            scene.grid.origin[0] + (cols[i] + 0.5) * scene.grid.resolution,
            scene.grid.origin[1] + (rows_[i] + 0.5) * scene.grid.resolution,
            1.3, float(rng.uniform(-3, 3)), 0.0,
        )
        for i in picked
    ])  # fmt: skip
    encoder = JpegEncoder(device)

    def draw(outputs: tuple[Output, ...] = ("rgb",)) -> Any:
        found = batch.draw(camera, views, "scene", outputs=outputs)
        device.synchronize()
        return found

    rounds = 1 if tiny else 7
    pictures = draw()
    tiles = encoder.reduce(pictures.rgb, 160, 120)
    size = tiles.nbytes // views_count
    table = tiles.pointer + np.uint64(size) * rng.integers(
        0, views_count, (views_count, 16)
    ).astype(np.uint64)  # fmt: skip

    def encode() -> None:
        encoder.encode(pictures.rgb, QUALITY)
        encoder.reduce(pictures.rgb, 160, 120)
        encoder.encode_mosaics(table, (160, 120), 4, QUALITY)
        device.synchronize()

    def digest() -> None:
        digest_on_device(device, [pictures.rgb, Mosaics(table, (160, 120), 4)])
        device.synchronize()

    cells = rng.choice(np.array([0, 127, 255], np.uint8), (MAP // 16, MAP // 16))
    bare = MapPicture.of_pixels(np.kron(cells, np.ones((16, 16), np.uint8)))
    places = rng.integers(0, MAP, (views_count, 2, 2)).astype(np.int32)
    painter, dots = MapPainter(device), Dots(places.tobytes(), 3, encode=True)

    def paint() -> DeviceArray:
        (painted,) = painter.paint([(bare, dots)])
        device.synchronize()
        return painted.pictures

    maps = paint()

    def encode_maps() -> None:
        encoder.encode(maps, QUALITY)
        device.synchronize()

    def digest_all() -> None:
        digest_on_device(device, [pictures.rgb, Mosaics(table, (160, 120), 4), maps])
        device.synchronize()

    where = f"{describe_device(device)}; {views_count} views {camera.width}x{camera.height} a call"
    found = [
        ("draw, on the device", _median_ms(draw, rounds) / views_count, where),
        (
            "JPEG of view and mosaic, on the device",
            _median_ms(encode, rounds) / views_count,
            f"{where}, quality {QUALITY}, byte for byte libjpeg's",
        ),
        (
            "digests of view and mosaic, on the device",
            _median_ms(digest, rounds) / views_count,
            f"{where}, blake2b of the raw pixels, a thread a picture",
        ),
        (
            f"occupancy picture {MAP}x{MAP} painted, on the device",
            _median_ms(paint, rounds) / views_count,
            f"{where}, a map and two dots",
        ),
        (
            f"JPEG of an occupancy picture {MAP}x{MAP}, on the device",
            _median_ms(encode_maps, rounds) / views_count,
            f"{where}, quality {QUALITY}; squares of 16 px at random",
        ),
        (
            "digests of view, mosaic and occupancy picture, on the device",
            _median_ms(digest_all, rounds) / views_count,
            f"{where}, in one launch",
        ),
    ]
    deep: tuple[Output, ...] = ("rgb", "depth")
    depth = draw(deep).depth
    found.append((
        "draw with depth, on the device",
        _median_ms(lambda: draw(deep), rounds) / views_count, where,
    ))  # fmt: skip

    def scale() -> None:
        scale_on_device(device, depth)
        device.synchronize()

    found.append((
        "depth to millimetres, on the device", _median_ms(scale, rounds) / views_count, where,
    ))  # fmt: skip
    millimetres = np.array(scale_on_device(device, depth).numpy()[0])
    target = device.pinned(pictures.rgb.shape, np.uint8)
    found.append((
        "copy of the view to pinned memory",
        _median_ms(lambda: device.download(pictures.rgb, target), rounds) / views_count,
        where,
    ))  # fmt: skip
    rgb = np.array(pictures.rgb.numpy()[0])
    mosaic = build_mosaic([reduce_picture(rgb, 160, 120)] * 16)
    square = np.asarray(Image.fromarray(rgb).resize((MAP, MAP)))
    settings = PictureSettings(quality=QUALITY)
    core = "one core of this machine, Pillow"
    for name, picture in (("view", rgb), ("mosaic", mosaic), (f"map {MAP}x{MAP}", square)):
        found.append((
            f"JPEG of a {name}, on a core",
            _median_ms(lambda p=picture: encode_picture(p, settings)),  # type: ignore[misc]
            f"{core}, quality {QUALITY}",
        ))  # fmt: skip
    found.append((
        "PNG of a depth picture, on a core",
        _median_ms(lambda: encode_depth(millimetres)),
        f"one core of this machine, zlib; {len(encode_depth(millimetres)) / 1e3:.0f} kB",
    ))  # fmt: skip
    found.append((
        "digests of view, mosaic and occupancy picture, on a core",
        _median_ms(lambda: [content_hash(p) for p in (rgb, mosaic, square)]),
        "one core of this machine, blake2b of the raw pixels",
    ))  # fmt: skip
    stream = io.BytesIO()
    found.append((
        "writing a sample, on a core",
        _median_ms(lambda: (stream.seek(0), stream.write(bytes(80_000)))),
        "80 kB into memory",
    ))  # fmt: skip
    return [FigureRow(name=f"{n}, a sample", value=ms, unit="ms", detail=d) for n, ms, d in found]


def measure_gpu(ctx: FigureContext) -> list[FigureRow]:
    """A whole build on the GPU: walks, labels, drawing, hashing, encoding, writing.

    In a scene whose map has the size of the paper's bird's-eye views, with a map in every sample.
    """
    tiny = is_emulation(ctx.device)
    rows = measure_stages(ctx, build_walked_scene(ctx, tiny=tiny))
    for row in rows:
        ctx.report(row)
    if tiny:  # a dry run: a walk of 480x360 views would take hours on the emulation
        return rows
    save_scene(build_wide_scene(ctx), ctx.work / "wide")
    with DrawServer("cuda", LOADER) as server:
        rows += _measure_builds(ctx, server, "wide", (EVERY,), EPISODES // 2)
    return rows


def measure_others(ctx: FigureContext) -> list[FigureRow]:
    """The same of a smaller scene, with maps once, and with depth."""
    if is_emulation(ctx.device):
        raise FigureSkipped("a walk of 480x360 views would take hours on the emulation")
    save_scene(build_walked_scene(ctx, tiny=False), ctx.work / "scene")
    save_scene(build_wide_scene(ctx), ctx.work / "wide")
    with DrawServer("cuda", LOADER) as server:
        rows = _measure_builds(ctx, server, "scene", (EVERY, ONCE, EVERY_DEEP), EPISODES)
        rows += _measure_builds(ctx, server, "wide", (EVERY_DEEP,), EPISODES // 2)
    return rows


def _measure_builds(
    ctx: FigureContext,
    server: DrawServer,
    name: str,
    kinds: tuple[tuple[Maps, bool], ...],
    episodes: int,
) -> list[FigureRow]:
    """Whole builds in a scene of `work`: maps in every sample or once, with depth or without."""
    begin = time.perf_counter()
    folder = ctx.work / f"{name}-suite"
    build_suite([ctx.work / name], folder, episodes, 0, minimum_length=5.0)
    suite = load_suite(folder)
    ctx.progress(f"{episodes} walks found in {time.perf_counter() - begin:.0f} s", 0, 1)
    scene = load_scene(ctx.work / name)
    size = scene.grid.shape[::-1]
    drawn = with_backend(PictureSettings(quality=QUALITY), "cuda")
    settings = BuildSettings(chunk=4, pictures=drawn)
    few = Suite(suite.folder, suite.about, suite.episodes[:8])
    build_dataset(few, ctx.work / f"{name}-warm", settings, server=server)  # kernels, the scene
    rows: list[FigureRow] = []
    for maps, depth in kinds:
        words = {"every": "four JPEGs a sample", "once": "two JPEGs a sample"}[maps]
        pictures = msgspec.structs.replace(drawn, maps=maps, depth=depth)
        folder_name = f"{name}-{maps}{'-depth' * depth}"
        steady, whole, count, tally = _build(ctx, suite, pictures, server, folder_name)
        kind = maps + ("" if name == "scene" else f", of {size[0]}x{size[1]} px")
        kind += ", with depth" * depth
        words += " and a depth PNG of 16 bits" * depth
        detail = (
            f"{scene.source.kind} {scene.id}, {len(scene.gaussians):,} Gaussians, "
            f"{count} samples of {len(suite.episodes)} walks, FPV 480x360, mosaic 640x480, "
            f"map and occupancy {size[0]}x{size[1]}, {words}, quality {QUALITY}, "
            f"exact pictures; {server.card}, {count_cores()} cores; "
        )
        spent = (
            f"the drawing process spent {1e3 * tally.drawing / max(tally.views, 1):.3f} ms a "
            f"view on drawing, {1e3 * tally.encoding / max(tally.views, 1):.3f} on JPEG, "
            f"{1e3 * tally.copying / max(tally.views, 1):.3f} on copies beside, and waited "
            f"{tally.waiting:.1f} s; {tally.views / max(tally.calls, 1):.0f} views a call"
        )
        new = [
            row_at_least(
                f"full samples on a GPU, maps {kind}", steady, LEAST, "samples/s",
                detail + "from the first tenth to the last; " + spent,
            ),
            FigureRow(
                name=f"full samples on a GPU, maps {kind}, whole build", value=whole,
                unit="samples/s", detail=detail + "from the start of the workers to the last byte",
            ),
            FigureRow(
                name=f"47 M samples, GPU, maps {kind}", value=SAMPLES / steady / 3600,
                unit="GPU-hours", detail=detail + f"at {steady:.0f} samples/s",
            ),
        ]  # fmt: skip
        for row in new:
            ctx.report(row)
        rows += new
    return rows


FIGURES = [
    Figure("data.gpu", "Full samples a second on a GPU", measure_gpu, 1.0, backend="cuda"),
    Figure(*("data.gpu_others", "Other datasets on a GPU", measure_others, 2.0), backend="cuda"),
]
