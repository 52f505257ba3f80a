"""How people look and what they cost in the CPU renderer: light, levels of detail, time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

import numpy as np

from gn0.avatars.avatar import Avatar
from gn0.avatars.detail import GRAIN, REACH_PX, SHARES, build_levels, choose_level
from gn0.avatars.identity import draw_people
from gn0.avatars.light import NORMALS, find_probes
from gn0.avatars.person import build_person
from gn0.avatars.posed_bank import PosedBank
from gn0.avatars.poses import stride_pose
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.film import develop_film, encode_srgb, expose_film
from gn0.geometry import F64, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance, move_instance
from gn0.render.renderer import RenderOptions
from gn0.scenes.procedural.kinds import KindName
from gn0.testing.renderer_check import psnr
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.flat import build_flat, flat_camera, flat_views
from gn0_figures.people_light import draw_places, light_scene, trace_light
from gn0_figures.people_walking import QUARTER

# other seeds than those by which the probes were made
SCENES: tuple[tuple[KindName, int], ...] = (
    ("apartment", 21), ("apartment", 34), ("corridor", 12), ("office", 5),
)  # fmt: skip
PLACES = 50  # a scene
GREY = 0.2  # albedo
CAMERAS = {
    "224 x 224": Camera.from_hfov(224, 224, 90.0),
    "480 x 360": Camera.from_vfov(480, 360, 70.0),
}
_LEAST = {1 / 2: 37.0, 1 / 4: 32.0}  # dB to all splats, of a level by its share of them
_LUMA = np.array([0.2126, 0.7152, 0.0722])
_FINE = 6  # pixels of the true picture along each side of a pixel
_ROUNDS, _VIEWS = 9, 6  # of what is timed, by turns


def measure_looks(ctx: FigureContext) -> list[FigureRow]:
    """Light on grey people, likeness of levels, instances against moved splats, time."""
    rows = _light_rows(ctx)
    people = [build_person(identity) for identity in draw_people(3, 4)]
    levels = [build_levels(person) for person in people]
    return [*rows, *_level_rows(levels), *_instance_rows(people[0]), *_time_rows(levels)]


def _light_rows(ctx: FigureContext) -> list[FigureRow]:
    """Median errors of grey people in the gain of the place where they stand."""
    found: dict[str, list[float]] = {name: [] for name in ("light", "shown", "sides", "seen sides")}
    seconds = []
    around = NORMALS[:, None, 2] ** 2 < 0.98
    weight = np.where(around[:, 0], 1.0 - 0.75 * np.abs(NORMALS[:, 2]), 0.0)
    for number, (kind, seed) in enumerate(SCENES):
        ctx.progress("grey people", number, len(SCENES))
        scene = light_scene(kind, seed)
        places = draw_places(scene.grid, PLACES, seed)
        truth = develop_film(GREY * trace_light(scene, places, NORMALS, seed)) @ _LUMA
        start = time.perf_counter()
        probes = find_probes(scene.cloud, scene.grid, cache=False)
        seconds.append(time.perf_counter() - start)
        gains = np.stack([probes.gain_at(x, y) for x, y in places]).astype(np.float64)
        gain = np.maximum(gains[:, :1] + np.einsum("ma,pak->pmk", NORMALS, gains[:, 1:]), 0.0)
        shown = np.clip(gain * float(encode_srgb(np.array(GREY))), 0.0, 1.0) @ _LUMA
        for names, convert in (
            (("light", "sides"), expose_film), (("shown", "seen sides"), np.asarray),
        ):  # fmt: skip
            mine, true = convert(shown), convert(truth)
            found[names[0]] += list(np.abs((mine @ weight) / (true @ weight) - 1.0))
            found[names[1]] += list(_side_error(mine, true))
    detail = ", ".join(f"{kind} {seed}" for kind, seed in SCENES) + f", {PLACES} places each, small"
    median = {name: 100 * float(np.median(values)) for name, values in found.items()}
    return [
        row_at_most("grey people: light, median error", median["light"], 15, "%", detail),
        row_at_most("left to right, median error", median["sides"], 20, "%", detail),
        _plain("grey people: display value, median error", median["shown"], "%", detail),
        _plain("left to right in display values, median error", median["seen sides"], "%", detail),
        _plain("finding the probes, worst scene", max(seconds), "s", detail),
    ]


def _side_error(mine: F64, true: F64) -> F64:
    """Relative errors of the ratio of a person's two sides [4 P], facing four ways each."""
    errors = []
    for turn in np.arange(4) * np.pi / 4:
        along = NORMALS @ (np.cos(turn), np.sin(turn), 0.0)
        left, right = np.maximum(along, 0.0), np.maximum(-along, 0.0)
        off = np.log((mine @ left) / (mine @ right) * (true @ right) / (true @ left))
        errors.append(np.exp(np.abs(off)) - 1.0)
    return np.concatenate(errors)


def _level_rows(levels: Sequence[tuple[Avatar, ...]]) -> list[FigureRow]:
    """Inside the outline of the true picture, where each level begins."""
    rows = []
    for size, camera in CAMERAS.items():
        for number in range(1, len(SHARES)):
            distance = 1.001 * GRAIN[number] * camera.fx / REACH_PX[number]
            values = []
            for person in levels:
                clouds = [level.pose(stride_pose()) for level in (*person[: number + 1],)]
                chance = np.random.default_rng(0).permutation(len(clouds[0]))[: len(clouds[-1])]
                values.append(_compare(camera, distance, [*clouds, clouds[0].select(chance)]))
            against = dict(
                zip(values[0], np.mean([list(v.values()) for v in values], axis=0), strict=True)
            )
            detail = f"1/{1 / SHARES[number]:.0f} of all splats; {size}, {distance:.1f} m, "
            detail += "four people; as many splats by chance "
            detail += f"{against['chance']:.1f} dB; against the person drawn 6 x finer: this level "
            detail += (
                f"{against['level to truth']:.1f}, all splats {against['full to truth']:.1f} dB; "
            )
            detail += (
                f"area {against['area']:.2f}, all splats {against['full area']:.2f} of the true"
            )
            name = f"level {number} against all splats, {size}"
            value = float(against["level to full"])
            rows.append(
                row_at_least(name, value, _LEAST[SHARES[number]], "dB", detail)
                if SHARES[number] in _LEAST
                else _plain(name, value, "dB", detail)
            )
            name = f"level {number} against level {number - 1}, {size}"
            rows.append(_plain(name, float(against["level to before"]), "dB", detail))
    return rows


def _compare(camera: Camera, distance: float, clouds: list[GaussianCloud]) -> dict[str, float]:
    """PSNR inside the true outline; the last cloud is the one by chance."""
    views = np.stack([
        view_from_pose(distance * np.cos(a), distance * np.sin(a), 1.2, a + np.pi)
        for a in (0.5, 2.6, 4.4)
    ])  # fmt: skip
    fine = Camera(
        width=camera.width * _FINE, height=camera.height * _FINE, fx=camera.fx * _FINE,
        fy=camera.fy * _FINE, cx=camera.cx * _FINE, cy=camera.cy * _FINE,
    )  # fmt: skip

    def draw(cloud: GaussianCloud, by: Camera = camera) -> tuple[F64, F64]:
        seen = RendererCpu(cloud, RenderOptions(rgb_float=True)).render(
            by, views, background=(0.5, 0.5, 0.5)
        )
        assert seen.rgb is not None and seen.alpha is not None
        return np.clip(seen.rgb, 0, 1).astype(np.float64), seen.alpha.astype(np.float64)

    rgb, alpha = draw(clouds[0], fine)
    shape = (len(views), camera.height, _FINE, camera.width, _FINE)
    truth, opaque = rgb.reshape(*shape, 3).mean(axis=(2, 4)), alpha.reshape(shape).mean(axis=(2, 4))
    inside = opaque > 0.5
    full, level, before, chance = (draw(clouds[k]) for k in (0, -2, -3, -1))
    area = inside.sum()
    return {
        "level to full": psnr(level[0][inside], full[0][inside]),
        "level to before": psnr(level[0][inside], before[0][inside]),
        "chance": psnr(chance[0][inside], full[0][inside]),
        "level to truth": psnr(level[0][inside], truth[inside]),
        "full to truth": psnr(full[0][inside], truth[inside]),
        "area": float((level[1] > 0.5).sum() / area),
        "full area": float((full[1] > 0.5).sum() / area),
    }


def _instance_rows(person: Avatar) -> list[FigureRow]:
    """A person as an instance, and the same splats moved."""
    cloud, camera = person.pose(stride_pose()), flat_camera(224, 224)
    renderer = RendererCpu(build_flat(300_000))
    renderer.name_cloud("person", cloud)
    worst, depth = np.inf, 0.0
    for k, turn in enumerate(np.arange(6) + 0.4):
        view, pose = _place(1.5 + 0.5 * k, turn)
        instance = Instance("person", pose, _GAIN)
        one = renderer.render(camera, view, parts=[instance])
        two = renderer.render(camera, view, extra=move_instance(cloud, instance))
        assert one.rgb is not None and two.rgb is not None
        assert one.depth is not None and two.depth is not None
        worst = min(worst, psnr(one.rgb, two.rgb, 255.0))
        finite = np.isfinite(one.depth) & np.isfinite(two.depth)
        off = np.abs(one.depth[finite] - two.depth[finite])
        depth = max(depth, float(np.quantile(off, 0.999)))
    detail = "300,000 splats, 224 x 224, 1.5 to 4 m, gain by normal, worst of six"
    return [
        row_at_least("instance against moved splats", float(min(worst, 200.0)), 75, "dB", detail),
        row_at_most("its depth, 99.9 %", 1e3 * depth, 0.1, "mm", detail),
    ]


def _time_rows(levels: Sequence[tuple[Avatar, ...]]) -> list[FigureRow]:
    """What people add to a static picture, as a share of its time, by turns."""
    camera, views = flat_camera(224, 224), flat_views(_VIEWS)
    renderer, bank = RendererCpu(build_flat(300_000)), PosedBank()
    crowd = (
        (1.8, -0.6), (2.5, 0.5), (3.0, -1.1), (3.4, 0.1), (4.0, 1.4),
        (4.3, -0.5), (5.0, 0.9), (6.0, 0.0),
    )  # fmt: skip

    works: dict[str, tuple[tuple[float, float], ...]] = {
        "static": (), "one": ((2.0, 0.0),), "level": ((2.0, 0.01),), "far": ((4.1, 0.0),),
        "eight": crowd, "near": ((1.2, 0.0),), "near level": ((1.2, 0.01),),
    }  # fmt: skip
    whole = works["one"], works["near"]

    def draw(view: F64, places: Sequence[tuple[float, float]]) -> None:
        wanted = []
        for k, place in enumerate(places):
            level = choose_level(float(np.hypot(*place)), camera.fx)
            avatar = levels[k % len(levels)][0 if places in whole else level]
            wanted.append(((k % len(levels), len(avatar)), partial(avatar.pose, stride_pose())))
        found = bank.fetch(wanted)
        bank.tell(renderer, found)
        parts = [
            Instance(each.name, _stand(view, *place), _GAIN)
            for each, place in zip(found, places, strict=True)
        ]
        renderer.render(camera, view, parts=parts, outputs=("rgb", "depth"))

    spent = {name: np.empty((_ROUNDS, _VIEWS)) for name in works}
    posing = np.inf
    for turn in range(-1, _ROUNDS):  # the first one warms up
        for v, view in enumerate(views):
            for name, places in works.items():
                draw(view, places)
                start = time.perf_counter()
                draw(view, places)
                spent[name][turn, v] = time.perf_counter() - start
        start = time.perf_counter()
        levels[0][QUARTER].pose(stride_pose())
        posing = min(posing, time.perf_counter() - start)
    each = {name: float(np.median(taken, axis=0).mean()) for name, taken in spent.items()}
    share = {name: each[name] / each["static"] - 1.0 for name in works}
    detail = f"standard flat, 300,000 splats, 224 x 224, RGB and depth, {_VIEWS} views, bank and "
    detail += "gains included, poses there; ms: "
    detail += ", ".join(f"{name} {1e3 * seconds:.2f}" for name, seconds in each.items())
    counts = ", ".join(f"{len(level):,}" for level in levels[0])
    return [
        row_at_most("one person at 2 m, all splats", share["one"], 0.45, "of static", detail),
        _plain("one person at 2 m, at its level", share["level"], "of static", detail),
        row_at_most("one person at 4.1 m, at its level", share["far"], 0.14, "of static", detail),
        row_at_most("eight people at 1.8 to 6 m", share["eight"], 1.8, "of static", detail),
        _plain("one person at 1.2 m, all splats", share["near"], "of static", detail),
        _plain("one person at 1.2 m, at its level", share["near level"], "of static", detail),
        _plain(
            f"posing level {QUARTER}, joints included",
            1e3 * posing,
            "ms",
            f"levels of {counts} splats",
        ),
    ]


_GAIN = np.array([[0.8, 0.8, 0.9], [0.2, 0.1, 0.0], [-0.2, 0.0, 0.1], [0.1, 0.1, 0.1]], np.float32)


def _place(distance: float, turn: float) -> tuple[F64, F64]:
    """A view in the largest room of the flat, and somebody before it."""
    view = view_from_pose(6.5, 1.0, 1.25, np.pi / 2 - 0.02)
    pose = _stand(view, distance, 0.0)
    c, s = np.cos(turn), np.sin(turn)
    pose[:2, :2] = (c, -s), (s, c)
    return view, pose


def _stand(view: F64, ahead: float, right: float) -> F64:
    """Pose on the floor of somebody before a level view."""
    pose = np.eye(4)
    pose[:3, 3] = (np.linalg.inv(view) @ (right, 0.0, ahead, 1.0))[:3]
    pose[2, 3] = 0.0
    return pose


def _plain(name: str, value: float, unit: str, detail: str) -> FigureRow:
    return FigureRow(name=name, value=value, unit=unit, detail=detail)


FIGURES = [
    Figure("avatars.looks", "People in the CPU renderer: light, levels, time", measure_looks, 2.0)
]
