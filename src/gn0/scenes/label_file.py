"""`labels.json`: object instances with eight-corner boxes, as InteriorGS writes them.

Our own files add `room`; corners 0–3 are the bottom face counter-clockwise, 4–7 above them, and the
yaw runs along corner 0 → 1. Foreign files may wrap the list in {"labels": [...]}, leave a box out,
or list the corners of a face in another order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from gn0.config import JSON_LIMIT, decode_json, load_json
from gn0.errors import FormatError
from gn0.geometry import F64, wrap_angle
from gn0.scenes.scene import ObjectBox, SceneObject
from gn0.storage import read_bytes

REACH = 1e5  # m; a coordinate beyond this is a unit error


class Corner(msgspec.Struct, forbid_unknown_fields=True):
    """One box corner [m]."""

    x: float
    y: float
    z: float


class LabelRow(msgspec.Struct):
    """One entry of a foreign `labels.json`."""

    ins_id: str | int
    label: str
    bounding_box: list[Corner] | None = None


class LabelRowOwn(msgspec.Struct, forbid_unknown_fields=True):
    """One entry of our own `labels.json`: complete, with the room.

    `label_source` says "heuristic" where a program guessed; it is for people and ignored here.
    """

    ins_id: str
    label: str
    bounding_box: list[Corner]
    room: str | None = None
    label_source: str | None = None


@dataclass(frozen=True)
class Labels:
    """Objects of a label file, and how many entries could not be used."""

    objects: tuple[SceneObject, ...]
    without_box: int = 0


def load_labels(path: Path) -> tuple[SceneObject, ...]:
    """Objects of our own label file.

    Raises:
        FormatError: not JSON, a field missing, unknown, of the wrong type, or not a box.
        StorageError: the file cannot be read.
    """
    rows = load_json(path, list[LabelRowOwn])
    objects = []
    for index, row in enumerate(rows):
        box = box_from_corners(_corners(row.bounding_box), path, index)
        objects.append(SceneObject(id=row.ins_id, category=row.label, box=box, room=row.room))
    check_unique([thing.id for thing in objects], path, "ins_id")
    return tuple(objects)


def load_labels_foreign(path: Path) -> Labels:
    """Objects of an InteriorGS label file; entries without a box are counted, not kept.

    Raises:
        FormatError: not a label file, or a box is not eight finite corners.
        StorageError: the file cannot be read.
    """
    data: Any = decode_json(read_bytes(path, JSON_LIMIT), Any, file=path)
    if isinstance(data, dict):
        data = data.get("labels")
    if not isinstance(data, list):
        raise FormatError(
            "expected a list of labels, or an object with a list under 'labels'",
            file=path,
            remedy="give the labels.json of an InteriorGS scene",
        )
    objects: list[SceneObject] = []
    missing = 0
    for index, entry in enumerate(data):
        try:
            row = msgspec.convert(entry, LabelRow)
        except msgspec.ValidationError as error:
            raise FormatError(
                f"entry {index}: {error}", file=path, remedy="correct the named field"
            ) from None
        if not row.bounding_box:
            missing += 1
            continue
        box = box_from_corners(_corners(row.bounding_box), path, index)
        category = " ".join(row.label.lower().replace("_", " ").split()) or "object"
        objects.append(SceneObject(id=str(row.ins_id), category=category, box=box))
    check_unique([thing.id for thing in objects], path, "ins_id")
    return Labels(tuple(objects), missing)


def encode_labels(
    objects: tuple[SceneObject, ...], *, heuristic: bool = False
) -> list[dict[str, Any]]:
    """The rows of our label file, each marked where the labels are guesses."""
    mark = {"label_source": "heuristic"} if heuristic else {}
    return [
        {
            **mark,
            "ins_id": thing.id,
            "label": thing.category,
            "bounding_box": [
                {"x": float(x), "y": float(y), "z": float(z)} for x, y, z in thing.box.corners()
            ],
            "room": thing.room,
        }
        for thing in objects
    ]


def check_unique(ids: list[str], file: Path, field: str) -> None:
    """Refuse empty or repeated ids.

    Raises:
        FormatError: names the id.
    """
    seen: set[str] = set()
    for value in ids:
        if not value or len(value) > 256:
            raise FormatError("an id is empty or longer than 256", file=file, field=field)
        if value in seen:
            raise FormatError(
                f"id {value!r} occurs twice", file=file, field=field, remedy="make ids unique"
            )
        seen.add(value)


def _corners(rows: list[Corner]) -> F64:
    return np.array([(c.x, c.y, c.z) for c in rows], np.float64).reshape(-1, 3)


def box_from_corners(corners: F64, file: Path, index: int) -> ObjectBox:
    """An upright box from corners [8, 3] m, the first four being one horizontal face.

    Raises:
        FormatError: not eight finite corners within reach.
    """
    if corners.shape != (8, 3) or not (np.abs(corners) < REACH).all():
        raise FormatError(
            f"entry {index}: a box needs eight finite corners within {REACH:g} m",
            file=file,
            field="bounding_box",
            remedy="correct the box, or leave it out",
        )
    # in plain numbers: a scene has hundreds of boxes, and arrays of four cost ten times as much
    rows: list[list[float]] = corners.tolist()
    face, other = rows[:4], rows[4:]
    floor, top = _mean([z for *_, z in face]), _mean([z for *_, z in other])
    if floor > top:
        face, floor, top = other, top, floor
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = _counter_clockwise([(x, y) for x, y, _ in face])
    along = ((bx - ax + cx - dx) / 2, (by - ay + cy - dy) / 2)
    across = ((cx - bx + dx - ax) / 2, (cy - by + dy - ay) / 2)
    sx, sy = float(np.hypot(*along)), float(np.hypot(*across))
    if sx > 0:
        yaw = math.atan2(along[1], along[0])
    else:
        yaw = math.atan2(across[1], across[0]) - math.pi / 2 if sy > 0 else 0.0
    # to whole micrometres as NumPy has it, whose last bit decides in stored scenes
    middle = [round(_mean([row[axis] for row in rows]) * 1e6) / 1e6 for axis in range(3)]
    return ObjectBox(
        centre=(middle[0], middle[1], middle[2]),
        size=(round(sx, 6), round(sy, 6), round(top - floor, 6)),
        yaw=_rounded_yaw(yaw),
    )


def _mean(values: list[float]) -> float:
    """Summed from the first on: `sum` is more exact in some versions of Python than in others."""
    total = 0.0
    for value in values:
        total += value
    return total / len(values)


def _rounded_yaw(yaw: float) -> float:
    """Six decimals that read back the same, at the seam of ±π too."""
    rounded = round(wrap_angle(yaw), 6) + 0.0
    return -3.141592 if abs(rounded) > 3.141592 else rounded


def _counter_clockwise(face: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """A face's corners (4) from the given first one round counter-clockwise."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = face
    mx, my = _mean([ax, bx, cx, dx]), _mean([ay, by, cy, dy])
    size = max(max(abs(x - mx), abs(y - my)) for x, y in face)
    if max(abs(ax + cx - bx - dx), abs(ay + cy - by - dy)) <= 1e-3 * size + 1e-9:
        # already a ring: opposite corners share their middle (also of a box without depth)
        turns_left = (cx - ax) * (dy - by) - (cy - ay) * (dx - bx) >= 0
        return face if turns_left else [face[0], face[3], face[2], face[1]]
    turn = np.arctan2([y - my for _, y in face], [x - mx for x, _ in face])
    order = np.argsort(np.mod(turn - turn[0] + 1e-9, 2 * math.pi), kind="stable")
    return [face[k] for k in order.tolist()]
