"""`structure.json` (InteriorGS layout, v2.0): rooms, walls, doors and windows.

Our own files add an `id` to each room, so that objects can name it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gn0.config import load_json
from gn0.errors import FormatError
from gn0.scenes.label_file import REACH, check_unique
from gn0.scenes.scene import SceneObject, SceneOpening, SceneRoom, SceneWall

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]


class RoomRow(msgspec.Struct):
    """One room of the file; `id` only in ours."""

    profile: list[Point2]
    room_type: str = "room"
    id: str | None = None


class WallRow(msgspec.Struct):
    """One wall of the file."""

    location: tuple[Point2, Point2]
    thickness: float = 0.0
    height: float = 0.0


class HoleRow(msgspec.Struct):
    """One door or window of the file."""

    profile: list[Point3]
    type: str
    thickness: float = 0.0


class StructureFile(msgspec.Struct):
    """A `structure.json`; `ins` is read from `labels.json` instead."""

    rooms: list[RoomRow] = []
    walls: list[WallRow] = []
    holes: list[HoleRow] = []
    ins: list[Any] = []
    version: str | float | None = None


class StructureFileOwn(StructureFile, forbid_unknown_fields=True):
    """Our own `structure.json`: no unknown keys."""


@dataclass(frozen=True)
class Structure:
    """Rooms, walls and openings of a scene."""

    rooms: tuple[SceneRoom, ...] = ()
    walls: tuple[SceneWall, ...] = ()
    openings: tuple[SceneOpening, ...] = ()


def load_structure(path: Path, *, own: bool) -> Structure:
    """Read a structure file; `own` refuses unknown keys.

    Raises:
        FormatError: not JSON, a field missing or of the wrong type, a polygon of fewer than three
            corners, or a coordinate out of reach.
        StorageError: the file cannot be read.
    """
    data = load_json(path, StructureFileOwn if own else StructureFile)
    rooms = []
    for index, row in enumerate(data.rooms):
        polygon = [(float(x), float(y)) for x, y in row.profile]
        if len(polygon) > 1 and polygon[0] == polygon[-1]:
            polygon.pop()
        _check(polygon, 3, path, f"rooms[{index}].profile")
        kind = " ".join(row.room_type.lower().replace("_", " ").split()) or "room"
        rooms.append(SceneRoom(id=row.id or f"room-{index}", type=kind, polygon=tuple(polygon)))
    check_unique([room.id for room in rooms], path, "rooms.id")
    walls = []
    for index, wall in enumerate(data.walls):
        size = [(wall.thickness, wall.height)]
        _check([*wall.location, *size], 3, path, f"walls[{index}]")
        a, b = wall.location
        walls.append(SceneWall(a=a, b=b, thickness=wall.thickness, height=wall.height))
    openings = []
    for index, hole in enumerate(data.holes):
        _check(hole.profile, 3, path, f"holes[{index}].profile")
        kind = hole.type.upper()
        openings.append(
            SceneOpening(kind=kind, polygon=tuple(hole.profile), thickness=hole.thickness)
        )
    return Structure(tuple(rooms), tuple(walls), tuple(openings))


def encode_structure(
    rooms: tuple[SceneRoom, ...],
    walls: tuple[SceneWall, ...],
    openings: tuple[SceneOpening, ...],
    objects: tuple[SceneObject, ...],
) -> dict[str, Any]:
    """The content of our structure file."""
    return {
        "version": "2.0",
        "rooms": [{"id": r.id, "room_type": r.type, "profile": r.polygon} for r in rooms],
        "walls": [
            {"location": [w.a, w.b], "thickness": w.thickness, "height": w.height} for w in walls
        ],
        "holes": [
            {"profile": o.polygon, "thickness": o.thickness, "type": o.kind} for o in openings
        ],
        "ins": [
            {"label": t.category, "position": t.box.centre, "size": t.box.size} for t in objects
        ],
    }


def _check(points: list[Any], least: int, path: Path, field: str) -> None:
    if len(points) < least:
        raise FormatError(
            f"has {len(points)} corners, needs at least {least}", file=path, field=field
        )
    if not (np.abs(np.asarray(points, np.float64)) < REACH).all():
        raise FormatError(
            f"a coordinate is not finite or beyond {REACH:g} m",
            file=path,
            field=field,
            remedy="coordinates are metres",
        )
