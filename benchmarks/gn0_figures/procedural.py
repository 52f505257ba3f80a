"""Generated flats: walkability, variety, and what a scene costs."""

from __future__ import annotations

import time
from collections import Counter

import numpy as np

from gn0.maps.navigation import NavigationMap
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.apartment import draft_apartment
from gn0.scenes.procedural.building import AGENT_RADIUS, check_reach
from gn0.scenes.procedural.generate import GenerateSettings, floor_area, generate_scene
from gn0.scenes.procedural.plan import plan_apartment
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.splat_reach import FIGURES as REACH_FIGURES
from gn0_figures.surfels import FIGURES as SURFEL_FIGURES

SEEDS = range(20)
SIZES = ("small", "medium", "large")


def measure_flats(ctx: FigureContext) -> list[FigureRow]:
    """Twenty flats of all sizes: rooms reached, doors passable, categories, density of things."""
    rooms = reached = doors = passable = 0
    every: Counter[str] = Counter()
    least, seconds, things, share, faces = 99, [], [], [], []
    for seed in SEEDS:
        ctx.progress("flats", seed, len(SEEDS))
        size = SIZES[seed % 3]
        start = time.perf_counter()
        draft = draft_apartment(seed, size=size)
        seconds.append(time.perf_counter() - start)
        plan = plan_apartment(seed, size)
        grid = build_occupancy(draft.mesh)
        reach = check_reach(draft, plan, grid)
        navigation = NavigationMap(grid, AGENT_RADIUS)
        rooms += len(plan.rooms)
        reached += len(plan.rooms) - len(reach.cut_off)
        share.append(reach.share)
        for o in plan.openings:
            if o.kind in ("door", "passage"):
                doors += 1
                passable += navigation.region_of(*o.centre) == 0
        here = {o.category for o in draft.objects}
        every.update(here)
        least = min(least, len(here))
        things.append(len(draft.objects) / floor_area(draft))
        faces.append(len(draft.mesh))
    detail = "seeds 0-19, sizes small, medium, large in turn, agent radius 0.20 m"
    return [
        row_at_least("rooms reached from the hall", 100 * reached / rooms, 100, "%", detail),
        row_at_least("doors passable", 100 * passable / doors, 100, "%", detail),
        row_at_least(
            "free floor in the main region, worst flat", 100 * min(share), 90, "%", detail
        ),
        row_at_least("object categories, all flats", len(every), 30, "categories", detail),
        row_at_least("object categories, fewest in a flat", least, 25, "categories", detail),
        FigureRow(
            name="objects a m² of floor", value=float(np.mean(things)), unit="/m²", detail=detail
        ),
        FigureRow(
            name="triangles, median", value=float(np.median(faces)), unit="faces", detail=detail
        ),
        FigureRow(
            name="furnishing with its check, median",
            value=float(np.median(seconds)),
            unit="s",
            detail=detail,
        ),
    ]


def measure_generation(ctx: FigureContext) -> list[FigureRow]:
    """Seed to scene folder: the default, and the small one that `make demo` makes."""
    rows = []
    for name, settings, limit in (
        ("default apartment", GenerateSettings(seed=7), 45.0),
        ("small apartment, 6,000 a m²", GenerateSettings(seed=7, size="small", density=6000), 25.0),
    ):
        start = time.perf_counter()
        scene = generate_scene(
            settings, ctx.work / f"flat-{settings.size}", overwrite=True, progress=ctx.progress
        )
        seconds = time.perf_counter() - start
        count = len(scene.gaussians)
        detail = f"seed 7, {settings.size}, {settings.density:g} a m², {count:,} Gaussians"
        rows.append(row_at_most(f"{name}, seed to folder", seconds, limit, "s", detail))
    return rows


FIGURES = [
    Figure("procedural.flats", "Generated flats: walkable and full", measure_flats, 1.5),
    Figure("procedural.generate", "Generating a scene folder", measure_generation, 2.0),
    *SURFEL_FIGURES,
    *REACH_FIGURES,
]
