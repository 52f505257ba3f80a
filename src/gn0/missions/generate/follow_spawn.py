"""Algorithm 4, lines 5 to 7: where person and agent begin, and who keeps what distance."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gn0.geometry import F64
from gn0.maps.ray import is_line_free
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.missions.generate.human_path import cut_way
from gn0.people.person import RADIUS

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap

_STEP = 0.1  # m by which the agent comes nearer until there is room for it


class Spawn(NamedTuple):
    """Where a follow mission begins: the agent's pose, and the way left to the person [N, 2] m."""

    start: tuple[float, float, float]
    way: F64


def draw_offsets(settings: FollowSettings, rng: np.random.Generator) -> tuple[float, float]:
    """What the agent keeps: d behind and ℓ to the right [m] (paper, SampleOffsets)."""
    distance = round(float(rng.uniform(*settings.distances)), 2)
    return distance, round(float(rng.uniform(-settings.lateral, settings.lateral)), 2)


def spawn_behind(
    navigation: NavigationMap,
    way: F64,
    distance: float,
    lateral: float,
    settings: FollowSettings,
    radius: float,
) -> Spawn | None:
    """Where agent and person begin (paper, SpawnBehind); None where there is no room for it.

    The agent begins at the way's start, the person ahead on it by d; else the person begins
    there, and the agent behind it; ℓ to the side, else straight behind.

    Args:
        navigation: the agent's map.
        way: the person's whole way [N, 2] m.
        distance: d [m].
        lateral: ℓ [m].
        settings: the least distance, and how long the person's way must be.
        radius: of the agent [m].
    """
    least = max(settings.spawn_nearest, radius + RADIUS + 0.05)
    arcs = float(np.hypot(*np.diff(way, axis=0).T).sum())
    for begin, reach in _choices(distance, least, arcs, settings.least_length):
        rest = cut_way(way, begin)
        if len(rest) < 2:
            continue
        x, y = map(float, rest[0])
        ahead = rest[1] - rest[0]
        size = float(np.hypot(*ahead))
        fx, fy = float(ahead[0]) / size, float(ahead[1]) / size
        for aside in (lateral, 0.0):
            px, py = x - reach * fx + aside * fy, y - reach * fy - aside * fx
            if begin > 0.0 and aside == 0.0:  # the way's own start, round a bend or not
                px, py = map(float, way[0])
            if math.dist((px, py), (x, y)) < least or not navigation.is_free(px, py):
                continue
            if navigation.region_of(px, py) != navigation.region_of(x, y):
                continue
            if is_line_free(navigation.grid, (px, py), (x, y)):
                return Spawn((px, py, math.atan2(y - py, x - px)), rest)
    return None


def _choices(
    distance: float, least: float, arcs: float, length: float
) -> Iterator[tuple[float, float]]:
    """(Where the person begins on the way [m], how far behind the agent is [m]), best first."""
    if arcs - distance >= length:
        yield distance, distance
    reach = distance
    while reach >= least:
        yield 0.0, reach
        reach = round(reach - _STEP, 9)
