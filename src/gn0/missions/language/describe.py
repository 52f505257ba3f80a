"""A path as steps: turns and straights, the rooms they go through, what one sees there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import EpisodeError
from gn0.geometry import F64, wrap_angle
from gn0.missions.alike import GoalWords, fits_name, likeness_of, names_clash, rooms_like
from gn0.missions.language.landmarks import Candidate, LandmarkFinder, choose
from gn0.missions.language.route import NOWHERE, RouteDescription, RouteSegment, RouteTarget
from gn0.missions.language.segments import Stretch, arc_lengths, point_at, split_path
from gn0.missions.language.sight import EYE, look, sight_of
from gn0.missions.language.surroundings import NO_ROOM_NAMES, Surroundings, surroundings_of
from gn0.missions.language.word_forms import NO_LANDMARK, is_plural, spoken_name
from gn0.scenes.scene import Scene, SceneObject, SceneRoom
from gn0.storage import content_hash

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap

FINE = 0.1  # m between points of the path as it is examined
LOOK_EVERY = 1.0  # m between views on a straight
LOOKS_MOST = 12  # views a straight
AHEAD_FREE = 1.3  # m ahead of a turn; less is the end of a hallway
GAZE = 1.0  # m: one looks to where the path will be


def describe_route(
    scene: Scene,
    navigation: NavigationMap,
    path: NDArray[np.floating],
    start_yaw: float,
    target: SceneObject | SceneRoom | None = None,
    *,
    eye: float = EYE,
) -> RouteDescription:
    """A path as steps with what is really visible on each.

    Args:
        scene: the scene.
        navigation: its map; says where a hallway ends, nothing is planned here.
        path: the route [N, 2] m, start first.
        start_yaw: heading at the start [rad].
        target: the object or room it leads to; None where nothing there has a name.
        eye: height of the eye [m].

    Raises:
        EpisodeError: the path is empty, not finite, or leaves the map.
    """
    p = np.asarray(path, np.float64).reshape(-1, 2)
    if not len(p) or not np.isfinite(p).all() or not np.isfinite(start_yaw):
        raise EpisodeError(
            "the path is empty or not finite", where=f"scene {scene.id!r}", remedy="plan it again"
        )
    x0, y0, x1, y1 = navigation.grid.bounds
    if (p < (x0, y0)).any() or (p > (x1, y1)).any():
        raise EpisodeError(
            "the path leaves the map",
            where=f"scene {scene.id!r}",
            remedy="give the scene and the path that belong together",
        )
    surroundings = surroundings_of(scene)
    lengths = arc_lengths(p)
    total = float(lengths[-1])
    stretches = split_path(p, start_yaw)
    spans = _spans(stretches, total)
    end_yaw = _yaw_at(p, lengths, max(total - 0.3, 0.0), total, start_yaw)
    goal = _describe_target(surroundings, target, p[-1], end_yaw)
    rows, poses = _viewpoints(p, lengths, stretches, spans, start_yaw)
    views = look(sight_of(scene), len(scene.objects), poses, eye)
    finder = LandmarkFinder(surroundings, poses, views, _refused(surroundings, goal))
    steps = max(2, int(np.ceil(total / FINE)) + 1)
    fine = np.linspace(0.0, total, steps)
    spacing = total / (steps - 1) if total > 0 else FINE
    points = point_at(p, lengths, fine)
    points_room = surroundings.rooms_along(points, spacing)
    found: list[list[Candidate]] = []
    segments: list[RouteSegment] = []
    for i, (stretch, (a, b)) in enumerate(zip(stretches, spans, strict=True)):
        ends = point_at(p, lengths, [a, b])
        start, end = _pair(ends[0]), _pair(ends[1])
        inside = (fine >= a - spacing / 2) & (fine <= b + spacing / 2)
        if stretch.turn is not None:
            approach = rows[i - 1] if i > 0 else np.zeros(0, np.int64)
            pose = poses[rows[i][0]]
            here = int(np.clip(round(a / spacing), 0, len(points_room) - 1))
            around = points_room[here : here + 9]
            found.append(
                finder.at_turn(approach, int(rows[i][0]), pose[:2], float(pose[2]), around)
            )
            room = points_room[here]
            before = poses[rows[i - 1][-1], 2] if i > 0 else float(start_yaw)
            segments.append(
                RouteSegment(
                    turn=stretch.turn,
                    angle=round(stretch.angle, 1),
                    start=start,
                    end=end,
                    inside=surroundings.room_names[room] if room >= 0 else "",
                    blocked_ahead=i > 0 and _is_blocked(navigation, pose[:2], before),
                )
            )
            continue
        seen = np.r_[rows[i - 1][-1:], rows[i]] if i > 0 else rows[i]
        at = np.r_[[0.0] if i > 0 else [], _stops(a, b) - a]
        part, where = points[inside], points_room[inside]
        found.append(finder.on_straight(seen, at, part, where, spacing))
        segments.append(_straight(surroundings, where, part, b - a, start, end, spacing))
    chosen = choose(found)
    vocabulary, shared_rooms = _words_of(surroundings)
    return RouteDescription(
        scene_id=scene.id,
        key=content_hash(
            scene.id, np.round(p, 4), round(float(start_yaw), 4), goal.object_id, goal.name
        )[:16],
        segments=tuple(
            RouteSegment(
                **{f: getattr(s, f) for f in s.__struct_fields__ if f != "landmarks"}, landmarks=m
            )
            for s, m in zip(segments, chosen, strict=True)
        ),
        target=goal,
        length=round(total, 3),
        vocabulary=vocabulary,
        shared_rooms=shared_rooms,
    )


def describe_goal(scene: Scene, target: SceneObject | SceneRoom | None) -> RouteDescription:
    """A route of no steps, whose end is all that is said: for texts of style "base"."""
    surroundings = surroundings_of(scene)
    end = np.zeros(2)
    goal = _describe_target(surroundings, target, end, 0.0)
    vocabulary, shared_rooms = _words_of(surroundings)
    return RouteDescription(
        scene_id=scene.id,
        key=content_hash(scene.id, goal.object_id, goal.name)[:16],
        segments=(),
        target=msgspec.structs.replace(goal, side=""),
        length=0.0,
        vocabulary=vocabulary,
        shared_rooms=shared_rooms,
    )


def _words_of(surroundings: Surroundings) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names that a scene holds, and the types of room of which it has several."""
    names = {n for n in surroundings.by_name if n and n not in NO_LANDMARK}
    kinds = [n for n in surroundings.room_names if n]
    shared = {n for n in kinds if sum(fits_name(k, n) for k in kinds) > 1}
    return tuple(sorted(names | set(kinds))), tuple(sorted(shared))


def _spans(stretches: list[Stretch], total: float) -> list[tuple[float, float]]:
    """From where to where [m] each stretch counts: straights reach to the middle of their turns."""
    middles = [(s.begin + s.end) / 2 for s in stretches]
    out = []
    for i, stretch in enumerate(stretches):
        if stretch.turn is not None:
            out.append((middles[i], middles[i]))
        else:
            a = middles[i - 1] if i > 0 else 0.0
            b = middles[i + 1] if i + 1 < len(stretches) else total
            out.append((a, b))
    return out


def _stops(a: float, b: float) -> F64:
    count = int(np.clip(np.ceil((b - a) / LOOK_EVERY), 1, LOOKS_MOST - 1)) + 1
    return np.linspace(a, b, count)


def _viewpoints(
    path: F64,
    lengths: F64,
    stretches: list[Stretch],
    spans: list[tuple[float, float]],
    start_yaw: float,
) -> tuple[list[NDArray[np.int64]], F64]:
    """Poses [V, 3] at which one looks, and which of them belong to each stretch."""
    rows: list[NDArray[np.int64]] = []
    poses: list[tuple[float, float, float]] = []
    for stretch, (a, b) in zip(stretches, spans, strict=True):
        first = len(poses)
        if stretch.turn is not None:
            x, y = point_at(path, lengths, a)[0]
            yaw = _yaw_at(path, lengths, stretch.end, stretch.end + GAZE, start_yaw)
            poses.append((x, y, yaw))
        else:
            yaw = start_yaw
            for s in _stops(a, b):
                x, y = point_at(path, lengths, s)[0]
                # in the last steps one still looks ahead, not into the coming turn
                reach = min(s + GAZE, max(stretch.end, stretch.begin))
                if reach - s > 0.2:
                    yaw = _yaw_at(path, lengths, s, reach, yaw)
                poses.append((x, y, yaw))
        rows.append(np.arange(first, len(poses)))
    return rows, np.array(poses, np.float64).reshape(-1, 3)


def _yaw_at(path: F64, lengths: F64, a: float, b: float, default: float) -> float:
    ends = point_at(path, lengths, [a, b])
    d = ends[1] - ends[0]
    return float(np.arctan2(d[1], d[0])) if np.hypot(*d) > 1e-6 else default


def _straight(
    surroundings: Surroundings,
    rooms: NDArray[np.int64],
    points: F64,
    distance: float,
    start: tuple[float, float],
    end: tuple[float, float],
    spacing: float,
) -> RouteSegment:
    changes = np.flatnonzero(np.diff(rooms)) + 1
    order = rooms[np.r_[0, changes]]
    names = [surroundings.room_names[r] if r >= 0 else "" for r in order]
    moved = len(order) > 1
    doors = surroundings.find_doors(points)
    return RouteSegment(
        distance=round(distance, 2),
        start=start,
        end=end,
        leaves=names[0] if moved else "",
        enters=names[-1] if moved and names[-1] != names[0] else "",
        crosses=tuple(n for n in names[1:-1] if n),
        inside=names[0],
        enters_after=round(float(changes[-1]) * spacing, 2) if moved else 0.0,
        doors=len(doors),
        door_after=round(float(doors[0]) * spacing, 2) if len(doors) else 0.0,
    )


def _is_blocked(navigation: NavigationMap, point: F64, yaw: float) -> bool:
    """Whether one who went straight on would soon stand before something."""
    x, y = float(point[0]), float(point[1])
    ahead = (x + AHEAD_FREE * np.cos(yaw), y + AHEAD_FREE * np.sin(yaw))
    return navigation.is_free(x, y) and navigation.move(x, y, float(ahead[0]), float(ahead[1]))[2]


def _describe_target(
    surroundings: Surroundings,
    target: SceneObject | SceneRoom | None,
    goal: F64,
    yaw: float,
) -> RouteTarget:
    if target is None:
        return RouteTarget(object_id="", name=NOWHERE, region=True)
    if isinstance(target, SceneRoom):
        name = spoken_name(target.type)
        like = len(rooms_like(surroundings.scene, target))
        if name in NO_ROOM_NAMES:
            return RouteTarget(object_id=target.id, name=NOWHERE, region=True)
        return RouteTarget(object_id=target.id, name=name, unique=like <= 1, region=True)
    name = spoken_name(target.category)
    scene = surroundings.scene
    index = next((i for i, o in enumerate(scene.objects) if o.id == target.id), -1)
    words, alike = GoalWords(name), 1
    if index >= 0:
        words, fitting = likeness_of(surroundings.scene).tell(index)
        alike = len(fitting)
    centre = np.array(target.box.centre[:2]) - goal
    bearing = np.degrees(wrap_angle(float(np.arctan2(centre[1], centre[0])) - yaw))
    side: Literal["left", "right", "ahead", ""] = ""
    if abs(bearing) <= 35:
        side = "ahead"
    elif 50 <= abs(bearing) <= 135:
        side = "left" if bearing > 0 else "right"
    return RouteTarget(
        object_id=target.id,
        name=name,
        unique=alike == 1,
        plural=is_plural(name),
        near=words.near,
        room=words.room,
        side=side,
    )


def _refused(surroundings: Surroundings, goal: RouteTarget) -> frozenset[str]:
    return frozenset(n for n in surroundings.by_name if names_clash(n, goal.name) or n == goal.near)


def _pair(point: F64) -> tuple[float, float]:
    return round(float(point[0]), 3), round(float(point[1]), 3)
