"""Eight corners and back: boxes keep their place, size and heading through labels.json."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import FormatError
from gn0.scenes.label_file import (
    box_from_corners,
    encode_labels,
    load_labels,
    load_labels_foreign,
)
from gn0.scenes.scene import ObjectBox, SceneObject
from gn0.scenes.structure import load_structure

PLACE = st.floats(-500, 500)
SIZE = st.floats(0.01, 30)


@settings(max_examples=150, deadline=None)
@given(
    x=PLACE, y=PLACE, z=PLACE, sx=SIZE, sy=SIZE, sz=SIZE,
    yaw=st.floats(-3.14, 3.14), turn=st.integers(0, 3), clockwise=st.booleans(),
    top_first=st.booleans(),
)  # fmt: skip
def test_any_order_of_corners_gives_the_same_solid(
    x, y, z, sx, sy, sz, yaw, turn, clockwise, top_first
):
    box = ObjectBox(centre=(x, y, z), size=(sx, sy, sz), yaw=yaw)
    ring = [(k + turn) % 4 for k in range(4)]
    ring = ring[::-1] if clockwise else ring
    order = [*ring, *(k + 4 for k in ring)]
    if top_first:
        order = order[4:] + order[:4]
    again = box_from_corners(box.corners()[order], Path("labels.json"), 0)
    assert again.centre == pytest.approx(box.centre, abs=2e-6)
    assert again.size[2] == pytest.approx(sz, abs=2e-6)
    assert again.size[0] * again.size[1] == pytest.approx(sx * sy, rel=1e-4, abs=1e-5)
    # the same eight points, whichever corner came first
    gap = np.linalg.norm(again.corners()[:, None] - box.corners()[None], axis=2).min(axis=1)
    assert gap.max() < 1e-4 * (1 + max(sx, sy))


@settings(max_examples=80, deadline=None)
@given(x=PLACE, y=PLACE, sx=SIZE, sy=SIZE, yaw=st.floats(-math.pi, 3.1415))
def test_reading_is_stable(x, y, sx, sy, yaw):
    """What was read once is read the same for ever: results stay comparable."""
    first = box_from_corners(
        ObjectBox(centre=(x, y, 1.0), size=(sx, sy, 1.0), yaw=yaw).corners(), Path("l"), 0
    )
    assert box_from_corners(first.corners(), Path("l"), 0) == first


def test_corner_zero_to_one_carries_the_yaw():
    box = ObjectBox(centre=(1.0, 2.0, 0.5), size=(2.0, 1.0, 1.0), yaw=0.3)
    corners = box.corners()
    along = corners[1] - corners[0]
    assert math.atan2(along[1], along[0]) == pytest.approx(0.3)
    assert (corners[:4, 2] == 0.0).all()
    assert (corners[4:, 2] == 1.0).all()
    x, y = corners[:4, :2].T
    assert np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)) > 0  # counter-clockwise


@pytest.mark.parametrize("size", [(0, 1, 1), (1, 0, 1), (0, 0, 1), (1, 1, 0), (0, 0, 0)])
def test_flat_boxes_are_boxes(size):
    box = ObjectBox(centre=(1, 1, 1), size=size, yaw=0.5 if size[0] or size[1] else 0.0)
    again = box_from_corners(box.corners(), Path("l"), 0)
    assert again.size == pytest.approx(size, abs=1e-6)
    assert again.centre == pytest.approx((1, 1, 1))
    if size[0] or size[1]:
        assert math.remainder(again.yaw - 0.5, math.pi) == pytest.approx(0, abs=1e-5)


def test_files_round_trip(tmp_path):
    objects = (
        SceneObject(id="a b", category="sofa", box=ObjectBox(centre=(1, 2, 0.5), size=(1, 2, 1))),
        SceneObject(
            id="ü", category="lamp",
            box=ObjectBox(centre=(0, 0, 2), size=(0.1, 0.1, 0.2), yaw=1.5), room="r",
        ),
    )  # fmt: skip
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(encode_labels(objects)))
    assert load_labels(path) == objects
    foreign = load_labels_foreign(path).objects  # a peer's reader can open it
    assert [(t.id, t.category, t.box) for t in foreign] == [
        (t.id, t.category, t.box) for t in objects
    ]


def test_corners_must_be_eight_and_finite():
    good = ObjectBox(centre=(0, 0, 0), size=(1, 1, 1)).corners()
    for bad in (good[:7], np.vstack([good, good[:1]]), good * np.nan, good * 1e9):
        with pytest.raises(FormatError, match="eight finite corners"):
            box_from_corners(bad, Path("labels.json"), 3)


def write(path: Path, **data) -> Path:
    path.write_text(json.dumps(data))
    return path


def test_foreign_structure_files(tmp_path):
    """InteriorGS' own keys, closed polygons and unknown extras are all right."""
    path = write(
        tmp_path / "structure.json",
        version="2.0",
        rooms=[{"profile": [[0, 0], [1, 0], [1, 1], [0, 0]], "room_type": "Living_Room", "x": 1}],
        walls=[{"location": [[0, 0], [1, 0]], "thickness": 0.1, "height": 2.8}],
        holes=[{"profile": [[0, 0, 0], [1, 0, 0], [1, 0, 2]], "thickness": 0.1, "type": "door"}],
        ins=[{"label": "x", "position": [0, 0, 0], "size": [1, 1, 1]}],
        extra={},
    )
    structure = load_structure(path, own=False)
    assert structure.rooms[0].type == "living room"
    assert len(structure.rooms[0].polygon) == 3
    assert structure.rooms[0].id == "room-0"
    assert structure.openings[0].kind == "DOOR"
    with pytest.raises(FormatError, match="extra"):
        load_structure(path, own=True)


@pytest.mark.parametrize(
    "data",
    [
        {"rooms": [{"profile": [[0, 0], [1, 0]]}]},
        {"rooms": [{"profile": [[0, 0], [1, 0], [1e9, 1]]}]},
        {"rooms": [{"profile": "circle"}]},
        {"walls": [{"location": [[0, 0]]}]},
        {"holes": [{"profile": [[0, 0, 0], [1, 0, 0], [1, 0, 1]]}]},
        {"rooms": {}},
    ],
)
def test_damaged_structure_files(tmp_path, data):
    path = write(tmp_path / "structure.json", **data)
    with pytest.raises(FormatError, match=r"structure\.json"):
        load_structure(path, own=False)
