"""What the kernels of batched simulation are given, by name; see `gn0.device.records`.

Names and meanings are those of `kernels/step.cu`, `ego.cu`, `pictures.cu`, `place.cu`, `expert.cu`,
`crowd.cu`, `follow.cu`, `shown.cu` and `who.cu`; `w`, `c`, `f` are the structs `World`, `Crowd`,
`Following` of `device_layout`, `out` the struct `Outputs` where it is no array.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gn0.device.device import DeviceArray


class ReadActions(NamedTuple):
    """`read_actions`: actions of any width as codes, checked."""

    w: np.void
    actions: DeviceArray
    width: np.int32
    step: np.int32
    codes: DeviceArray


class StepAgents(NamedTuple):
    """`step_agents`, `slide_agents`: an action each."""

    w: np.void
    codes: DeviceArray
    out: np.void


class PlaceAgents(NamedTuple):
    """`place_agents`: who begins which episode."""

    w: np.void
    slots: DeviceArray
    out: np.void


class MovePeople(NamedTuple):
    """`move_people`: everybody through the ticks of an action."""

    w: np.void
    c: np.void
    codes: DeviceArray


class StepAmong(NamedTuple):
    """`step_people`: an action each, behind `move_people`."""

    w: np.void
    c: np.void
    codes: DeviceArray
    out: np.void


class StepFollowing(NamedTuple):
    """`step_following`: the same where somebody is followed."""

    w: np.void
    c: np.void
    f: np.void
    codes: DeviceArray
    out: np.void


class PlacePeople(NamedTuple):
    """`place_people`: who begins which episode, with everybody in it."""

    w: np.void
    c: np.void
    slots: DeviceArray
    out: np.void


class PlaceFollowing(NamedTuple):
    """`place_following`: the same where somebody is followed."""

    w: np.void
    c: np.void
    f: np.void
    slots: DeviceArray
    out: np.void


class ShortenRanges(NamedTuple):
    """`shorten_ranges`: rays end at people."""

    w: np.void
    c: np.void
    slots: DeviceArray
    poses: DeviceArray
    turns: DeviceArray
    people: DeviceArray
    rays: np.int32
    out: DeviceArray


class SavePeople(NamedTuple):
    """`save_people`: people around some agents, as rows."""

    w: np.void
    c: np.void
    agents: DeviceArray
    count_: np.int32
    real: DeviceArray
    whole: DeviceArray


class RestorePeople(NamedTuple):
    """`restore_people`: rows, as people around some agents."""

    w: np.void
    c: np.void
    rows: DeviceArray
    agents: DeviceArray
    count_: np.int32
    real: DeviceArray
    whole: DeviceArray


class WidenCrowd(NamedTuple):
    """`widen_reals`, `widen_wholes`: columns of people, with room for more of them."""

    in_: DeviceArray
    columns: np.int32
    from_: np.int32
    to: np.int32
    count_: np.int32
    out: DeviceArray


class ShowPeople(NamedTuple):
    """`show_people`: who is seen how, where and in which light."""

    w: np.void
    c: np.void
    from_: DeviceArray
    levels: np.int32
    turns: DeviceArray
    across: np.float64
    deeper: np.float64
    ground: np.float64
    codes: DeviceArray
    poses: DeviceArray
    gains: DeviceArray


class ReadRanges(NamedTuple):
    """`read_ranges`: how far rays go."""

    w: np.void
    slots: DeviceArray
    poses: DeviceArray
    turns: DeviceArray
    rays: np.int32
    limit: np.float64
    out: DeviceArray


class FillQueue(NamedTuple):
    """`fill_queue`: episodes to come."""

    w: np.void
    list: DeviceArray
    entries: np.int32
    queue: DeviceArray
    filled: DeviceArray


class CopyWords(NamedTuple):
    """`copy_words`: so many, of 4 bytes."""

    in_: DeviceArray
    words: np.uint64
    out: DeviceArray


class CopyBytes(NamedTuple):
    """`copy_bytes`: so many."""

    in_: DeviceArray
    size: np.uint64
    out: DeviceArray


class StoreRows(NamedTuple):
    """`store_rows`: rows of episodes, each into its slot."""

    rows: DeviceArray
    slots: DeviceArray
    table: DeviceArray
    words: np.int32
    count_: np.int32


class BuildViews(NamedTuple):
    """`build_views`: what agents look at, and of which look."""

    w: np.void
    height: np.float64
    cos_pitch: np.float64
    sin_pitch: np.float64
    views: DeviceArray
    looks: DeviceArray | None


class MotionTables(NamedTuple):
    """Where parts stand at each step, by motion; motions by scene."""

    motion_of: DeviceArray
    poses: DeviceArray
    chosen: DeviceArray
    gains: DeviceArray | None
    nearer: DeviceArray | None
    times: np.int32
    parts: np.int32


class MotionTargets(NamedTuple):
    """Where parts stand before each agent, and the steps that this was read for."""

    out_poses: DeviceArray
    out_chosen: DeviceArray
    out_gains: DeviceArray | None
    out_nearer: DeviceArray | None
    steps: DeviceArray


class PlaceParts(NamedTuple):
    """`place_parts`: rows of the one, written to the other."""

    w: np.void
    tables: MotionTables
    targets: MotionTargets


class ClipDepth(NamedTuple):
    """`clip_depth`: depth [m] held within what a sensor measures."""

    depth: DeviceArray
    low: np.float32
    high: np.float32
    size: np.uint64
    out: DeviceArray


class PaintMaps(NamedTuple):
    """`paint_maps`: map pictures; None are left out."""

    w: np.void
    slots: DeviceArray
    poses: DeviceArray
    rows: np.int32
    cols: np.int32
    radius: np.int32
    arrow: np.int32
    bev: DeviceArray | None
    occupancy: DeviceArray | None


class DrawEgoMaps(NamedTuple):
    """`draw_ego_maps`: a square of all agents' ego maps."""

    w: np.void
    slots: DeviceArray
    poses: DeviceArray
    size: np.int32
    metres: np.float64
    front: np.int64
    content: np.int32
    marker: np.int32
    offset: np.int32
    high: np.int32
    wide: np.int32
    out: DeviceArray


class ShrinkMaps(NamedTuple):
    """`shrink_maps`: whole map pictures of all agents, brought to one size."""

    w: np.void
    slots: DeviceArray
    poses: DeviceArray
    shapes: DeviceArray
    across: DeviceArray
    down: DeviceArray
    rows: np.int32
    cols: np.int32
    radius: np.int32
    arrow: np.int32
    occupancy: np.int32
    out: DeviceArray


class ReducePictures(NamedTuple):
    """`reduce_pictures`: smaller pictures, by weights along each axis."""

    in_: DeviceArray
    rows: np.int32
    cols: np.int32
    across: DeviceArray
    across_taps: np.int32
    down: DeviceArray
    down_taps: np.int32
    out_rows: np.int32
    out_cols: np.int32
    views: DeviceArray | None
    status: DeviceArray
    out: DeviceArray


class LayMosaics(NamedTuple):
    """`lay_mosaics`, `lay_mosaics_4`, `lay_mosaics_1`: tiles of the last views, side by side."""

    tiles: DeviceArray
    views: DeviceArray | None
    rows: np.int32
    words: np.int32
    out: DeviceArray


class PlaceRows(NamedTuple):
    """`place_rows`: pictures of some agents, among those of all."""

    in_: DeviceArray
    to: DeviceArray
    size: np.uint64
    entries: np.int32
    out: DeviceArray


class MoveChannels(NamedTuple):
    """`move_channels`: pictures with channels first."""

    in_: DeviceArray
    pixels: np.uint64
    width: np.uint64
    size: np.uint64
    out: DeviceArray


class TakeRows(NamedTuple):
    """`take_rows`: a row of a table for each agent."""

    table: DeviceArray
    numbers: DeviceArray
    width: np.uint64
    size: np.uint64
    out: DeviceArray


class JudgePlaces(NamedTuple):
    """`judge_places`: what the ground is like."""

    w: np.void
    slots: DeviceArray
    positions: DeviceArray
    count_: np.int32
    verdicts: DeviceArray


class FindPlaces(NamedTuple):
    """`find_places`: a place from which the goal can be reached."""

    w: np.void
    slots: DeviceArray
    chances: DeviceArray
    reaches: DeviceArray
    positions: DeviceArray


class TurnAgents(NamedTuple):
    """`turn_agents`: all agents turn on the spot."""

    w: np.void
    turns: DeviceArray


class PutAgents(NamedTuple):
    """`put_agents`: where some agents stand from now on."""

    w: np.void
    agents: DeviceArray
    slots: DeviceArray
    positions: DeviceArray
    turns: DeviceArray
    steps: DeviceArray
    views: DeviceArray
    collided: DeviceArray
    count_: np.int32


class WalkPlans(NamedTuple):
    """`walk_plans`, `slide_plans`: where plans of actions lead from kept places."""

    w: np.void
    rows: DeviceArray
    slots: DeviceArray
    positions: DeviceArray
    turns: DeviceArray
    actions: DeviceArray
    length: np.int32
    count_: np.int32
    poses: DeviceArray
    cut: DeviceArray


class MoveRows(NamedTuple):
    """`move_rows`: rows of one array to rows of another; None: in order."""

    in_: DeviceArray
    from_: DeviceArray | None
    to: DeviceArray | None
    size: np.uint64
    count_: np.int32
    out: DeviceArray


class KeepTiles(NamedTuple):
    """`keep_tiles`: tiles of views that some agents have seen."""

    tiles: DeviceArray
    agents: DeviceArray
    views: np.int32
    size: np.uint64
    count_: np.int32
    rings: DeviceArray


class LabelActions(NamedTuple):
    """`label_actions`, `label_sliding`: what the field expert does next."""

    w: np.void
    ways: DeviceArray
    near: np.float64
    ahead: np.int32
    actions: DeviceArray
    distance: DeviceArray


class LabelWays(NamedTuple):
    """`label_ways`: where its way leads."""

    w: np.void
    ways: DeviceArray
    spacing: np.float64
    slots: np.int32
    waypoints: DeviceArray
    valid: DeviceArray


class NamePeople(NamedTuple):
    """`name_people`: persons instead of instances."""

    numbers: DeviceArray
    persons: DeviceArray
    places: np.int32
    pixels: np.uint64
    size: np.uint64
    out: DeviceArray


class TellSeen(NamedTuple):
    """`tell_seen`: what is seen of each person."""

    seen: DeviceArray
    persons: DeviceArray
    places: np.int32
    size: np.int32
    out: DeviceArray
