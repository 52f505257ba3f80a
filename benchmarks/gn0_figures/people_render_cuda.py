"""Figures of people in pictures on a card: bank, instances, who is who, and what each costs.

All that the renderer promises of people is checked here as well, so that a card is seen to keep it.
"""

from __future__ import annotations

import time

import numpy as np

from gn0.avatars.coded_poses import PosesOneByOne
from gn0.avatars.posed_device import PosedBankDevice, posing_of, rest_of
from gn0.gaussians.cloud import join_clouds
from gn0.geometry import F64
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.posed import bring_rest, pose_clouds, posed_bytes
from gn0.render.instance import Instance, move_instance
from gn0.render.renderer import RenderResult
from gn0_figures.agreement import OPTIONS, PERSPECTIVE, compare_pictures
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.device import interleave, median
from gn0_figures.device_parts import DEPTH, QUALITY, SHARES, UNSEEN
from gn0_figures.device_table import OUTPUTS, Bench
from gn0_figures.flat import flat_camera
from gn0_figures.people_batch import UNSEEN_AWAY, open_batch, send_people
from gn0_figures.people_walking import (
    LIGHT,
    PIXELS,
    QUARTER,
    Walkers,
    find_views,
    open_actors,
)

_KEY = "flat"
_ROUNDS, _TURNS = 24, 64  # timed calls, and phases of a cycle
_SKIN = 0.01  # mm at most, between centres that the card and the CPU skin
_FILL, _LACKING = 64, 10.0  # clouds of one launch, and ms at most until they are found
_EACH = 8  # people in each view of a batch


def measure_people(ctx: FigureContext) -> list[FigureRow]:
    """Checks and times of people on a card."""
    bench = Bench(ctx)
    _measure_bank(bench)
    _measure_agreement(bench)
    _measure_who(bench)
    _measure_view(bench)
    _measure_batch(bench)
    return bench.rows


def _measure_bank(bench: Bench) -> None:
    """Skinning against the CPU's, and how long a launch for many clouds takes."""
    device, actor = bench.device, open_actors(8, bench.tiny)[0]
    walkers = Walkers((actor,), 2.0, 160.0)
    count = 2 if bench.tiny else _FILL
    worst, levels = 0.0, list(dict.fromkeys(actor.levels))
    for avatar in levels:
        rest = bring_rest(device, rest_of(avatar))
        poses = [walkers.wanted(turn)[0][1].turn() for turn in range(0, _TURNS, _TURNS // 4)]
        clouds = pose_clouds(device, [posing_of(avatar, rest, *pose) for pose in poses])
        for cloud, pose in zip(clouds, poses, strict=True):
            words = cloud.splats.numpy()[: cloud.alive]
            low = words[:, 0] | words[:, 1].astype(np.uint64) << 32
            steps = np.stack([low >> 21 * k & 0x1FFFFF for k in range(3)], axis=1)
            places = (steps.astype(np.float64) - 2**20) * cloud.step + (0, 0, 1)
            want = avatar.pose(*pose).means[cloud.order.numpy()[: cloud.alive]]
            worst = max(worst, float(np.linalg.norm(places - want, axis=1).max()))
    detail = f"four poses of a walk at each of {len(levels)} levels, after packing"
    bench.add(row_at_most("skinned and packed, to the CPU", 1e3 * worst, _SKIN, "mm", detail))
    avatar = actor.levels[QUARTER]
    rest = bring_rest(device, rest_of(avatar))
    made = [posing_of(avatar, rest, *walkers.wanted(k)[0][1].turn()) for k in range(count)]
    walls: dict[str, list[float]] = {}
    rounds = 1 if bench.tiny else _ROUNDS
    calls = {"fill": lambda turn: pose_clouds(device, made)}
    spent = interleave(device, calls, rounds, warm=bench.warm, walls=walls)
    detail = f"{count} clouds of {len(avatar):,} splats by one launch, upload and memory included; "
    detail += f"by the wall clock {median(walls['fill']):.3g} ms"
    bench.add(FigureRow(name="bank filled", value=median(spent["fill"]), unit="ms", detail=detail))
    fit = 512 * 2**20 // posed_bytes(-(-10_000 // 256) * 256)
    bench.add(row_at_least("clouds of 10,000 splats in 512 MB", fit, 3000, "clouds"))


def _stand(bank: PosedBankDevice, walkers: Walkers, view: F64, turn: int) -> list[Instance]:
    slots, poses = bank.fetch(walkers.wanted(turn)), walkers.poses(view)
    return [Instance(bank.name(s), p, LIGHT) for s, p in zip(slots, poses, strict=True)]


def _measure_agreement(bench: Bench) -> None:
    """Packed people against moved splats and the CPU's, and the same bytes on every way."""
    views, pixels = (2, 32) if bench.tiny else (8, PIXELS)
    scene, camera = bench.flat(1_000_000, 0), flat_camera(pixels, pixels)
    looks = find_views(scene, views, 3.0, bench.tiny)
    walkers = Walkers(open_actors(8, bench.tiny), 1.0 if bench.tiny else 2.0, camera.fx)
    batch, cpu = RendererBatch(bench.device, OPTIONS), RendererCpu(scene.cloud, OPTIONS)
    batch.keep(_KEY, scene.cloud)
    bank = PosedBankDevice(batch)
    wanted = walkers.wanted(5)
    for n, (_, pose) in enumerate(wanted):
        cpu.name_cloud(f"person {n}", pose())
    parts = [_stand(bank, walkers, view, 5) for view in looks]
    named = [
        [Instance(f"person {n}", one.pose, LIGHT) for n, one in enumerate(row)] for row in parts
    ]
    moved = [
        join_clouds(
            [move_instance(pose(), one) for (_, pose), one in zip(wanted, row, strict=True)]
        )
        for row in parts
    ]
    drawn = [batch.render(camera, looks, _KEY, parts=parts) for _ in range(3)]  # the last recorded
    bare = compare_pictures(drawn[0], batch.render(camera, looks, _KEY)).rgb
    detail = f"{scene.name}, {views} views of {pixels}x{pixels}, eight people in each; to pictures "
    detail += f"without them {bare:.1f} dB"
    for title, least, want in (
        ("moved splats", QUALITY, batch.draw(camera, looks, _KEY, tails=moved).numpy()),
        ("the CPU's instances", PERSPECTIVE, cpu.render(camera, looks, parts=named)),
    ):
        near = compare_pictures(drawn[0], want)
        bench.add(
            row_at_least(f"RGB PSNR, packed people to {title}", near.rgb, least, "dB", detail)
        )
        bench.add(row_at_most(f"depth p99, to {title}", near.depth, DEPTH, "mm", detail))
    there = send_people(bench.device, bank, walkers, looks, 5)
    others = [
        *drawn[1:],
        batch.draw(camera, bench.device.upload(looks), _KEY, parts=there).numpy(),
        _join([batch.render(camera, looks[v], _KEY, parts=parts[v]) for v in range(views)]),
    ]
    unlike = sum(_bytes_of(other) != _bytes_of(drawn[0]) for other in others)
    detail += "; the same again, recorded, views and slots on the device, one by one"
    bench.add(row_at_most("calls with people that give other bytes", unlike, 0, "calls", detail))


def _measure_who(bench: Bench) -> None:
    """Numbers of people as the CPU has them; nobody behind a wall."""
    views, pixels = (2, 32) if bench.tiny else (8, PIXELS)
    scene, camera = bench.flat(1_000_000, 0), flat_camera(pixels, pixels)
    looks = find_views(scene, views, 3.0, bench.tiny)
    walkers = Walkers(open_actors(8, bench.tiny), 1.0 if bench.tiny else 2.0, camera.fx)
    batch, cpu = RendererBatch(bench.device), RendererCpu(scene.cloud)
    batch.keep(_KEY, scene.cloud)
    bank = PosedBankDevice(batch)
    for n, (_, pose) in enumerate(walkers.wanted(9)):
        cpu.name_cloud(f"person {n}", pose())
    parts = [_stand(bank, walkers, view, 9) for view in looks]
    named = [[Instance(f"person {n}", one.pose) for n, one in enumerate(row)] for row in parts]
    found, want = batch.render_who(camera, looks, _KEY, parts=parts), cpu.render_who(
        camera, looks, parts=named
    )  # fmt: skip
    detail = f"{scene.name}, {views} views of {pixels}x{pixels}, eight people in each; "
    detail += f"{100 * float((want.numbers > 0).mean()):.1f} % of the pixels show somebody"
    other = 100 * float((found.numbers != want.numbers).mean())
    bench.add(
        row_at_most("pixels that show another person than the CPU's", other, 0.1, "%", detail)
    )
    apart = max(
        abs(mine.share - his.share)
        for row, truth in zip(found.seen, want.seen, strict=True)
        for mine, his in zip(row, truth, strict=True)
    )
    bench.add(row_at_most("visible shares, to the CPU's", apart, 0.02, "", detail))
    away = np.array([one.pose for row in parts for one in row])
    away[:, :3, 3] += np.repeat([-np.linalg.inv(v)[:3, 2] for v in looks], 8, axis=0) * -30.0
    far = [
        [Instance(one.cloud, away[8 * v + k]) for k, one in enumerate(row)]
        for v, row in enumerate(parts)
    ]
    hidden = int((batch.render_who(camera, looks, _KEY, parts=far).numbers > 0).sum())
    bench.add(row_at_most("pixels of people 30 m behind the walls", hidden, 0, "px", detail))


def _measure_view(bench: Bench) -> None:
    """One view, a call that is recorded, while people walk: bank included."""
    pixels = 32 if bench.tiny else PIXELS
    scene, camera = bench.flat(300_000, 0), flat_camera(pixels, pixels)
    look = find_views(scene, 1, 3.0, bench.tiny)[0]
    batch = RendererBatch(bench.device)
    batch.keep(_KEY, scene.cloud)
    banks = {count: PosedBankDevice(batch) for count in (1, 8)}

    def draw(count: int) -> object:
        actors = open_actors(8, bench.tiny)[:count]
        walkers = Walkers(actors, 1.0 if bench.tiny else 2.0, camera.fx)
        if not count:
            return lambda turn: batch.draw(camera, look, _KEY, outputs=OUTPUTS)
        return lambda turn: batch.draw(
            *(camera, look, _KEY),
            outputs=OUTPUTS,
            parts=_stand(banks[count], walkers, look, turn),
        )

    calls = {str(count): draw(count) for count in (0, 1, 8)}
    rounds = 1 if bench.tiny else 3 * _TURNS
    walls: dict[str, list[float]] = {}
    interleave(bench.device, calls, rounds, warm=bench.warm, walls=walls)  # type: ignore[arg-type]
    none = np.array(walls["0"])
    detail = f"{scene.name}, {pixels}x{pixels} RGB-D, walking from 2 m on, bank included, wall "
    detail += f"clock; {median(walls['0']):.3g} ms without"
    for count, words in ((1, "one person"), (8, "eight people")):
        more = np.array(walls[str(count)]) - none
        bank = banks[count]
        told = (
            f"{detail}; hit rate {bank.hit_rate:.3f}, {bank.bytes / 2**20:.1f} MB in the bank and "
        )
        told += f"{bank.rest_bytes / 2**20:.1f} MB at rest, {bank.launches} launches"
        late = more[len(more) * 2 // 3 :]
        name = f"{words} in a view, posed before"
        bench.add(FigureRow(name=name, value=median(late.tolist()), unit="ms", detail=told))
        early = more[: max(len(more) // 3, 1)]
        name = f"{words} in a view, posed anew"
        bench.add(FigureRow(name=name, value=median(early.tolist()), unit="ms", detail=told))
        rate = row_at_least(f"hit rate, {words}", bank.hit_rate, 0.5, "", told)
        bench.add(FigureRow(name=rate.name, value=rate.value, unit="", detail=told))


def _measure_batch(bench: Bench) -> None:
    """Many agents, each among people of its own; slots and poses on the device."""
    crowd, device = open_batch(bench), bench.device
    bank, views, pixels = crowd.bank, len(crowd.looks), crowd.camera.width
    calls = {"none": crowd.draw(None), "unseen": crowd.draw(crowd.send(1, UNSEEN_AWAY))}
    calls |= {str(count): crowd.draw(crowd.send(count)) for count in SHARES}
    rounds = 1 if bench.tiny else _ROUNDS
    times = interleave(device, calls, rounds, warm=bench.warm)
    none = np.array(times["none"])
    spent = ", ".join(f"{name} {median(taken):.3g} ms" for name, taken in times.items())
    free, _ = device.memory()
    detail = (
        f"{crowd.name}, visible sets, {views} views of {pixels}x{pixels} RGB-D, people who walk "
    )
    detail += f"from 2 m on in each; {len(bank)} clouds, {bank.bytes / 2**20:.1f} MB, of "
    detail += (
        f"{bank.rest_bytes / 2**20:.1f} MB at rest; {free / 2**30:.1f} GB of the card are free; "
    )
    detail += f"medians: {spent}"
    for count, least in SHARES.items():
        share = float(np.median(none / np.array(times[str(count)])))
        row = row_at_least(
            f"rate with {count} a view over that without", share, least, "times", detail
        )
        bench.add(row if not bench.tiny else FigureRow(name=row.name, value=share, unit="times"))
    cost = 100 * (float(np.median(np.array(times["unseen"]) / none)) - 1.0)
    row = row_at_most("time that a person takes whom no view sees", cost, 100 * UNSEEN, "%", detail)
    bench.add(row if not bench.tiny else FigureRow(name=row.name, value=cost, unit="%"))
    _measure_finding(bench, bank, views)


def _measure_finding(bench: Bench, bank: PosedBankDevice, views: int) -> None:
    """What a kernel's question for slots takes, once all are there."""
    device, count = bench.device, views * _EACH
    walkers = Walkers(open_actors(8, bench.tiny)[:1], 2.0, 160.0)
    poses = PosesOneByOne(lambda code: walkers.wanted(code)[0][1])
    many = 4 if bench.tiny else _FILL
    chosen = device.empty(count, np.int32)
    firsts = []
    for turn in range(2):  # whom nobody has seen is brought there at first
        codes = device.upload((1 + turn * many + np.arange(count) % many).astype(np.uint64))
        device.synchronize()
        begin = time.perf_counter()
        lacking = bank.find(codes, chosen, poses)
        device.synchronize()
        firsts.append(1e3 * (time.perf_counter() - begin))
    calls = {"find": lambda turn: bank.find(codes, chosen, poses)}
    walls: dict[str, list[float]] = {}
    interleave(device, calls, 1 if bench.tiny else _ROUNDS, warm=bench.warm, walls=walls)
    detail = f"{count:,} codes, all there, wall clock"
    bench.add(FigureRow(name="slots found", value=median(walls["find"]), unit="ms", detail=detail))
    detail = f"{count:,} codes, {lacking} of them not there, wall clock until they are; of people "
    detail += f"who were not at rest there either {firsts[0]:.3g} ms"
    row = row_at_most("slots found of people who lack", firsts[1], _LACKING, "ms", detail)
    bench.add(row if not bench.tiny else FigureRow(name=row.name, value=firsts[1], unit="ms"))


def _join(results: list[RenderResult]) -> RenderResult:
    names = ("rgb", "depth", "alpha")
    return RenderResult(*(np.concatenate([getattr(one, n) for one in results]) for n in names))


def _bytes_of(result: RenderResult) -> list[bytes]:
    return [getattr(result, name).tobytes() for name in ("rgb", "depth", "alpha")]


FIGURES = [
    Figure("people.render.cuda", "People in pictures on a GPU", measure_people, 2.0, backend="cuda")
]
