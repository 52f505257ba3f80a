"""Figures of moving parts on the device: what instances cost beside a scene, and how near they are.

Views and instances lie on the device, as a simulation has them there; each call draws poses that
the call before has not drawn. Ratios are medians over rounds in which all took turns.
"""

from __future__ import annotations

import numpy as np

from gn0.gaussians.cloud import join_clouds
from gn0.geometry import F64
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.batch import RendererBatch
from gn0.render.instance import Instance, PartsDevice, move_instance
from gn0.render.renderer import RenderResult
from gn0.seeds import random_stream
from gn0_figures.agreement import OPTIONS, compare_pictures
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.device import Contender, interleave, median
from gn0_figures.device_table import BATCHES, OUTPUTS, Bench
from gn0_figures.flat import flat_camera
from gn0_figures.moving import GAIN, build_ball, pose_ahead

SHARES = {1: 0.90, 4: 0.75, 8: 0.60}  # of the rate without instances, at least
UNSEEN = 0.01  # of the time without, at most, for an instance that no view sees
QUALITY, DEPTH = 75.0, 0.1  # dB at least and mm at most, against moved splats
_HEIGHT, _ROUNDS = 0.9, 24
_KEY, _NAME = "flat", "ball"


def _walk(bench: Bench, count: int, turn: int) -> F64:
    """Part-to-world [count, 4, 4] of parts that stand on the flat's floor, turned as they like."""
    places = bench.flat(1, 0).views(count, 50 + turn)
    stream = random_stream(turn, "figure parts")
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose, view, angle in zip(poses, places, stream.uniform(0, 6.3, count), strict=True):
        c, s = np.cos(angle), np.sin(angle)
        pose[:2, :2] = (c, -s), (s, c)
        pose[:3, 3] = -view[:3, :3].T @ view[:3, 3]
        pose[2, 3] = _HEIGHT
    return poses


def measure_parts(ctx: FigureContext) -> list[FigureRow]:
    """Views a second with instances in a scene over those without, from visible sets."""
    bench = Bench(ctx)
    views, pixels, size = (3, 32, 200) if bench.tiny else (1024, 224, 10_000)
    scene, device = bench.flat(1_000_000, 0), bench.device
    batch = RendererBatch(device)
    cloud = batch.keep(_KEY, scene.cloud)
    sets = batch.limit_to_visible(
        _KEY, scene.cloud.content_hash, scene.floor, scene.eye, bench.set_options
    )
    batch.name_cloud(_NAME, build_ball(size, 1, size=0.012))
    camera = flat_camera(pixels, pixels)
    turns = 1 if bench.tiny else BATCHES
    looks = np.split(scene.views(turns * views, 1), turns)
    for turn, some in enumerate(looks):  # sets come in before the clock runs
        ctx.progress("visible sets", turn, turns)
        sets.open([cell for cell in sets.locate(camera, some) if cell is not None], cloud)
    poses = [device.upload(some) for some in looks]

    def send(count: int, away: float = 0.0) -> list[PartsDevice]:
        """`count` instances of the scene in each of its views, for every turn."""
        sent = []
        for turn in range(turns):
            stand = _walk(bench, count, turn)
            stand[:, 2, 3] += away
            sent.append(
                PartsDevice(
                    [_NAME],
                    device.upload(np.tile(stand, (views, 1, 1))),
                    device.zeros(views * count, np.int32),
                    count,
                    device.upload(np.tile(GAIN, (views * count, 1, 1))),
                )
            )
        return sent

    def draw(parts: list[PartsDevice] | None) -> Contender:
        return lambda turn: batch.draw(
            *(camera, poses[turn % turns], _KEY),
            outputs=OUTPUTS,
            visible=True,
            parts=() if parts is None else parts[turn % turns],
        )

    contenders = {"none": draw(None), "unseen": draw(send(1, 500.0))}
    contenders |= {str(count): draw(send(count)) for count in SHARES}
    times = interleave(device, contenders, 1 if bench.tiny else _ROUNDS, warm=bench.warm)
    spent = ", ".join(f"{name} {median(taken):.3g} ms" for name, taken in times.items())
    detail = f"{scene.name}, visible sets, {views} views of {pixels}x{pixels} RGB-D and instances"
    detail += f" of {size:,} splats with gains, poses on the device; medians: {spent}"
    detail += f"; {len(times['none'])} rounds by turns, medians of their ratios"
    none = np.array(times["none"])
    rate = views / median(times["none"]) * 1e3
    bench.add(FigureRow(name="no instances", value=rate, unit="frames/s", detail=detail))
    for count, least in SHARES.items():
        share = float(np.median(none / np.array(times[str(count)])))
        name = f"rate with {count} instance{'s' * (count > 1)} a scene over that without"
        if bench.tiny:
            bench.add(FigureRow(name=name, value=share, unit="times", detail=detail))
        else:
            bench.add(row_at_least(name, share, least, "times", detail))
    cost = float(np.median(np.array(times["unseen"]) / none)) - 1.0
    name = "time that an instance takes which no view sees"
    if bench.tiny:
        bench.add(FigureRow(name=name, value=100 * cost, unit="%", detail=detail))
    else:
        bench.add(row_at_most(name, 100 * cost, 100 * UNSEEN, "%", detail))
    for degree in (0, 3):
        _measure_agreement(bench, degree)
    return bench.rows


def _measure_agreement(bench: Bench, degree: int) -> None:
    """Instances against moved splats, on the device and by the CPU, and on two ways."""
    views, pixels, size = (4, 32, 200) if bench.tiny else (8, 224, 10_000)
    scene = bench.flat(1_000_000, degree)
    camera, looks = flat_camera(pixels, pixels), scene.views(views, 6)
    cloud = build_ball(size, 2, sh_degree=degree, size=0.012 if not bench.tiny else 0.06)
    parts = [
        [
            Instance(_NAME, pose_ahead(view, 1.6, 0.3, 0.4), GAIN),
            Instance(_NAME, pose_ahead(view, 2.6, -0.8, 2.0)),
        ]
        for view in looks
    ]
    moved = [join_clouds([move_instance(cloud, one) for one in row]) for row in parts]
    batch, cpu = RendererBatch(bench.device, OPTIONS), RendererCpu(scene.cloud, OPTIONS)
    batch.keep(_KEY, scene.cloud)
    for renderer in (batch, cpu):
        renderer.name_cloud(_NAME, cloud)
    drawn = [batch.render(camera, looks, _KEY, parts=parts) for _ in range(3)]  # the last recorded
    there = batch.draw(camera, bench.device.upload(looks), _KEY, parts=parts).numpy()
    alone = [batch.render(camera, looks[v], _KEY, parts=parts[v]) for v in range(views)]
    bare = compare_pictures(drawn[0], batch.render(camera, looks, _KEY)).rgb
    detail = f"{scene.name}, {views} views of {pixels}x{pixels}, two of {size:,} splats in each"
    detail += f"; to pictures without them {bare:.1f} dB"
    for title, want in (
        ("moved splats on the device", batch.draw(camera, looks, _KEY, tails=moved).numpy()),
        ("moved splats on the CPU", _join([cpu.render(camera, v, extra=m)
                                           for v, m in zip(looks, moved, strict=True)])),
        ("instances on the CPU", cpu.render(camera, looks, parts=parts)),
    ):  # fmt: skip
        near = compare_pictures(drawn[0], want)
        name = f"instances to {title}, SH {degree}"
        bench.add(row_at_least(f"RGB PSNR, {name}", near.rgb, QUALITY, "dB", detail))
        bench.add(row_at_most(f"depth p99, {name}", near.depth, DEPTH, "mm", detail))
    first = _bytes_of(drawn[0])
    others = [*drawn[1:], there, _join(alone)]
    different = sum(_bytes_of(other) != first for other in others)
    detail += "; the same again, recorded, with views on the device, one by one"
    name = f"calls with instances that give other bytes, SH {degree}"
    bench.add(row_at_most(name, different, 0, "calls", detail))


def _join(results: list[RenderResult]) -> RenderResult:
    return RenderResult(
        *(np.concatenate([getattr(one, name) for one in results])
          for name in ("rgb", "depth", "alpha"))
    )  # fmt: skip


def _bytes_of(result: RenderResult) -> list[bytes]:
    return [getattr(result, name).tobytes() for name in ("rgb", "depth", "alpha")]


FIGURES = [
    Figure("render.cuda.parts", "CUDA renderer: moving parts", measure_parts, 1.5, backend="cuda")
]
