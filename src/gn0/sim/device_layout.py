"""Layouts that Python and `kernels/world.cu` share, and the kernels of batched simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gn0.device.device import DeviceArray, KernelSource
from gn0.people.outline import DIRECTIONS
from gn0.people.person import PEOPLE_MOST
from gn0.people.reach import MODE, REALS, WHOLES
from gn0.sim.ego_map import QUARTER, SAMPLES, SERIES, TINT
from gn0.sim.history import COLUMNS, LENGTH
from gn0.sim.sensor.goal_vector import VECTOR_LIMIT

KERNELS = Path(__file__).parent / "kernels"
THREADS = 128  # a block of the kernels that have a thread an agent: many small blocks, all at once
CROWD_THREADS = 128  # at most, a block of those that have one a person: eight environments of 16
CLEAR = 0x7FFFFFFF  # a status word that nothing has been written to

EPISODE = np.dtype(
    [
        *((name, np.uint64) for name in (
            "compact", "labels", "roots", "headings", "directions", "grey", "bev",
            "walls", "people", "lines", "points", "holds", "roles", "light_column", "light_places",
            "light_gains",
        )),
        *((name, np.float64) for name in (
            "x", "y", "resolution", "start_x", "start_y", "goal_x", "goal_y",
            "map_x", "map_y", "map_scale", "reach", "keep_distance", "keep_lateral",
        )),
        *((name, np.int32) for name in (
            "rows", "cols", "map_rows", "map_cols", "wide", "number", "scene", "look",
            "stays", "persons", "followed", "light_cols", "light_rows", "light_count",
        )),  # whole words of 16 bytes
    ],
    align=True,
)  # fmt: skip

WORLD = np.dtype(
    [
        *((name, np.uint64) for name in (
            "episodes", "queue", "filled", "cursor", "slot", "position", "turns", "steps",
            "collided", "distance", "views", "status",
        )),
        *((name, np.float64) for name in (
            "forward", "success_distance", "step_cost", "success_reward",
        )),
        *((name, np.int32) for name in ("count", "ahead", "circle", "max_steps")),
    ],
    align=True,
)  # fmt: skip

# name, element type and shape an agent of what a step writes
OUTPUT_FIELDS: tuple[tuple[str, Any, tuple[int, ...]], ...] = (
    ("rewards", np.float64, ()),
    ("terminated", np.bool_, ()),
    ("truncated", np.bool_, ()),
    ("ended", np.bool_, ()),
    ("goal_vector", np.float32, (2,)),
    ("collided", np.int64, ()),
    ("pose", np.float64, (3,)),
    ("distance", np.float64, ()),
    ("episode", np.int32, ()),
    ("scene", np.int32, ()),
    ("final_goal_vector", np.float32, (2,)),
    ("final_collided", np.int64, ()),
    ("final_pose", np.float64, (3,)),
    ("final_distance", np.float64, ()),
    ("final_success", np.bool_, ()),
    ("final_episode", np.int32, ()),
    ("final_slot", np.int32, ()),
    ("final_turns", np.int32, ()),
    ("final_views", np.int32, ()),
)
# the same of people; those that end in `people` have a row of four numbers for each
CROWD_FIELDS: tuple[tuple[str, Any], ...] = (
    ("people", np.float64),
    ("hit_person", np.int64),
    ("hit_by", np.int64),
    ("hit_tick", np.int64),
)
CROWD = np.dtype(
    [
        *((name, np.uint64) for name in ("real", "whole", "cut")),
        *((prefix + name, np.uint64) for prefix in ("", "final_") for name, _ in CROWD_FIELDS),
        *((name, np.float64) for name in (
            "agent_radius", "person_radius", "tick_seconds", "tick_cos", "tick_sin",
        )),
        *((name, np.int32) for name in ("rate", "parts", "places", "ticks", "slides", "unused")),
    ],
    align=True,
)  # fmt: skip

LEVELS_MOST = 8  # of detail
# what a person brings to its looks; see `shown.cu`
ROLE = np.dtype(
    [
        *((name, np.float64) for name in (
            "stride", "forward", "lasts", "still", "reach", "shadow",
        )),
        *((name, np.float64, DIRECTIONS) for name in ("stands", "walks")),
        ("coarser", np.float64, LEVELS_MOST),
        *((name, np.int32) for name in (
            "number", "offset", "gait", "idle", "idle_rows", "clip", "clip_rows", "clip_loops",
            "clip_rowed", "unused",
        )),
    ],
    align=True,
)  # fmt: skip

# what is told of following, and of those that ended
FOLLOW_FIELDS: tuple[tuple[str, Any], ...] = (
    ("follows", np.bool_),
    ("faced", np.bool_),
    ("distance", np.float64),
    ("end", np.int64),
)
FOLLOWING = np.dtype(
    [
        *((name, np.uint64) for name in ("far", "over_at", "gap")),
        *((prefix + name, np.uint64) for prefix in ("", "final_") for name, _ in FOLLOW_FIELDS),
        *((name, np.float64) for name in (
            "reach", "aligned", "nearest", "lost_beyond", "linger", "touch_within", "same_time",
            "step_seconds", "following", "touch",
        )),
        *((name, np.int32) for name in ("lost_after", "unused")),
    ],
    align=True,
)  # fmt: skip
OUTPUTS = np.dtype([(name, np.uint64) for name, _, _ in OUTPUT_FIELDS], align=True)

SOURCE = KernelSource(
    "simulation",
    tuple(KERNELS / f"{part}.cu" for part in ("world", "step", "ego", "pictures", "place")),
    (
        ("EPISODE_BYTES", EPISODE.itemsize),
        ("WORLD_BYTES", WORLD.itemsize),
        ("OUTPUTS_BYTES", OUTPUTS.itemsize),
        ("VECTOR_LIMIT", VECTOR_LIMIT),
        ("TILES", LENGTH),
        ("COLUMNS", COLUMNS),
        ("EGO_QUARTER", QUARTER),
        ("EGO_SAMPLES", SAMPLES),
        ("EGO_TINT", TINT),
        *((f"EGO_C{k}", value) for k, value in enumerate(SERIES)),
    ),
)
_PEOPLE = (
    "world",
    "step",
    "reach",
    "weigh",
    "detour",
    "tick",
    "crowd",
    "follow",
    "shown",
    "who",
)
PEOPLE = KernelSource(
    "people",
    tuple(KERNELS / f"{part}.cu" for part in _PEOPLE),
    (
        *SOURCE.defines,
        ("CROWD_BYTES", CROWD.itemsize),
        ("FOLLOWING_BYTES", FOLLOWING.itemsize),
        ("ROLE_BYTES", ROLE.itemsize),
        ("LEVELS_MOST", LEVELS_MOST),
        ("OUTLINE", DIRECTIONS),
        ("PEOPLE_MOST", PEOPLE_MOST),
        ("CROWD_THREADS", CROWD_THREADS),
        ("REALS", REALS),
        ("WHOLES", WHOLES),
        ("MODE", MODE),
    ),
)


def pack_struct(layout: np.dtype[Any], **values: Any) -> np.void:
    """A struct to hand to a kernel by value: arrays as their addresses, None as null."""
    out = np.zeros(1, layout)
    for name, value in values.items():
        out[name] = value.pointer if isinstance(value, DeviceArray) else (value or 0)
    scalar: np.void = out[0]
    return scalar


def blocks_of(items: int, threads: int = THREADS) -> int:
    """Blocks that have a thread for each of so many items."""
    return -(-items // threads)
