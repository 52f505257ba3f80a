"""What the host arranges view by view: visible sets of views, and moving tails."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device
from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.pack import upload_clouds
from gn0.render.cuda.visible import Cell, VisibleSets

Part = tuple[VisibleSets, Cell]


def views_of(names: list[str]) -> dict[str, list[int]]:
    """Which views each scene has."""
    found: dict[str, list[int]] = {}
    for v, name in enumerate(names):
        found.setdefault(name, []).append(v)
    return found


def list_sets(parts: list[Part | None]) -> list[VisibleSets]:
    """The visible sets that some parts are of, once each."""
    return list({id(part[0]): part[0] for part in parts if part is not None}.values())


def clear_sets(sets: list[VisibleSets]) -> bool:
    """Let go of all sets on the device; whether there were any."""
    return sum(some.clear() for some in sets) > 0


def choose_parts(
    group: dict[str, CloudDevice],
    names: list[str],
    parts: list[Part | None],
    rows: NDArray[np.int64],
) -> tuple[list[CloudDevice], NDArray[np.int32]]:
    """The clouds of views `rows`, whole or in part, once each; and which of them is whose."""
    wanted = [(names[v], parts[v]) for v in rows.tolist()]
    number = {which: n for n, which in enumerate(dict.fromkeys(wanted))}
    clouds = [group[key] for key, _ in number]
    asked: dict[tuple[str, VisibleSets], list[Cell]] = {}
    for key, part in number:
        if part is not None:
            asked.setdefault((key, part[0]), []).append(part[1])
    for (key, sets), cells in asked.items():
        for cell, cloud in sets.open(cells, group[key]).items():
            clouds[number[key, (sets, cell)]] = cloud
    return clouds, np.array([number[which] for which in wanted], np.int32)


def find_parts(
    camera: Camera,
    matrices: F64,
    names: list[str],
    visible: bool | VisibleSets | Sequence[Cell | None] | None,
    sets_of: Mapping[str, VisibleSets],
) -> list[Part | None]:
    """The set that each view is drawn from; None for all splats."""
    found: list[Part | None] = [None] * len(names)
    if visible is None or visible is False:
        return found
    if isinstance(visible, Sequence):
        for v, cell in enumerate(visible):
            if cell is None:
                continue
            if names[v] not in sets_of:
                raise RenderError(
                    f"scene {names[v]!r} has no visible sets",
                    remedy="call limit_to_visible first",
                )
            found[v] = (sets_of[names[v]], cell)
        return found
    for key, mine in views_of(names).items():
        sets = sets_of.get(key) if isinstance(visible, bool) else visible
        if sets is None:
            continue
        for v, cell in zip(mine, sets.locate(camera, matrices[mine]), strict=True):
            found[v] = None if cell is None else (sets, cell)
    return found


def bring_tails(
    device: Device, tails: Sequence[GaussianCloud | None] | GaussianCloud | None, count: int
) -> tuple[list[CloudDevice], NDArray[np.int32] | None]:
    """Different tails once each, and which is whose (-1: none)."""
    if isinstance(tails, GaussianCloud):
        if not len(tails):
            return [], None
        return upload_clouds(device, [tails], sort=False), np.zeros(count, np.int32)
    number: dict[int, int] = {}
    different: list[GaussianCloud] = []
    tail_of = np.full(count, -1, np.int32)
    for v, tail in enumerate(tails or ()):
        if tail is None or not len(tail):
            continue
        if id(tail) not in number:
            number[id(tail)] = len(different)
            different.append(tail)
        tail_of[v] = number[id(tail)]
    if not different:
        return [], None
    return upload_clouds(device, different, sort=False), tail_of
