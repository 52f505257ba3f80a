"""Generated buildings of every kind: floor, objects, categories, reach, over ten seeds each."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass

import numpy as np

from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.building import AGENT_RADIUS, Reach, check_reach
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.generate import floor_area
from gn0.scenes.procedural.kinds import KINDS, KindName
from gn0.scenes.procedural.plan import FloorPlan, Room
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least

SEEDS = range(10)


@dataclass(frozen=True)
class KindTarget:
    """What a kind should come to in the mean; None where nothing is asked.

    Attributes:
        kind: of building.
        area: least and greatest mean floor [m²].
        objects: least and greatest mean number of objects.
    """

    kind: KindName
    area: tuple[float, float] | None = None
    objects: tuple[float, float] | None = None


# the paper: handcrafted scenes 374.5 m² and 2,321 objects, InteriorGS 150.1 m² and 503 objects
TARGETS = (
    KindTarget("office", (374.5 * 0.75, 374.5 * 1.25), (2000, np.inf)),
    KindTarget("supermarket", (374.5 * 0.75, 374.5 * 1.25), (2000, np.inf)),
    KindTarget("warehouse"),
    KindTarget("corridor"),
    KindTarget("residence", (150 * 0.85, 150 * 1.15), (500 * 0.8, 500 * 1.2)),
    KindTarget("courtyard"),
)


def reach_of(draft: SceneDraft) -> Reach:
    """What an agent reaches in a draft, from its rooms or zones alone."""
    rooms = []
    for room in draft.rooms:
        low, high = np.min(room.polygon, axis=0), np.max(room.polygon, axis=0)
        rooms.append(
            Room(room.id, room.type, float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        )
    plan = FloorPlan(tuple(rooms), (), (), draft.ceiling)
    return check_reach(draft, plan, build_occupancy(draft.mesh))


def row_within(
    name: str, value: float, limits: tuple[float, float] | None, unit: str, detail: str
) -> FigureRow:
    """A row that passes within limits, or that has none."""
    if limits is None:
        return FigureRow(name=name, value=value, unit=unit, detail=detail)
    low, high = limits
    span = f"{low:.0f}–{high:.0f}" if np.isfinite(high) else f"> {low:.0f}"
    return FigureRow(
        name=name,
        value=value,
        unit=unit,
        target=f"{span} {unit}",
        passed=bool(low < value <= high),
        detail=detail,
    )


def measure_kinds(ctx: FigureContext) -> list[FigureRow]:
    """Ten drafts of each kind at its default size: nothing is lit, which would change nothing."""
    rows = []
    for number, target in enumerate(TARGETS):
        areas, objects, seconds, share = [], [], [], []
        every: Counter[str] = Counter()
        least, rooms, cut_off = 9999, 0, 0
        for seed in SEEDS:
            ctx.progress("kinds", number * len(SEEDS) + seed, len(TARGETS) * len(SEEDS))
            start = time.perf_counter()
            draft = KINDS[target.kind].draft(seed, size="medium")
            seconds.append(time.perf_counter() - start)
            reach = reach_of(draft)
            here = {o.category for o in draft.objects}
            every.update(here)
            areas.append(floor_area(draft))
            objects.append(len(draft.objects))
            least = min(least, len(here))
            rooms += len(draft.rooms)
            cut_off += len(reach.cut_off)
            share.append(reach.share)
        detail = f"seeds 0-9, medium, agent radius {AGENT_RADIUS:.2f} m"
        spread = f"{detail}; {min(areas):.0f} to {max(areas):.0f}"
        counts = f"{detail}; {min(objects):,} to {max(objects):,}; furnished in "
        counts += f"{np.median(seconds):.1f} s"
        kind = target.kind
        rows += [
            row_within(f"{kind}: mean floor", float(np.mean(areas)), target.area, "m²", spread),
            row_within(
                f"{kind}: mean objects", float(np.mean(objects)), target.objects, "objects", counts
            ),
            row_at_least(
                f"{kind}: categories, fewest in one", least, 30, "categories",
                f"{detail}; {len(every)} in all",
            ),
            row_at_least(
                f"{kind}: rooms reached", 100 * (rooms - cut_off) / rooms, 100, "%", detail
            ),
            row_at_least(
                f"{kind}: free floor in one piece, worst", 100 * min(share), 90, "%", detail
            ),
        ]  # fmt: skip
    return rows


FIGURES = [Figure("data.scenes", "Generated buildings of every kind", measure_kinds, 4.0)]
