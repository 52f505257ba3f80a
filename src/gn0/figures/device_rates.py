"""Figures of what is built on the device renderer: simulation, the device suite, its sanitizers."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gn0.figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    FigureSkipped,
    row_at_least,
    row_at_most,
)
from gn0.figures.device import interleave, is_emulation, median
from gn0.figures.flat import build_flat, flat_floor
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.presets import find_preset
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes

WALK = [0.01, 0.59, 0.2, 0.2]  # STOP, FORWARD, LEFT, RIGHT: an episode of about 100 steps
STEPS = 2e6  # agent-steps a second, at least, of 4096 agents without pictures
PICTURES = 15e3  # env-steps a second, at least, with 224x224 RGB-D over a million splats
SUITE = Path(__file__).resolve().parents[3] / "tests" / "gpu"
CARD = SUITE.parent / "device" / "test_card.py"  # what only a card can answer
_TOOLS = ("memcheck", "racecheck", "initcheck", "synccheck")
_SUMMARY = re.compile(r"(?:ERROR|RACECHECK) SUMMARY: (\d+)")


def _rate(env: VectorEnvDevice, steps: int) -> float:
    """Agent-steps a second through `step()` with actions on the device, autoresets included."""
    env.reset(seed=0)
    drawn = random_stream(0, "figure actions").choice(4, (steps, env.num_envs), p=WALK)
    actions = env.device.upload(drawn.astype(np.int64))

    def walk(turn: int) -> None:
        for t in range(steps):
            env.step(actions[t])

    times = interleave(env.device, {"": walk}, 5, warm=1)
    env.synchronize()
    return steps * env.num_envs / median(times[""]) * 1e3


def _plans(count: int, size: float) -> tuple[list[Scene], list[Episode]]:
    scenes = [
        build_map_scene(build_floor_plan(k, width=size, depth=size), f"plan-{k}")
        for k in range(count)
    ]
    maps = [NavigationMap(scene.grid, 0.2) for scene in scenes]
    pairs = zip(scenes, maps, strict=True)
    return scenes, [e for scene, plan in pairs for e in build_point_episodes(scene, plan, 25)]


def measure_sim(ctx: FigureContext) -> list[FigureRow]:
    """Steps a second on the device, without pictures and with RGB-D."""
    tiny = is_emulation(ctx.device)
    rows: list[FigureRow] = []

    def add(name: str, rate: float, least: float, detail: str) -> None:
        if tiny:
            rows.append(FigureRow(name=name, value=rate, unit="1/s", detail=detail))
        else:
            rows.append(row_at_least(name, rate, least, "1/s", detail))
        ctx.report(rows[-1])

    count, steps = (8, 3) if tiny else (4096, 200)
    scenes, episodes = _plans(1, 6.0) if tiny else _plans(8, 20.0)
    env = VectorEnvDevice(count, scenes, episodes=episodes, device=ctx.device)
    detail = f"{len(scenes)} floor plans, {len(episodes)} episodes, {count} agents, goal_vector"
    detail += "; random walk with 1 % STOP, actions on the device, autoresets included"
    add("agent-steps a second, no pictures", _rate(env, steps), STEPS, detail)
    del env
    cloud = build_flat(1500 if tiny else 1_000_000)
    flat = replace(
        build_map_scene(flat_floor(0.0), "flat"),
        load_cloud=lambda: cloud,
        cloud_hash=cloud.content_hash,
    )
    episodes = build_point_episodes(flat, NavigationMap(flat.grid, 0.2), 4 if tiny else 200)
    for sets in (False, True):
        if tiny and sets:
            continue  # thirty pictures of 640x640 a cell: too much for an emulation
        count, steps = (2, 2) if tiny else (1024, 24)
        env = VectorEnvDevice(
            *(count, flat),
            episodes=episodes,
            device=ctx.device,
            sensors=("rgb", "depth", "goal_vector"),
            preset="rgbd_224",
            visible_sets=sets,
        )
        size = find_preset("rgbd_224").rgb
        detail = (
            f"standard flat of {len(cloud) / 1e6:g} M splats, {count} agents, RGB-D of "
            f"{size.width}x{size.height}; tensors stay on the device"
        )
        name = "env-steps a second with RGB-D, " + ("visible sets" if sets else "full set")
        add(name, _rate(env, steps), PICTURES, detail)
        del env
    return rows


def measure_suite(ctx: FigureContext) -> list[FigureRow]:
    """`pytest tests/gpu tests/device/test_card.py`, from a checkout.

    Raises:
        FigureSkipped: this is no checkout.
    """
    report = ctx.work / "suite.xml"
    part = ["-m", "small"] if is_emulation(ctx.device) else []
    done = _pytest(ctx, [str(CARD), *part, "--junitxml", str(report)], [])
    if not report.exists():
        raise RuntimeError(f"the suite did not run: {(done.stdout + done.stderr)[-3000:]}")
    suites = list(ET.parse(report).getroot().iter("testsuite"))  # noqa: S314

    def total(name: str) -> int:
        return sum(int(suite.get(name, 0)) for suite in suites)

    failed, skipped = total("failures") + total("errors"), total("skipped")
    passed = total("tests") - failed - skipped
    print(done.stdout[-6000:])  # noqa: T201
    reasons = sorted(
        {node.get("message", "") for suite in suites for node in suite.iter("skipped")}
    )
    detail = f"{passed} passed, {skipped} skipped" + "".join(f"; {reason}" for reason in reasons)
    return [
        row_at_most("device tests that fail", failed, 0, "tests", detail),
        FigureRow(name="device tests that pass", value=passed, unit="tests", detail=detail),
    ]


def measure_sanitizers(ctx: FigureContext) -> list[FigureRow]:
    """NVIDIA's checkers over the small device tests.

    Raises:
        FigureSkipped: no compute-sanitizer here, or no card for it, or no checkout.
    """
    sanitizer = shutil.which("compute-sanitizer")
    if sanitizer is None:
        raise FigureSkipped("needs compute-sanitizer (of the CUDA toolkit)")
    if is_emulation(ctx.device):
        raise FigureSkipped("compute-sanitizer checks kernels on a card, not their emulation")
    rows = []
    for tool in _TOOLS:
        done = _pytest(ctx, ["-m", "small"], [sanitizer, "--tool", tool])
        found = _SUMMARY.search(done.stdout + done.stderr)
        if found is None:
            raise RuntimeError(f"{tool} said nothing: {(done.stdout + done.stderr)[-3000:]}")
        ended = "tests pass" if done.returncode == 0 else "a test failed or an error was found"
        rows.append(row_at_most(f"{tool}, errors", int(found[1]), 0, "errors", ended))
        ctx.report(rows[-1])
        if int(found[1]):
            print((done.stdout + done.stderr)[:8000])  # noqa: T201
    return rows


def _pytest(
    ctx: FigureContext, arguments: list[str], before: list[str]
) -> subprocess.CompletedProcess[str]:
    if not SUITE.is_dir():
        raise FigureSkipped("needs a checkout: tests/gpu is not part of the package")
    environment = dict(os.environ)
    if is_emulation(ctx.device):
        environment["GN0_DEVICE"] = "host"
    if ctx.data is not None:
        environment["GN0_DATA"] = str(ctx.data)
    if ctx.scenes is not None:
        environment["GN0_FIGURE_SCENES"] = str(ctx.scenes.resolve())
    command = [sys.executable, "-m", "pytest", str(SUITE), "-q", "-p", "no:cacheprovider"]
    return subprocess.run(
        [*before, *command, *arguments],
        cwd=SUITE.parent.parent,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


Measure = Callable[[FigureContext], list[FigureRow]]


def _figure(name: str, title: str, measure: Measure, minutes: float) -> Any:
    return Figure(f"render.cuda.{name}", f"CUDA: {title}", measure, minutes, backend="cuda")


FIGURES = [
    _figure("sim", "steps a second on the device", measure_sim, 1.5),
    _figure("suite", "the device suite", measure_suite, 3.0),
    _figure("sanitizers", "compute-sanitizer over the small device tests", measure_sanitizers, 3.0),
]
