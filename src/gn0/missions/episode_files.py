"""Episodes on disk: Parquet, one row per episode, read strictly.

GN-Matrix's columns come first by their exact names, in GN-Matrix's own frame and PNG pixels; our
columns follow in the 3DGS world frame and are the ones read back. A file of GN-Matrix alone is read
through the closed form between the two frames, given the scene's grid. No cell is ever null.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, cast, get_args

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gn0.errors import EpisodeError, FormatError
from gn0.geometry import F64, wrap_angle
from gn0.maps.goal_places import GoalSet
from gn0.maps.grid import OccupancyGrid
from gn0.missions.episode import (
    STEP_SECONDS,
    AgentSpec,
    Episode,
    GoalPicture,
    Mission,
    MissionFollow,
    MissionGoal,
    MissionInstruction,
    PathSource,
    check_episode,
)
from gn0.missions.episode_columns import count_column, read_column
from gn0.missions.paths import rasterise_path
from gn0.missions.people import decode_people, encode_people
from gn0.render.light import LightCondition
from gn0.storage import read_bytes, write_bytes

SIZE_LIMIT = 2 * 2**30  # bytes of Parquet read at most, packed or unpacked
ROW_LIMIT = 20_000_000

_TEXT, _REAL, _INT = pa.string(), pa.float64(), pa.int64()
_REALS, _INTS = pa.list_(_REAL), pa.list_(_INT)

GN_MATRIX_COLUMNS: tuple[tuple[str, pa.DataType], ...] = (
    ("scene", _TEXT),
    ("trajectory_id", _TEXT),
    ("instruction", _TEXT),
    ("grounded_instruction", _TEXT),
    ("label_ins_id", _TEXT),
    ("label_label", _TEXT),
    ("label_goal_pixel_x", _INT),
    ("label_goal_pixel_y", _INT),
    ("start_world_x", _REAL),
    ("start_world_y", _REAL),
    ("start_facing_unit_dx", _REAL),
    ("start_facing_unit_dy", _REAL),
    ("start_facing_heading_degrees", _REAL),
    ("goal_world_x", _REAL),
    ("goal_world_y", _REAL),
    ("path_raster_world_x", _REALS),
    ("path_raster_world_y", _REALS),
    ("path_raster_pixel_x", _INTS),
    ("path_raster_pixel_y", _INTS),
)
PATH_COLUMNS = (
    "path_raster_world_x", "path_raster_world_y", "path_raster_pixel_x", "path_raster_pixel_y",
)  # fmt: skip
OUR_COLUMNS: tuple[tuple[str, pa.DataType], ...] = (
    ("episode_id", _TEXT),
    ("mission", _TEXT),
    ("human", _TEXT),
    ("start_3dgs_x", _REAL),
    ("start_3dgs_y", _REAL),
    ("start_3dgs_yaw", _REAL),
    ("goal_3dgs_x", _REAL),
    ("goal_3dgs_y", _REAL),
    ("path_3dgs_x", _REALS),
    ("path_3dgs_y", _REALS),
    ("split", _TEXT),
    ("seed", _INT),
    ("agent_radius", _REAL),
    ("agent_camera_height", _REAL),
    ("agent_forward_step", _REAL),
    ("agent_turn_degrees", _REAL),
)
# ours as well, but not in files of earlier versions: absent means the value in the third place
LATER_COLUMNS: tuple[tuple[str, pa.DataType, str], ...] = (
    ("path_id", _TEXT, ""),
    ("style", _TEXT, ""),
    ("light", _TEXT, ""),  # JSON of a LightCondition; "" as the scene was made
    ("goal_picture", _TEXT, ""),  # JSON of a GoalPicture; "" where none is recorded
    ("path_source", _TEXT, ""),  # see `Episode.path_source`
    ("agent_sliding", _TEXT, ""),  # "yes" for a body that slides along walls
)
# written only where an episode has something to say, so that other files stay as they were
RARE_COLUMNS: tuple[tuple[str, pa.DataType, str | float], ...] = (
    ("goal_set", _TEXT, ""),  # JSON of a GoalSet; "" where there is one goal
    ("tier", _TEXT, ""),
    ("agent_step_seconds", _REAL, STEP_SECONDS),
    ("people", _TEXT, ""),  # JSON of a list of EpisodePerson; "" where there is nobody
    ("follow", _TEXT, ""),  # JSON of what more is known of a mission to follow somebody
)


def _schema(used: Sequence[str]) -> pa.Schema:
    """The columns of a file; of the rare ones, those that are used."""
    rare = [column for column in RARE_COLUMNS if column[0] in used]
    return pa.schema(
        [
            pa.field(name, kind, nullable=False)
            for name, kind, *_ in (*GN_MATRIX_COLUMNS, *OUR_COLUMNS, *LATER_COLUMNS, *rare)
        ],
        metadata={
            "gn0.episodes": "1",
            "gn0.frame": "*_3dgs_*: world frame, m, rad; others: GN-Matrix",
        },
    )


def fill_rare_columns(table: pa.Table, names: Sequence[str]) -> pa.Table:
    """The table with those of the rare columns that `names` has, empty where it had none."""
    for name, kind, absent in RARE_COLUMNS:
        if name in names and name not in table.column_names:
            field = pa.field(name, kind, nullable=False)
            table = table.append_column(field, pa.array([absent] * len(table), kind))
    ours = [name for name, *_ in RARE_COLUMNS if name in table.column_names]
    others = [name for name in table.column_names if name not in ours]
    return table.select([*others, *ours])


def world_to_nav(grid: OccupancyGrid, points: NDArray[np.floating]) -> F64:
    """3DGS world points [N, 2] m in GN-Matrix's "world": a shift by −(lower + upper)."""
    x0, y0, x1, y1 = grid.bounds
    return np.asarray(points, np.float64).reshape(-1, 2) - (x0 + x1, y0 + y1)


def nav_to_world(grid: OccupancyGrid, points: NDArray[np.floating]) -> F64:
    """GN-Matrix "world" points [N, 2] m in the 3DGS world frame."""
    x0, y0, x1, y1 = grid.bounds
    return np.asarray(points, np.float64).reshape(-1, 2) + np.array([x0 + x1, y0 + y1])


def cells_to_pixels(grid: OccupancyGrid, cells: NDArray[np.integer]) -> NDArray[np.int64]:
    """Cells (row, col) [N, 2] as pixels (x, y) [N, 2] of our `occupancy.png`.

    Its columns run against x and its rows along y, so that x = upper_x − (px + .5)·s.
    """
    rc = np.asarray(cells, np.int64).reshape(-1, 2)
    return np.column_stack([grid.shape[1] - 1 - rc[:, 1], rc[:, 0]])


def save_episodes(
    path: Path | str, episodes: Sequence[Episode], grids: Mapping[str, OccupancyGrid]
) -> None:
    """Write episodes, atomically; the same episodes give the same bytes.

    Args:
        path: the Parquet file.
        episodes: what to write, in this order.
        grids: the raw occupancy grid of each scene, for GN-Matrix's frame and pixels.

    Raises:
        EpisodeError: an invalid episode, a repeated id, or a scene without a grid.
        StorageError: the file cannot be written.
    """
    check_unique(episodes)
    used = [name for name in ("goal_set", "tier") if any(getattr(e, name) for e in episodes)]
    if any(episode.agent.step_seconds != STEP_SECONDS for episode in episodes):
        used.append("agent_step_seconds")
    if any(episode.people for episode in episodes):
        used.append("people")
    if any(_encode_follow(episode.mission) for episode in episodes):
        used.append("follow")
    schema = _schema(used)
    rows: dict[str, list[Any]] = {name: [] for name in schema.names}
    for episode in episodes:
        check_episode(episode)
        if episode.scene_id not in grids:
            raise EpisodeError(
                f"no grid for scene {episode.scene_id!r}",
                where=f"episode {episode.id!r}",
                remedy="pass the grid of every scene",
            )
        row = gn_matrix_row(episode, grids[episode.scene_id])
        for name in rows:
            rows[name].append(row[name])
    table = pa.table({f.name: pa.array(rows[f.name], f.type) for f in schema}, schema=schema)
    stream = io.BytesIO()
    pq.write_table(table, stream, compression="zstd", store_schema=True)
    write_bytes(path, stream.getvalue())


class Named(Protocol):
    """Anything with an id."""

    @property
    def id(self) -> str:
        """Its id."""
        ...


def check_unique(episodes: Sequence[Named], file: str | Path = "") -> None:
    """Refuse a repeated episode id: results would overwrite each other.

    Raises:
        EpisodeError: names the id and both rows.
    """
    seen: dict[str, int] = {}
    for row, episode in enumerate(episodes, 1):
        if episode.id in seen:
            raise EpisodeError(
                f"id {episode.id!r} is used by row {seen[episode.id]} and row {row}",
                where=file,
                remedy="give every episode an id of its own",
            )
        seen[episode.id] = row


def gn_matrix_row(episode: Episode, grid: OccupancyGrid) -> dict[str, Any]:
    """All columns of an episode, GN-Matrix's and ours, by name."""
    points = np.array(episode.path, np.float64).reshape(-1, 2)
    cells = rasterise_path(grid, points) if len(points) else np.zeros((0, 2), np.int64)
    pixels = cells_to_pixels(grid, cells)
    nav = world_to_nav(grid, grid.centres_of(cells))
    start = world_to_nav(grid, np.array([episode.start[:2]]))[0]
    goal = world_to_nav(grid, np.array([episode.goal]))[0]
    goal_pixel = cells_to_pixels(grid, grid.cells_of(np.array([episode.goal])))[0]
    yaw = episode.start[2]
    mission = episode.mission
    prefix = f"{episode.scene_id}_"
    agent = episode.agent
    return {
        "scene": episode.scene_id,
        "trajectory_id": episode.id.removeprefix(prefix) or episode.id,
        "instruction": episode.instruction,
        "grounded_instruction": episode.instruction,
        "label_ins_id": "" if isinstance(mission, MissionFollow) else mission.object_id,
        "label_label": "" if isinstance(mission, MissionFollow) else mission.category,
        "label_goal_pixel_x": int(goal_pixel[0]),
        "label_goal_pixel_y": int(goal_pixel[1]),
        "start_world_x": start[0],
        "start_world_y": start[1],
        "start_facing_unit_dx": math.cos(yaw),
        "start_facing_unit_dy": math.sin(yaw),
        "start_facing_heading_degrees": math.degrees(yaw),
        "goal_world_x": goal[0],
        "goal_world_y": goal[1],
        "path_raster_world_x": nav[:, 0].tolist(),
        "path_raster_world_y": nav[:, 1].tolist(),
        "path_raster_pixel_x": pixels[:, 0].tolist(),
        "path_raster_pixel_y": pixels[:, 1].tolist(),
        "episode_id": episode.id,
        "mission": str(mission.__struct_config__.tag),
        "human": mission.human if isinstance(mission, MissionFollow) else "",
        "start_3dgs_x": episode.start[0],
        "start_3dgs_y": episode.start[1],
        "start_3dgs_yaw": yaw,
        "goal_3dgs_x": episode.goal[0],
        "goal_3dgs_y": episode.goal[1],
        "path_3dgs_x": points[:, 0].tolist(),
        "path_3dgs_y": points[:, 1].tolist(),
        "split": episode.split,
        "seed": episode.seed,
        "agent_radius": agent.radius,
        "agent_camera_height": agent.camera_height,
        "agent_forward_step": agent.forward_step,
        "agent_turn_degrees": agent.turn_degrees,
        "path_id": episode.path_id,
        "style": mission.style if isinstance(mission, MissionInstruction) else "",
        "light": "" if episode.light is None else msgspec.json.encode(episode.light).decode(),
        "goal_picture": _encoded(mission.picture if isinstance(mission, MissionGoal) else None),
        "path_source": episode.path_source,
        "agent_sliding": "yes" if agent.sliding else "",
        "goal_set": encode_goal_set(episode.goal_set),
        "tier": episode.tier,
        "agent_step_seconds": agent.step_seconds,
        "people": encode_people(episode.people),
        "follow": _encode_follow(mission),
    }


def load_episodes(
    path: Path | str, grids: Mapping[str, OccupancyGrid] | None = None
) -> list[Episode]:
    """Read episodes, strictly.

    Args:
        path: a Parquet file with our columns, or one of GN-Matrix alone.
        grids: raw grid of each scene; needed only for a file without our columns.

    Raises:
        StorageError: missing, unreadable or too large.
        FormatError: not Parquet, a column missing, unknown or of the wrong type, a null, lists of
            unequal length; names the row and the column.
        EpisodeError: an episode that makes no sense on its own, or a repeated id.
    """
    table = read_table(Path(path))
    ours = "episode_id" in table.column_names
    columns = GN_MATRIX_COLUMNS + OUR_COLUMNS if ours else GN_MATRIX_COLUMNS
    values = {
        name: (count_column if ours and name in PATH_COLUMNS else read_column)(
            table, name, kind, path
        )
        for name, kind in columns
    }
    for name, kind, absent in (*LATER_COLUMNS, *RARE_COLUMNS) if ours else ():
        there = name in table.column_names
        values[name] = read_column(table, name, kind, path) if there else [absent] * table.num_rows
    unknown = sorted(set(table.column_names) - set(values))
    if unknown and ours:
        raise FormatError("unknown column", file=path, field=unknown[0], remedy="remove it")
    check_path_lists(values, path)
    if ours:
        _check_lists(values, path, ("path_3dgs_x", "path_3dgs_y"))
    episodes = []
    for row in range(table.num_rows):
        cells = {name: column[row] for name, column in values.items()}
        try:
            episode = _our_episode(cells) if ours else _gn_matrix_episode(cells, grids or {}, row)
            episodes.append(check_episode(episode))
        except EpisodeError as error:
            raise EpisodeError(
                error.what,
                where=f"{path}, row {row + 1}, {error.where}".rstrip(", "),
                remedy=error.remedy or "correct the row, or build the suite again",
            ) from None
    check_unique(episodes, path)
    return episodes


def read_table(path: Path) -> pa.Table:
    """A Parquet file as an Arrow table, every value checked.

    Raises:
        StorageError: missing, unreadable or too large.
        FormatError: not Parquet, or damaged.
    """
    data = read_bytes(path, SIZE_LIMIT)
    try:
        # no threads of Arrow's: one that lets go of our bytes while Python ends takes it down
        file = pq.ParquetFile(pa.BufferReader(data), pre_buffer=False)
        about = file.metadata
        sizes = [about.row_group(i).total_byte_size for i in range(about.num_row_groups)]
        if about.num_rows > ROW_LIMIT or sum(sizes) > SIZE_LIMIT:
            raise FormatError(
                f"claims {about.num_rows} rows and {sum(sizes)} bytes, more than allowed here",
                file=path,
                remedy="split the suite",
            )
        table = file.read(use_threads=False)
        table.validate(full=True)  # a damaged column must not surface later
        _ = table.column_names
        return table
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
        raise FormatError(
            f"not a readable Parquet file: {(str(error).splitlines() or ['damaged'])[0]}",
            file=path,
            remedy="write it again: it may be cut short",
        ) from None


def check_path_lists(values: Mapping[str, list[Any]], path: Path | str) -> None:
    """Refuse rows whose four path lists differ in length.

    Raises:
        FormatError: names the row and the column.
    """
    _check_lists(values, path, PATH_COLUMNS)


def _check_lists(values: Mapping[str, list[Any]], path: Path | str, names: Sequence[str]) -> None:
    for row, lists in enumerate(zip(*(values[name] for name in names), strict=True), 1):
        for name, items in zip(names[1:], lists[1:], strict=True):
            if len(items) != len(lists[0]):
                raise FormatError(
                    f"row {row} has {len(items)} values, {names[0]} has {len(lists[0])}",
                    file=path,
                    field=name,
                    remedy="the lists of a path have equal length",
                )


def _our_episode(cells: dict[str, Any]) -> Episode:
    goal = (float(cells["goal_3dgs_x"]), float(cells["goal_3dgs_y"]))
    text = cells["grounded_instruction"]
    kind = cells["mission"]
    mission: Mission
    if kind == "goal":
        mission = MissionGoal(
            goal=goal,
            object_id=cells["label_ins_id"],
            category=cells["label_label"],
            instruction=text,
            picture=_goal_picture(cells["goal_picture"]),
        )
    elif kind == "instruction":
        mission = MissionInstruction(
            goal=goal,
            instruction=text,
            object_id=cells["label_ins_id"],
            category=cells["label_label"],
            style=cells["style"],
        )
    elif kind == "follow":
        more = _decode_follow(cells["follow"])
        mission = MissionFollow(goal=goal, instruction=text, human=cells["human"], **more)
    else:
        raise EpisodeError(
            f"mission {kind!r} is unknown",
            where="column 'mission'",
            remedy="goal, instruction or follow",
        )
    return Episode(
        id=cells["episode_id"],
        scene_id=cells["scene"],
        mission=mission,
        start=(
            float(cells["start_3dgs_x"]),
            float(cells["start_3dgs_y"]),
            float(cells["start_3dgs_yaw"]),
        ),
        path=_points(cells["path_3dgs_x"], cells["path_3dgs_y"]),
        split=cells["split"],
        seed=int(cells["seed"]),
        agent=AgentSpec(
            radius=float(cells["agent_radius"]),
            camera_height=float(cells["agent_camera_height"]),
            forward_step=float(cells["agent_forward_step"]),
            turn_degrees=float(cells["agent_turn_degrees"]),
            sliding=_sliding(cells["agent_sliding"]),
            step_seconds=float(cells["agent_step_seconds"]),
        ),
        path_id=cells["path_id"],
        light=_light(cells["light"]),
        path_source=_path_source(cells["path_source"]),
        goal_set=decode_goal_set(cells["goal_set"]),
        tier=cells["tier"],
        people=decode_people(cells["people"]),
    )


def _sliding(text: str) -> bool:
    if text not in ("", "yes"):
        raise EpisodeError(
            f"agent_sliding is {text!r:.40}",
            where="column 'agent_sliding'",
            remedy="leave it empty, or write yes",
        )
    return text == "yes"


def _path_source(text: str) -> PathSource:
    known = get_args(PathSource)
    if text not in known:
        raise EpisodeError(
            f"path_source {text!r:.40} is unknown",
            where="column 'path_source'",
            remedy="leave it empty, or give " + ", ".join(known[1:]),
        )
    return cast(PathSource, text)


def _light(text: str) -> LightCondition | None:
    if not text:
        return None
    try:
        return msgspec.json.decode(text, type=LightCondition)
    except (msgspec.DecodeError, msgspec.ValidationError) as error:
        raise EpisodeError(
            f"light is not a light condition: {error}",
            where="column 'light'",
            remedy="leave it empty, or write the JSON of one",
        ) from None


_FOLLOW = ("person", "category", "level", "distance", "lateral", "seconds", "actions")
_FOLLOW_PLAIN = MissionFollow(goal=(0.0, 0.0), instruction="", human="")


def _encode_follow(mission: Mission) -> str:
    """What is known of a mission to follow somebody beside whom, as JSON; "" nothing."""
    if not isinstance(mission, MissionFollow):
        return ""
    known = {name: getattr(mission, name) for name in _FOLLOW}
    told = {k: v for k, v in known.items() if v != getattr(_FOLLOW_PLAIN, k)}
    return msgspec.json.encode(told).decode() if told else ""


def _decode_follow(text: str) -> dict[str, Any]:
    if not text:
        return {}
    try:
        told = msgspec.json.decode(text, type=dict[str, Any])
        if not set(told) <= set(_FOLLOW):
            raise msgspec.ValidationError(f"unknown {sorted(set(told) - set(_FOLLOW))[0]!r:.40}")
        plain = {"goal": (0.0, 0.0), "instruction": "", "human": "", "type": "follow"}
        found = msgspec.convert({**plain, **told}, MissionFollow)
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
        raise EpisodeError(
            f"follow is not about a mission to follow somebody: {error}",
            where="column 'follow'",
            remedy=f"leave it empty, or write JSON with {', '.join(_FOLLOW)}",
        ) from None
    return {name: getattr(found, name) for name in told}


def _encoded(picture: GoalPicture | None) -> str:
    return "" if picture is None else msgspec.json.encode(picture).decode()


def encode_goal_set(goals: GoalSet | None) -> str:
    """A goal set as JSON; "" for none."""
    return "" if goals is None else msgspec.json.encode(goals).decode()


def decode_goal_set(text: str) -> GoalSet | None:
    """A goal set from JSON; "" is none.

    Raises:
        EpisodeError: it is not one.
    """
    if not text:
        return None
    try:
        return msgspec.json.decode(text, type=GoalSet)
    except (msgspec.DecodeError, msgspec.ValidationError, EpisodeError) as error:
        raise EpisodeError(
            f"goal_set is not a goal set: {error}",
            where="column 'goal_set'",
            remedy="leave it empty, or write the JSON of one",
        ) from None


def _goal_picture(text: str) -> GoalPicture | None:
    if not text:
        return None
    try:
        return msgspec.json.decode(text, type=GoalPicture)
    except (msgspec.DecodeError, msgspec.ValidationError, EpisodeError) as error:
        raise EpisodeError(
            f"goal_picture is not a goal picture: {error}",
            where="column 'goal_picture'",
            remedy="leave it empty, or write the JSON of one",
        ) from None


def _gn_matrix_episode(
    cells: dict[str, Any], grids: Mapping[str, OccupancyGrid], row: int
) -> Episode:
    scene = cells["scene"]
    if scene not in grids:
        raise EpisodeError(
            f"a GN-Matrix row of scene {scene!r} needs the scene's grid to find its frame",
            remedy="give the folder of the scene",
        )
    grid = grids[scene]
    pairs = [
        (cells["start_world_x"], cells["start_world_y"]),
        (cells["goal_world_x"], cells["goal_world_y"]),
    ]
    (sx, sy), (gx, gy) = nav_to_world(grid, np.array(pairs, np.float64)).tolist()
    nav = np.column_stack([cells["path_raster_world_x"], cells["path_raster_world_y"]])
    path = nav_to_world(grid, nav)
    return Episode(
        id=f"{scene}_{cells['trajectory_id']}",
        scene_id=scene,
        mission=MissionGoal(
            goal=(gx, gy),
            object_id=cells["label_ins_id"],
            category=cells["label_label"],
            instruction=cells["grounded_instruction"],
        ),
        start=(
            sx,
            sy,
            float(wrap_angle(math.radians(cells["start_facing_heading_degrees"]))),
        ),
        path=_points(path[:, 0].tolist(), path[:, 1].tolist()),
        seed=row + 1,
    )


def _points(xs: Sequence[float], ys: Sequence[float]) -> tuple[tuple[float, float], ...]:
    return tuple(zip(map(float, xs), map(float, ys), strict=True))


def episodes_digest_bytes(episodes: Sequence[Episode]) -> bytes:
    """The decoded values of episodes as canonical bytes, for hashing; not a file format.

    What episodes did not always have is left out where it says nothing, so that suites keep the
    hash that they had.
    """
    plain = [msgspec.to_builtins(episode) for episode in episodes]
    for value in plain:
        mission = value["mission"]
        for holder, names in ((value, _LATER), (mission, _LATER_OF_MISSION[mission["type"]])):
            for name in names:
                if not holder[name]:
                    del holder[name]
    return msgspec.json.encode(plain, order="deterministic")


_LATER = ("path_id", "light", "path_source", "goal_set", "tier", "people")
_LATER_OF_MISSION: dict[str, tuple[str, ...]] = {
    "goal": ("picture",),
    "instruction": ("object_id", "category", "style"),
    "follow": _FOLLOW,
}
