"""The device renderer's table: full set, visible sets and gsplat, by turns in one run.

Each call draws poses that the call before has not drawn; eight batches of views go round. The
device renderer is timed with what a user gets: RGB as bytes and expected depth, views brought over
in the call; and once more with RGB as float32. gsplat is timed with views and intrinsics on the
card beforehand and its pictures left there as float32, packed and unpacked; the quicker median
counts. Times are medians between CUDA events; the wall clock's stand beside them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from gn0.errors import ConfigError, DeviceError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.renderer import RendererCuda, RendererVisibleCuda
from gn0.render.gsplat import RendererGsplat, release_memory
from gn0.render.renderer import Output, RenderOptions
from gn0.render.visible_places import VisibleOptions
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least
from gn0_figures.device import Contender, interleave, is_emulation, measure_ceilings, median
from gn0_figures.device_scenes import FigureScene, apartment_scene, flat_scene, house_scene
from gn0_figures.flat import flat_camera
from gn0_figures.floor import SORT_PASSES, Work, count_work
from gn0_figures.rival import RIVAL, open_rival, quick_calls, rival_version, why_absent

BATCHES = 8  # different batches of views that go round
OUTPUTS: tuple[Output, ...] = ("rgb", "depth")
FLOATS = RenderOptions(rgb_float=True)  # as gsplat delivers
SCENES, DISTINCT = 64, 4  # scenes of the many-scenes case; clouds that they are copies of
_TINY_SPLATS, _TINY_PIXELS = 1500, 32


@dataclass(frozen=True)
class Case:
    """A line of the table.

    Attributes:
        name: as in rows.
        width, height: of a picture [px].
        views: in one call.
        least: ratio to gsplat that the full set should reach; 0: none named.
        least_visible: the same with visible sets.
        sets: whether visible sets apply.
        bev: the orthographic map picture.
        rounds: timed calls.
    """

    name: str
    width: int
    height: int
    views: int
    least: float = 0.0
    least_visible: float = 0.0
    sets: bool = True
    bev: bool = False
    rounds: int = 12


class Bench:
    """What the cases of one figure share."""

    def __init__(self, ctx: FigureContext) -> None:
        self.ctx, self.device = ctx, ctx.device
        self.tiny = is_emulation(ctx.device)
        self.rows: list[FigureRow] = []
        self.rival_absent = ""

    @cached_property
    def ceilings(self) -> tuple[float, float]:
        """Bytes and operations a second that the card can do; see `measure_ceilings`."""
        return measure_ceilings(self.device)

    def add(self, row: FigureRow) -> None:
        """A row that outlives what fails later."""
        self.rows.append(row)
        self.ctx.report(row)

    def flat(self, count: int, sh_degree: int) -> FigureScene:
        """The standard flat, or hardly any of it on the emulation."""
        return flat_scene(_TINY_SPLATS if self.tiny else count, sh_degree)

    def fit(self, case: Case) -> Case:
        """The case, in a size that the emulation can do."""
        if not self.tiny:
            return case
        size = _TINY_PIXELS
        return replace(case, width=size, height=size, rounds=1, views=min(case.views, 3))

    def rival(self, cloud: GaussianCloud) -> RendererGsplat | None:
        """A gsplat renderer; None, and said once, where it cannot run."""
        try:
            return open_rival(cloud)
        except (DeviceError, ConfigError) as error:
            if not self.rival_absent:
                self.rival_absent = why_absent(error)
                self.ctx.progress(self.rival_absent, 0, 1)
            return None

    @property
    def set_options(self) -> VisibleOptions:
        """How visible sets are found: as always, or very coarsely on the emulation."""
        return (
            VisibleOptions(cell=4.0, places=1, pixels=16, coarse=1)
            if self.tiny
            else VisibleOptions()
        )

    @property
    def warm(self) -> int:
        """Untimed calls."""
        return 1 if self.tiny else 3


def measure_scene(bench: Bench, scene: FigureScene, cases: Sequence[Case]) -> None:
    """All cases of one scene."""
    renderer = RendererCuda(scene.cloud, device=bench.device)
    floats = RendererCuda(scene.cloud, FLOATS, bench.device)
    sets: RendererVisibleCuda | None = None
    rival = bench.rival(scene.cloud)
    judge: RendererCpu | None = None
    for done, given in enumerate(cases):
        case = bench.fit(given)
        bench.ctx.progress(scene.name, done, len(cases))
        if case.bev:
            camera, view = scene.bev(case.width)
            batches = [_shifted(view, 0.01 * k)[None] for k in range(BATCHES)]
        else:
            camera = flat_camera(case.width, case.height)
            batches = _batches(scene, case.views)
        contenders = {
            "cuda": _draw_call(renderer, camera, batches),
            "float": _draw_call(floats, camera, batches),
        }
        if case.sets and not case.bev:
            sets = sets or _build_sets(bench, renderer, scene)
            for batch in batches:  # read from the cache, before the clock runs
                sets.sets.open(
                    [c for c in sets.sets.locate(camera, batch) if c is not None], renderer.cloud
                )
            contenders["visible"] = _draw_call(sets, camera, batches)
        forms = ""
        if rival is not None:
            calls, forms = quick_calls(bench.device, rival, camera, batches)
            contenders |= calls
            del calls
        walls: dict[str, list[float]] = {}
        times = interleave(bench.device, contenders, case.rounds, warm=bench.warm, walls=walls)
        _report(bench, scene.name, case, (times, walls), forms)
        del contenders
        if rival is not None:
            release_memory()
        judge = judge or RendererCpu(scene.cloud)
        mean = count_work(judge, camera, batches[0])
        degree = scene.cloud.sh_degree
        _report_floor(bench, scene.name, case, degree, mean, 1, median(times["cuda"]))


def _batches(scene: FigureScene, views: int) -> list[F64]:
    return np.split(scene.views(BATCHES * views, 1), BATCHES)


def _shifted(view: F64, metres: float) -> F64:
    """A map view moved a little: other pixels, the same work."""
    moved = view.copy()
    moved[0, 3] += metres
    return moved


def _draw_call(renderer: Any, camera: Camera, batches: Sequence[F64]) -> Contender:
    def call(turn: int) -> Any:
        return renderer.render_device(camera, batches[turn % len(batches)], outputs=OUTPUTS)

    return call


def _build_sets(bench: Bench, renderer: RendererCuda, scene: FigureScene) -> RendererVisibleCuda:
    sets = RendererVisibleCuda(
        *(renderer, scene.cloud.content_hash, scene.floor, scene.eye, bench.set_options)
    )
    for _ in sets.build(bench.ctx.progress):
        pass
    return sets


def _report(
    bench: Bench,
    where: str,
    case: Case,
    times: tuple[dict[str, list[float]], dict[str, list[float]]],
    forms: str,
) -> None:
    """Rows of a case: ratios to the rival's quickest form where there is one, rates always."""
    middle, walls = ({name: median(values) for name, values in t.items()} for t in times)
    spent = ", ".join(f"{n} {taken:.3g} ms ({walls[n]:.3g})" for n, taken in middle.items())
    detail = f"{where}; medians of {case.rounds} by turns (by the wall clock): {spent}"
    detail += f"; {rival_version()}, a first look: {forms}" if forms else f"; {bench.rival_absent}"
    targets = {
        "cuda": ("full set", case.least),
        "visible": ("visible sets", case.least_visible),
        "float": ("full set, RGB in float32,", case.least),
    }
    rival = min((taken for name, taken in middle.items() if name.startswith(RIVAL)), default=0.0)
    for name, (title, least) in targets.items():
        if name not in middle or not rival:
            continue
        ratio, label = rival / middle[name], f"{case.name}: {title} against gsplat"
        if least and not bench.tiny:
            bench.add(row_at_least(label, ratio, least, "times", detail))
        else:
            bench.add(FigureRow(name=label, value=ratio, unit="times", detail=detail))
    for name, (title, _) in targets.items():
        if name in middle and name != "float":
            rate = case.views / middle[name] * 1e3
            bench.add(
                FigureRow(name=f"{case.name}: {title}", value=rate, unit="frames/s", detail=detail)
            )


def _report_floor(
    bench: Bench, where: str, case: Case, sh_degree: int, mean: Work, scenes: int, taken: float
) -> None:
    """How far a full draw is from the least time that its work takes; `mean` is that of a view."""
    work = mean.scaled(case.views, scenes)
    copy, operations = bench.ceilings
    least = work.floor(sh_degree, copy, operations)
    moved, done = work.bytes_of(sh_degree), work.operations
    detail = (
        f"{where}; floor {least:.3g} ms: {moved[0] / 1e9:.3g} + {moved[1] / 1e9:.3g} GB at "
        f"{copy / 1e12:.2f} TB/s, {done[0] / 1e9:.3g} + {done[1] / 1e9:.3g} G operations at "
        f"{operations / 1e12:.1f} T/s (arranging + blending); a view: "
        f"{mean.visible / 1e3:.0f}k splats, {mean.entries / 1e3:.0f}k entries, "
        f"{mean.reached / 1e3:.0f}k reached"
    )
    name = f"{case.name}: time over floor"
    bench.add(FigureRow(name=name, value=taken / least, unit="times", detail=detail))
    passes = least + work.sort_bytes / copy * 1e3
    detail = f"{where}; floor {passes:.3g} ms: with a radix sort of all entries in global memory, "
    detail += f"{SORT_PASSES} passes; ours sorts a tile's entries where it blends them"
    name += ", sorting counted"
    bench.add(FigureRow(name=name, value=taken / passes, unit="times", detail=detail))


SMALL = Case("224x224 x 256, 1 M, SH 0", 224, 224, 256, 4.0, 8.0)
SMALL_SH = Case("224x224 x 256, 1 M, SH 3", 224, 224, 256, 5.0, 9.0)
SIXTEEN = Case("640x480 x 16, 1 M, SH 0", 640, 480, 16, 3.5, 6.0)
SINGLE = Case("640x480 x 1, 1 M, SH 0", 640, 480, 1, 4.0, rounds=40)
MAP = Case("BEV 1024x1024, 1 M, SH 0", 1024, 1024, 1, 3.0, bev=True, rounds=20)
MANY = Case("224x224 x 256 over 64 scenes of 300 k", 224, 224, 256, 10.0, 15.0)


def measure_small(ctx: FigureContext) -> list[FigureRow]:
    """Many small views of a million splats, SH 0 and 3."""
    bench = Bench(ctx)
    measure_scene(bench, bench.flat(1_000_000, 0), [SMALL])
    measure_scene(bench, bench.flat(1_000_000, 3), [SMALL_SH])
    return bench.rows


def measure_large(ctx: FigureContext) -> list[FigureRow]:
    """Few large views and the map picture of a million splats."""
    bench = Bench(ctx)
    measure_scene(bench, bench.flat(1_000_000, 0), [SIXTEEN, SINGLE, MAP])
    return bench.rows


def measure_scenes(ctx: FigureContext) -> list[FigureRow]:
    """Views of 64 scenes in one call, against a loop of gsplat calls."""
    bench = Bench(ctx)
    case = bench.fit(MANY)
    scenes = 2 if bench.tiny else SCENES
    flats = [
        flat_scene(_TINY_SPLATS if bench.tiny else 300_000, seed=k)
        for k in range(min(DISTINCT, scenes))
    ]
    batch, floats = RendererBatch(bench.device), RendererBatch(bench.device, FLOATS)
    keys = [f"scene {k}" for k in range(scenes)]
    for k, key in enumerate(keys):
        flat = flats[k % len(flats)]
        batch.add(key, lambda flat=flat: flat.cloud)  # type: ignore[misc]
        floats.add(key, lambda flat=flat: flat.cloud)  # type: ignore[misc]
        batch.limit_to_visible(
            key, flat.cloud.content_hash, flat.floor, flat.eye, bench.set_options
        )
    each = max(case.views // scenes, 1)
    case = replace(case, views=each * scenes)
    camera = flat_camera(case.width, case.height)
    poses = flats[0].views(BATCHES * case.views, 1).reshape(BATCHES, case.views, 4, 4)
    mine = [key for key in keys for _ in range(each)]

    def draw(visible: bool, by: RendererBatch = batch) -> Contender:
        return lambda turn: by.draw(
            camera, poses[turn % BATCHES], mine, outputs=OUTPUTS, visible=visible
        )

    contenders = {"cuda": draw(False), "visible": draw(True), "float": draw(False, floats)}
    for turn in range(BATCHES):  # scenes and sets come in before the clock runs
        bench.ctx.progress("visible sets of all scenes", turn, BATCHES)
        draw(True)(turn)
    forms, loops = "", _loop_calls(bench, flats, scenes, camera, poses)
    if loops:
        tried = interleave(bench.device, loops, 2, warm=1)
        forms = ", ".join(f"{name} {median(taken):.3g} ms" for name, taken in tried.items())
        contenders |= loops
    walls: dict[str, list[float]] = {}
    times = interleave(bench.device, contenders, case.rounds, warm=bench.warm, walls=walls)
    where = f"{scenes} standard flats of {len(flats[0].cloud) / 1e6:g} M (of {len(flats)} seeds)"
    _report(bench, where, case, (times, walls), forms)
    mean = count_work(RendererCpu(flats[0].cloud), camera, poses[0][:each])
    _report_floor(bench, where, case, 0, mean, scenes, median(times["cuda"]))
    return bench.rows


def _loop_calls(
    bench: Bench, flats: Sequence[FigureScene], scenes: int, camera: Camera, poses: F64
) -> dict[str, Contender]:
    """A gsplat call a scene, packed and unpacked; nothing without gsplat."""
    rivals = [bench.rival(flats[k % len(flats)].cloud) for k in range(scenes)]
    if rivals[0] is None:
        return {}
    placed = [
        [rival.place(camera, part) for rival, part in zip(rivals, parts, strict=True) if rival]
        for parts in (np.split(batch, scenes) for batch in poses)
    ]

    def loop(packed: bool) -> Contender:
        def call(turn: int) -> Any:
            there = placed[turn % len(placed)]
            return [
                rival.rasterize(camera, one, packed=packed)
                for rival, one in zip(rivals, there, strict=True)
                if rival
            ]

        return call

    return {f"{RIVAL} packed": loop(True), f"{RIVAL} unpacked": loop(False)}


def _own_cases(count: int) -> Iterator[Case]:
    yield Case("224x224 x 256", 224, 224, count, 4.0, 8.0)
    yield Case("640x480 x 16", 640, 480, 16, 3.5, 6.0)
    yield Case("640x480 x 1", 640, 480, 1, 4.0, rounds=40, sets=False)
    yield Case("BEV 1024x1024", 1024, 1024, 1, 3.0, bev=True, rounds=20)


def measure_own(scene: FigureScene, ctx: FigureContext) -> list[FigureRow]:
    """A scene that is not the synthetic flat."""
    bench = Bench(ctx)
    cases = [replace(case, name=f"{scene.name}: {case.name}") for case in _own_cases(256)]
    measure_scene(bench, scene, cases)
    return bench.rows


def measure_apartment(ctx: FigureContext) -> list[FigureRow]:
    """A generated apartment."""
    return measure_own(apartment_scene(ctx, tiny=is_emulation(ctx.device)), ctx)


def measure_house(ctx: FigureContext) -> list[FigureRow]:
    """An imported house."""
    return measure_own(house_scene(ctx, tiny=is_emulation(ctx.device)), ctx)


_TITLE = "CUDA renderer against gsplat: "
FIGURES = [
    Figure("render.cuda.small", _TITLE + "many small views", measure_small, 2.0, backend="cuda"),
    Figure("render.cuda.large", _TITLE + "few large views", measure_large, 1.0, backend="cuda"),
    Figure("render.cuda.scenes", _TITLE + "64 scenes", measure_scenes, 1.5, backend="cuda"),
    Figure("render.cuda.apartment", _TITLE + "apartment", measure_apartment, 1.5, backend="cuda"),
    Figure("render.cuda.house", _TITLE + "small_house", measure_house, 1.5, backend="cuda"),
]
