"""Episodes side by side: what `--agents` does for a run whose policy looks at pictures."""

from __future__ import annotations

import json

from gn0.bench.results import load_results
from gn0.bench.runner import run_suite
from gn0.render.open import name_drawing
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.suites.suite import build_suite, load_suite
from gn0_figures.board import Figure, FigureContext, FigureRow

EPISODES, STEPS, AGENTS = 64, 40, (1, 16, 64)
SPACING = 0.02  # m between splats
SAME = ("results.jsonl", "trajectories.jsonl", "summary.json")


def measure_agents(ctx: FigureContext) -> list[FigureRow]:
    """Steps a second of one worker with 1, 16 and 64 agents, and whether results differ."""
    folder = ctx.work
    scene = folder / "flat"
    flat = build_example_scene(spacing=SPACING)
    save_scene(flat, scene)
    build_suite([scene], folder / "suite", EPISODES, 0, max_steps=STEPS)
    suite = load_suite(folder / "suite")
    spent: dict[int, float] = {}
    outputs: list[list[bytes]] = []
    for agents in AGENTS:
        ctx.progress("bench.agents", len(spent), len(AGENTS))
        for part in ("warm", "run"):  # kernels, pictures of maps
            out = folder / f"{part}-{agents}"
            run_suite(
                suite, "crowd", out, agents=agents, plugin_modules=("gn0_figures.crowd_policy",),
                max_episodes=agents if part == "warm" else None,
            )  # fmt: skip
            spent[agents] = json.loads((out / "run.json").read_text())["seconds"]
        outputs.append([(out / name).read_bytes() for name in SAME])
    steps = sum(r.metrics.steps for r in load_results(out) if r.metrics)
    drawn = name_drawing("auto")
    detail = f"{EPISODES} episodes of {STEPS} steps in the built-in flat "
    detail += f"({len(flat.gaussians):,} splats), RGB and depth 480x360, "
    detail += f"one worker, drawn by {drawn}, a policy that costs nothing, without the start"
    rows = [
        FigureRow(name=f"steps, {agents} agents", value=steps / s, unit="/s", detail=detail)
        for agents, s in spent.items()
    ]
    equal = all(output == outputs[0] for output in outputs)
    rows.append(
        FigureRow(name="results that differ", value=float(not equal), unit="", detail=detail)
    )
    return rows


FIGURES = [Figure("bench.agents", "Episodes side by side", measure_agents, 5.0)]
