"""Figures of many at once: steps a second, agreement with the simulator, visible sets."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64, view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.render.camera import Camera
from gn0.render.cpu import STAGES, RendererCpu
from gn0.render.renderer import DrawnScene, RenderOptions, RenderResult, SceneRenderer
from gn0.render.visible import RendererVisible
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.open import open_simulator
from gn0.sim.sensors import SensorSuite
from gn0.sim.vector import VectorEnv
from gn0.testing.renderer_check import psnr
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    build_room_scene,
)
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.flat import EYE, build_flat, flat_camera, flat_floor, flat_views

ENVS = 4096
WALK = [0.01, 0.59, 0.2, 0.2]  # STOP, FORWARD, LEFT, RIGHT: an episode of about 100 steps
ROUNDS = 5
HELD_OUT = 16  # views that no set has looked from


def _plans(count: int, size: float) -> tuple[list[Scene], list[Episode]]:
    scenes = [
        build_map_scene(build_floor_plan(k, width=size, depth=size), f"plan-{k}")
        for k in range(count)
    ]
    episodes = [
        episode
        for scene in scenes
        for episode in build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 25)
    ]
    return scenes, episodes


def _rate(env: VectorEnv, shares: Sequence[float], steps: int) -> float:
    """Agent-steps a second through `step()` with NumPy actions, autoresets included."""
    env.reset(seed=0)
    actions = random_stream(0, "figure actions").choice(4, (steps, env.num_envs), p=shares)
    for row in actions[: steps // 4]:
        env.step(row)
    rates = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for row in actions:
            env.step(row)
        rates.append(actions.size / (time.perf_counter() - start))
    return float(np.median(rates))


def measure_speed(ctx: FigureContext) -> list[FigureRow]:
    """Steps a second without pictures, over eight scenes of 400x400 cells."""
    scenes, episodes = _plans(8, 20.0)
    where = f"8 floor plans of 400x400 cells, {len(episodes)} episodes, {ENVS} environments"
    cases: list[tuple[tuple[str, ...], Sequence[float], str, float | None]] = [
        (("goal_vector",), WALK, "random walk, 1 % STOP", 1e6),
        ((), WALK, "random walk, 1 % STOP", None),
        (("goal_vector",), [0.25] * 4, "uniform actions, an autoreset every 4 steps", None),
        (("goal_vector", "ranges"), WALK, "random walk, 1 % STOP, 72 rays a step", None),
    ]
    rows = []
    for done, (sensors, shares, how, least) in enumerate(cases):
        ctx.progress("vector.speed", done, len(cases))
        env = VectorEnv(ENVS, scenes, episodes=episodes, sensors=sensors)
        rate = _rate(env, shares, 12 if "ranges" in sensors else 200)
        name = f"steps a second, {', '.join(sensors) or 'no sensor'}, {how}"
        detail = f"{where}; step() with NumPy actions, autoresets included, median of {ROUNDS}"
        if least is None:
            rows.append(FigureRow(name=name, value=rate, unit="1/s", detail=detail))
        else:
            rows.append(row_at_least(name, rate, least, "1/s", detail))
        if sensors == ("goal_vector",) and shares is WALK:
            single = _single_rate(scenes[0], episodes[0])
            rows.append(
                FigureRow(
                    name="the same, against one Simulator stepped in a loop",
                    value=rate / single,
                    unit="times",
                    detail=f"Simulator: {single:.0f} steps a second in this run",
                )
            )
    return rows


def _single_rate(scene: Scene, episode: Episode) -> float:
    simulator = open_simulator(scene, sensors={"goal_vector"}, max_steps=10**9)
    simulator.reset(episode)
    actions = random_stream(0, "figure actions").choice(4, 20_000, p=[0, 0.6, 0.2, 0.2]).tolist()
    start = time.perf_counter()
    for action in actions:
        simulator.step(action)
    return len(actions) / (time.perf_counter() - start)


def count_differences(scenes: Sequence[Scene], episodes: Sequence[Episode], rounds: int) -> int:
    """Of 100 · rounds random actions, those after which a `Simulator` would stand elsewhere.

    Pose (bit for bit), collision and end are compared; scenes and autoresets are mixed.
    """
    count = 100
    env = VectorEnv(count, scenes, episodes=episodes, sensors=(), max_steps=60)
    twins = {scene.id: open_simulator(scene, max_steps=60) for scene in scenes}
    by_id = {episode.id: episode for episode in episodes}
    _, infos = env.reset(seed=1)

    def begin(name: str) -> Any:
        twin = twins[by_id[name].scene_id]
        twin.reset(by_id[name])
        return twin, twin.save_state()

    states = [begin(name) for name in infos["episode_id"]]
    different = 0
    for row in random_stream(1, "figure equality").choice(4, (rounds, count), p=WALK):
        observation, _, terminated, truncated, infos = env.step(row)
        for i, (twin, state) in enumerate(states):
            twin.restore_state(state)
            result = twin.step(int(row[i]))
            ended = result.terminated or result.truncated
            last = infos["final_info"] if ended else infos
            bumped = infos["final_obs"][i]["collided"] if ended else observation["collided"][i]
            different += not (
                tuple(last["pose"][i]) == twin.pose
                and bumped == result.collided
                and (terminated[i], truncated[i]) == (result.terminated, result.truncated)
            )
            states[i] = begin(infos["episode_id"][i]) if ended else (twin, twin.save_state())
    return different


def measure_equality(ctx: FigureContext) -> list[FigureRow]:
    """A hundred thousand random actions, against `Simulator`."""
    scenes, episodes = _plans(4, 12.0)
    found = count_differences(scenes, episodes, 1000)
    detail = (
        "100 environments, 4 floor plans, autoresets included; pose bit for bit, collision, end"
    )
    return [row_at_most("steps that differ from Simulator, of 100,000", found, 0, "steps", detail)]


@dataclass(frozen=True, eq=False)
class _SceneCounting(DrawnScene):
    """Hands calls on and counts them."""

    calls: list[int] = field(default_factory=list)

    def render(self, camera: Camera, views: Any, **settings: Any) -> RenderResult:
        self.calls.append(len(views))
        return super().render(camera, views, **settings)


def measure_pictures(ctx: FigureContext) -> list[FigureRow]:
    """Pictures of many: calls of the renderer, equality with the simulator, steps a second."""
    count, steps = 16, 12
    scenes = [replace(build_room_scene(), id=name) for name in ("left", "right")]
    episodes = [
        episode
        for scene in scenes
        for episode in build_point_episodes(
            scene, NavigationMap(scene.grid, 0.2), 8, agent=AgentSpec()
        )
    ]
    settings: dict[str, Any] = {"episodes": episodes, "sensors": ("rgb", "depth"), "max_steps": 8}
    env = VectorEnv(count, scenes, **settings)
    counters: dict[str, _SceneCounting] = {}
    assert env.batch.eyes is not None
    opened = env.batch.eyes.open_suite

    def open_suite(scene_id: str) -> SensorSuite:
        suite = opened(scene_id)
        assert suite.renderer is not None
        counters[scene_id] = _SceneCounting(suite.renderer.renderer)
        suite.renderer = counters[scene_id]
        return suite

    env.batch.eyes.open_suite = open_suite
    observation, infos = env.reset(seed=0)
    twins = {s.id: open_simulator(s, sensors={"rgb", "depth"}, max_steps=8) for s in scenes}
    by_id = {(e.scene_id, e.id): e for e in episodes}
    actions = random_stream(2, "figure pictures").choice(4, (steps, count), p=WALK)
    most, different, spent = 0, 0, 0.0
    for row in actions:
        before = {name: len(counter.calls) for name, counter in counters.items()}
        start = time.perf_counter()
        observation, *_, infos = env.step(row)
        spent += time.perf_counter() - start
        most = max(most, *(len(counters[name].calls) - before.get(name, 0) for name in counters))
        for i in range(count):
            twin = twins[infos["scene_id"][i]]
            twin.reset(by_id[infos["scene_id"][i], infos["episode_id"][i]])
            seen = twin.suite.look(env.batch.pose(i), frozenset({"rgb", "depth"}))
            for name, want in seen.items():
                different += observation[name][i].tobytes() != want.tobytes()
    detail = f"built-in flat as two scenes, {count} environments, gn_bench, autoresets included"
    return [
        row_at_most("renderer calls a scene and step", most, 1, "calls", detail),
        row_at_most(
            *(f"pictures that differ from the simulator's, of {2 * steps * count}", different, 0),
            *("pictures", detail),
        ),
        FigureRow(
            name="steps a second with rgb and depth",
            value=steps * count / spent,
            unit="1/s",
            detail=detail,
        ),
    ]


def _frame_ms(renderer: SceneRenderer, camera: Camera, views: F64) -> float:
    start = time.perf_counter()
    for view in views:  # one frame a call, as a simulator asks for them
        renderer.render(camera, view)
    return (time.perf_counter() - start) / len(views) * 1e3


def judge_sets(
    renderer: RendererVisible, camera: Camera, views: F64
) -> tuple[list[float], float, float, str]:
    """PSNR [dB] of each view to the full set; milliseconds a frame, full and visible; stages."""
    quality = []
    for view in views:
        want, got = renderer.full.render(camera, view), renderer.render(camera, view)
        assert want.rgb is not None and got.rgb is not None
        quality.append(min(psnr(got.rgb, want.rgb, 255), 99.0))
    full, visible = [], []
    before = dict.fromkeys(STAGES, 0.0)
    spent = dict.fromkeys(STAGES, 0.0)
    for _ in range(ROUNDS):  # by turns, so that a busy moment meets both
        full.append(_frame_ms(renderer.full, camera, views))
        before = dict(renderer.full.stage_seconds)
        visible.append(_frame_ms(renderer, camera, views))
        for stage in STAGES:
            spent[stage] += renderer.full.stage_seconds[stage] - before[stage]
    split = ", ".join(f"{s} {spent[s] / ROUNDS / len(views) * 1e3:.1f}" for s in STAGES)
    return quality, float(np.median(full)), float(np.median(visible)), split


def _set_rows(
    ctx: FigureContext,
    where: str,
    cloud: GaussianCloud,
    floor: OccupancyGrid,
    eye: float,
    cases: Sequence[tuple[Camera, F64, float | None]],
) -> list[FigureRow]:
    """Rows of one scene: quality, speed and ratio of each camera, then what the sets cost."""
    full = RendererCpu(cloud, RenderOptions(threads=2))
    key = f"figure {cloud.content_hash} {time.time_ns()}"  # never from an earlier run's cache
    renderer = RendererVisible(full, key, floor, eye)
    cells = sorted({_cell(renderer, view) for _, views, _ in cases for view in views})
    full.render(cases[0][0], cases[0][1][0])
    renderer.find(cells[0])  # compile
    seconds, sizes = [], []
    for done, cell in enumerate(cells):
        ctx.progress(f"visible sets, {where}", done, len(cells))
        start = time.perf_counter()
        sizes.append(renderer.open(cell).size)
        seconds.append(time.perf_counter() - start)
    rows = []
    share = 100.0 * float(np.mean(sizes)) / len(cloud)
    for camera, views, least in cases:
        quality, slow, fast, split = judge_sets(renderer, camera, views)
        name = f"{camera.width}x{camera.height}, {where}"
        detail = (
            f"{len(views)} held-out views, hfov {camera.hfov:.0f}°, two cores, RGB + depth + "
            f"alpha; sets keep {share:.0f} %; full set {1e3 / slow:.0f} frames/s; ms: {split}"
        )
        mean = float(np.mean(quality))
        rows.append(row_at_least(f"visible sets to full set, mean, {name}", mean, 50, "dB", detail))
        rows.append(FigureRow(name=f"the same, worst view, {name}", value=min(quality), unit="dB"))
        rate = f"frames a second with visible sets, {name}"
        if least is None:
            rows.append(FigureRow(name=rate, value=1e3 / fast, unit="frames/s", detail=detail))
        else:
            rows.append(row_at_least(rate, 1e3 / fast, least, "frames/s", detail))
        rows.append(
            FigureRow(
                name=f"visible sets against full set, {name}",
                value=slow / fast,
                unit="times",
                detail="both in this run, by turns, same views",
            )
        )
    again = RendererVisible(full, key, floor, eye)
    start = time.perf_counter()
    for cell in cells:
        again.open(cell)
    assert again.files is not None and not again.built
    detail = f"{len(cells)} cells of 0.5 m, {len(renderer.cells)} in the scene"
    rows += [
        FigureRow(
            name=f"finding a set, {where}",
            value=float(np.median(seconds)),
            unit="s",
            detail=f"{detail}; 5 places, 6 pictures of 640x640 each",
        ),
        FigureRow(
            name=f"reading a set from the cache, {where}",
            value=(time.perf_counter() - start) / len(cells) * 1e3,
            unit="ms",
            detail=detail,
        ),
        FigureRow(
            name=f"cache of the whole scene, {where}",
            value=again.files.nbytes / len(cells) * len(renderer.cells) / 1e6,
            unit="MB",
            detail=f"{detail}; from the mean of those found",
        ),
    ]
    again.files.clear()
    return rows


def _cell(renderer: RendererVisible, view: F64) -> tuple[int, int]:
    x, y, _ = -view[:3, :3].T @ view[:3, 3]
    return renderer.cell_of(float(x), float(y))


def _known_views(floor: OccupancyGrid, count: int) -> F64:
    """Views of the standard flat from places on its floor."""
    views = [
        view
        for view in flat_views(3 * count, seed=11)
        if floor.is_free(*(float(v) for v in (-view[:3, :3].T @ view[:3, 3])[:2]))
    ]
    return np.stack(views[:count])


def measure_visible(ctx: FigureContext) -> list[FigureRow]:
    """Visible sets on the standard flat."""
    floor = flat_floor()
    views = _known_views(floor, HELD_OUT)
    rows = []
    for count, camera, least in (
        (300_000, flat_camera(224, 224), 120.0),
        (1_000_000, flat_camera(640, 480), 35.0),
    ):
        where = f"{count / 1e6:g} M Gaussians, standard flat"
        rows += _set_rows(ctx, where, build_flat(count), floor, EYE, [(camera, views, least)])
    return rows


def measure_visible_scene(ctx: FigureContext) -> list[FigureRow]:
    """Visible sets in a generated flat, for three cameras of well-known benchmarks."""
    from gn0.scenes.procedural.generate import GenerateSettings, build_generated
    from gn0.sim.presets import find_preset

    settings = GenerateSettings(seed=7, size="small", density=10_000, light="draft")
    scene = build_generated(settings, "figure", ctx.progress)
    body = AgentSpec()
    navigation = NavigationMap(scene.grid, body.radius)
    free: NDArray[np.int64] = np.argwhere(navigation.regions == 0)
    stream = random_stream(0, "figure visible")
    cases: list[tuple[Camera, F64, float | None]] = []
    places = navigation.grid.centres_of(free[stream.integers(len(free), size=HELD_OUT)])
    for name, pitch in (("vlnce", 0.0), ("gn_bench", 0.0), ("uninavid", -0.5)):
        views = [
            view_from_pose(x, y, body.camera_height, stream.uniform(-np.pi, np.pi), pitch)
            for x, y in places
        ]
        cases.append((find_preset(name).rgb, np.stack(views), None))
    cloud = scene.gaussians
    where = f"generated flat of {len(cloud) / 1e6:.2f} M Gaussians"
    return _set_rows(ctx, where, cloud, navigation.inflated, body.camera_height, cases)


FIGURES = [
    Figure("vector.speed", "Many at once: steps a second", measure_speed, 0.6),
    Figure("vector.equality", "Many at once: the simulator's trajectories", measure_equality, 0.3),
    Figure("vector.pictures", "Many at once: pictures", measure_pictures, 0.4),
    Figure("vector.visible", "Visible sets on the standard flat", measure_visible, 2.5),
    Figure("vector.visible_scene", "Visible sets in a generated flat", measure_visible_scene, 3.0),
]
