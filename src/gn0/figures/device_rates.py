"""Figures of what is built on the device renderer: simulation, the device suite, its sanitizers."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

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
FILE_LIMIT, TOOL_LIMIT = 150.0, 130.0  # s, for a file of the suite, and for a tool
_HANGS = ("-o", f"faulthandler_timeout={FILE_LIMIT - 50:.0f}")  # s; says where
_LAST = re.compile(r"^=+ (.*) in [\d.]+s.*$", re.MULTILINE)
_COUNTS = re.compile(r"(\d+) (passed|failed|skipped|errors?|deselected)")
_RESULT = re.compile(r" (PASSED|FAILED|SKIPPED|ERROR)\b.*\[ *\d+%\]")
_SKIPPED = re.compile(r"^SKIPPED \[\d+\] \S+ (.*)$", re.MULTILINE)
_FAILED = re.compile(r"^(?:FAILED|ERROR) (.*)$", re.MULTILINE)
_TOLD = (0, 1, 5)  # exit codes of pytest that its last line explains; 5: all were deselected


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
    """`pytest tests/gpu tests/device/test_card.py`, a process a file, from a checkout.

    So a lost card, or a kernel that never ends, costs the rest of one file.

    Raises:
        FigureSkipped: this is no checkout.
    """
    paths, rows = [CARD, *sorted(SUITE.glob("test_*.py"))], []
    if is_emulation(ctx.device):  # the normal tests run them all
        paths = [CARD, SUITE / "test_input.py"]
    for path in paths:
        rows.append(_run_file(ctx, path))
        ctx.report(rows[-1])
    return rows


def _run_file(ctx: FigureContext, path: Path) -> FigureRow:
    """How many tests of a file fail; those that it did not come to count as one."""
    done = _pytest(ctx, [path], ["-v", "--tb=short", *_HANGS], [], FILE_LIMIT)
    last = (_LAST.findall(done.said) or [""])[-1]
    counts = {word: int(n) for n, word in _COUNTS.findall(last)}
    failed = sum(counts.get(word, 0) for word in ("failed", "error", "errors"))
    failed = max(failed, int(done.code == 1))
    ended = ", ".join(f"{n} {word}" for word, n in counts.items()) + f", {done.seconds:.0f} s"
    if done.code not in _TOLD:
        seen = _RESULT.findall(done.said)
        failed = 1 + sum(word in ("FAILED", "ERROR") for word in seen)
        how = "ran out of time" if done.code is None else f"ended with {done.code}"
        ended = f"{how} after {len(seen)} tests, {done.seconds:.0f} s"
    reasons = sorted(set(_SKIPPED.findall(done.said)))
    detail = "; ".join([ended, *_FAILED.findall(done.said), *reasons])
    if failed:
        print(done.said[-6000:])  # noqa: T201
    return row_at_most(f"tests that fail, {path.name}", failed, 0, "tests", detail[:1500])


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
        done = _pytest(ctx, [SUITE], ["-m", "small"], [sanitizer, "--tool", tool], TOOL_LIMIT)
        found = _SUMMARY.findall(done.said)
        if not found:
            how = "ran out of time" if done.code is None else f"ended with {done.code}"
            print(f"{tool} {how}, with no summary: {done.said[-3000:]}")  # noqa: T201
            continue
        errors = sum(int(n) for n in found)
        ended = "tests pass" if done.code == 0 else "a test failed or an error was found"
        detail = f"{ended}, {done.seconds:.0f} s"
        rows.append(row_at_most(f"{tool}, errors", errors, 0, "errors", detail))
        ctx.report(rows[-1])
        if errors or done.code:
            print(done.said[:4000], done.said[-2000:], sep="\n...\n")  # noqa: T201
    if len(rows) < len(_TOOLS):
        raise RuntimeError(f"{len(_TOOLS) - len(rows)} of {len(_TOOLS)} tools came to no end")
    return rows


class _Run(NamedTuple):
    """A run of pytest: all that it said, its exit code (None: stopped), and its seconds."""

    said: str
    code: int | None
    seconds: float


def _pytest(
    ctx: FigureContext, paths: list[Path], arguments: list[str], before: list[str], limit: float
) -> _Run:
    if not SUITE.is_dir():
        raise FigureSkipped("needs a checkout: tests/gpu is not part of the package")
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}  # what is said outlives a kill
    if is_emulation(ctx.device):
        environment["GN0_DEVICE"] = "host"
    if ctx.data is not None:
        environment["GN0_DATA"] = str(ctx.data)
    if ctx.scenes is not None:
        environment["GN0_FIGURE_SCENES"] = str(ctx.scenes.resolve())
    command = [sys.executable, "-m", "pytest", *map(str, paths), "-p", "no:cacheprovider"]
    begin, said = time.monotonic(), ctx.work / "said.txt"
    with said.open("w") as stream:
        process = subprocess.Popen(
            [*before, *command, *arguments],
            cwd=SUITE.parent.parent,
            env=environment,
            stdout=stream,
            stderr=subprocess.STDOUT,
            process_group=0,
        )
        code: int | None = None
        try:
            code = process.wait(limit)
        except subprocess.TimeoutExpired:
            pass
        finally:  # a kernel that never ends ends with its process
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    return _Run(said.read_text(errors="replace"), code, time.monotonic() - begin)


Measure = Callable[[FigureContext], list[FigureRow]]


def _figure(name: str, title: str, measure: Measure, minutes: float) -> Any:
    return Figure(f"render.cuda.{name}", f"CUDA: {title}", measure, minutes, backend="cuda")


FIGURES = [
    _figure("sim", "steps a second on the device", measure_sim, 1.5),
    _figure("suite", "the device suite", measure_suite, 3.0),
    _figure("sanitizers", "compute-sanitizer over the small device tests", measure_sanitizers, 3.0),
]
