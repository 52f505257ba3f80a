"""How a goal picture is taken: on arrival, or of the target alone from where it is seen well.

Only the record is made here; whoever wants the picture renders it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64, view_from_pose, wrap_angle
from gn0.maps.grid import FREE
from gn0.maps.ray import cast_rays
from gn0.missions.episode import GoalPicture
from gn0.missions.generate.settings import PictureKind
from gn0.missions.targets import (
    GoalTarget,
    distance_to_footprint,
    is_goal_worthy,
    points_in_polygon,
    room_of_object,
    sees,
)
from gn0.render.camera import Camera
from gn0.scenes.scene import ObjectBox, Scene

if TYPE_CHECKING:
    from gn0.maps.navigation import NavigationMap

NEAREST, FARTHEST = 1.0, 4.5  # m from the target's footprint to the eye of a crop
MARGIN = 1.15  # the crop is this much wider than the target
LEAST_HFOV = 12.0  # degrees
STEEPEST = math.radians(60.0)
LOW = 1.0  # m: over what is lower one looks away
TRIES = 40  # cells tried as the eye of a crop
STEP = 1.2  # m that the eye of a view may be off the goal
FLAT = 0.3  # of its width: what is less deep has a face to be looked at
_DIRECTIONS = 72


def face_on(box: ObjectBox, points: F64) -> F64:
    """How squarely points [N, 2] m face a flat box: 1 in front of it, 0 along it; else 1."""
    wide, deep = max(box.size[:2]), min(box.size[:2])
    if deep > FLAT * wide:
        return np.ones(len(points))
    across = box.yaw if box.size[0] < box.size[1] else box.yaw + math.pi / 2
    gaps = points - np.array(box.centre[:2])
    along = gaps @ (math.cos(across), math.sin(across))
    return np.abs(along) / np.maximum(np.hypot(*gaps.T), 1e-9)


class GoalPhotographer:
    """Chooses goal pictures in one scene.

    Args:
        scene: objects and rooms.
        navigation: where a camera may stand.
        camera: the agent's own.
        height: height of its eye [m].
    """

    def __init__(
        self, scene: Scene, navigation: NavigationMap, camera: Camera, height: float
    ) -> None:
        self._scene = scene
        self._navigation = navigation
        self._camera = camera
        self._height = height
        self._tall = navigation.grid.blocked.copy()
        for item in scene.objects:
            if item.box.centre[2] + item.box.size[2] / 2 <= LOW:
                self._clear(self._tall, item.box)

    def choose(
        self, target: GoalTarget, kind: PictureKind, rng: np.random.Generator
    ) -> GoalPicture:
        """How to take the picture of a target; a crop only where an object shows from afar."""
        crop = kind == "crop" or (kind == "mixed" and rng.random() < 0.5)
        if crop and target.kind == "object":
            found = self._crop(target, rng)
            if found is not None:
                return found
        return self._view(target)

    def _view(self, target: GoalTarget) -> GoalPicture:
        """From the goal: towards an object, a room's furniture, or where one sees farthest."""
        x, y = target.middle or target.goal
        if target.kind == "object":
            x, y = self._step_back(target)
        eye = (x, y, self._height)
        if target.kind == "object":
            cx, cy, cz = target.object.box.centre
            away = math.hypot(cx - x, cy - y)
            yaw = wrap_angle(math.atan2(cy - y, cx - x)) if away > 1e-6 else 0.0
            half = target.object.box.size[2] / 2
            reach = max(away, 0.05)
            low = math.atan2(cz - half - self._height, reach)
            high = math.atan2(cz + half - self._height, reach)
            view = math.radians(self._camera.vfov) / 2
            pitch = 0.0
            if low < -view or high > view:  # else it is in the picture as the agent stands
                middle = math.atan2(cz - self._height, reach)
                pitch = min(max(middle, -STEEPEST), STEEPEST)
            return GoalPicture(kind="view", eye=eye, yaw=yaw, pitch=round(pitch, 6))
        angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        ranges = np.minimum(cast_rays(self._navigation.grid, x, y, angles, 10.0), 8.0)
        interest = ranges + self._furniture(target)
        width = round(self._camera.hfov / 360 * _DIRECTIONS) // 2
        wide = sum(np.roll(interest, k) for k in range(-width, width + 1))
        return GoalPicture(kind="view", eye=eye, yaw=wrap_angle(float(angles[np.argmax(wide)])))

    def _step_back(self, target: GoalTarget) -> tuple[float, float]:
        """Where to stand near a goal (x, y) [m]: a step from the object, in front of a flat one.

        The goal is the cell nearest to the object; from there a picture on a wall is seen along
        the wall, and a chair from above.
        """
        item, goal = target.object, np.array(target.goal)
        spots = self._spots(target, 0.0)
        spots = spots[np.hypot(*(spots - goal).T) <= STEP]
        solid = self._tall.copy()
        self._clear(solid, item.box)
        away = np.abs(distance_to_footprint(spots, item) - NEAREST)
        cost = away + 1.5 * (1 - face_on(item.box, spots)) + 0.3 * np.hypot(*(spots - goal).T)
        centre = np.array(item.box.centre[:2])
        for k in np.argsort(cost, kind="stable"):
            if sees(self._navigation.grid, solid, spots[k], centre):
                return float(spots[k, 0]), float(spots[k, 1])
        return target.goal

    def _furniture(self, target: GoalTarget) -> F64:
        """How much of a room's furniture lies in each direction [_DIRECTIONS] from its middle."""
        found = np.zeros(_DIRECTIONS)
        if target.kind != "room":
            return found
        for item in self._scene.objects:
            if item.room == target.object.id and is_goal_worthy(item):
                x, y = target.middle or target.goal
                dx, dy = item.box.centre[0] - x, item.box.centre[1] - y
                at = math.atan2(dy, dx) / (2 * math.pi) * _DIRECTIONS
                found[round(at) % _DIRECTIONS] += 100.0 * min(max(item.box.size), 2.0)
        return found

    def _crop(self, target: GoalTarget, rng: np.random.Generator) -> GoalPicture | None:
        """From some metres away, the target filling the picture; None where it does not show."""
        item = target.object
        centre = np.array(item.box.centre[:2])
        spots = self._spots(target, NEAREST)
        if not len(spots):
            return None
        solid = self._tall.copy()
        self._clear(solid, item.box)
        spots = spots[rng.permutation(len(spots))[:TRIES]]
        ideal = min(max(1.2 * max(item.box.size), NEAREST), FARTHEST)
        cost = np.abs(distance_to_footprint(spots, item) - ideal)
        cost += 3.0 * (1 - face_on(item.box, spots))
        order = np.argsort(cost, kind="stable")
        seen = (k for k in order if sees(self._navigation.grid, solid, spots[k], centre))
        best = next(seen, None)
        if best is None:
            return None
        eye = (float(spots[best, 0]), float(spots[best, 1]), self._height)
        cx, cy, cz = item.box.centre
        yaw = wrap_angle(math.atan2(cy - eye[1], cx - eye[0]))
        pitch = math.atan2(cz - eye[2], math.hypot(cx - eye[0], cy - eye[1]))
        pitch = min(max(pitch, -STEEPEST), STEEPEST)
        hfov = self._field_of(item.box, eye, yaw, pitch)
        return GoalPicture(
            kind="crop", eye=eye, yaw=yaw, pitch=round(pitch, 6), hfov=round(hfov, 3)
        )

    def _spots(self, target: GoalTarget, nearest: float) -> F64:
        """Walkable cells [N, 2] m round a target, in its room where that is known."""
        grid = self._navigation.inflated
        corners = target.object.box.corners()[:, :2]
        ends = np.array([corners.min(axis=0) - FARTHEST, corners.max(axis=0) + FARTHEST])
        (r0, c0), (r1, c1) = np.clip(grid.cells_of(ends), 0, (grid.shape[0] - 1, grid.shape[1] - 1))
        cells = np.argwhere(grid.cells[r0 : r1 + 1, c0 : c1 + 1] == FREE) + np.array([r0, c0])
        points = grid.centres_of(cells)
        away = distance_to_footprint(points, target.object)
        keep = (away >= nearest) & (away <= FARTHEST)
        room = room_of_object(target.object, self._scene.rooms)
        if room is not None:
            keep &= points_in_polygon(points, np.array(room.polygon))
        return points[keep]

    def _field_of(
        self, box: ObjectBox, eye: tuple[float, float, float], yaw: float, pitch: float
    ) -> float:
        """Horizontal field of view [degrees] that holds a box, in the shape of the picture."""
        view = view_from_pose(*eye, yaw, pitch)
        seen = box.corners() @ view[:3, :3].T + view[:3, 3]
        depth = np.maximum(seen[:, 2], 0.1)
        aspect = self._camera.width / self._camera.height
        half = max(np.abs(seen[:, 0] / depth).max(), np.abs(seen[:, 1] / depth).max() * aspect)
        wide = math.degrees(2 * math.atan(float(half) * MARGIN))
        return min(max(wide, LEAST_HFOV), self._camera.hfov)

    def _clear(self, cells: NDArray[np.bool_], box: ObjectBox) -> None:
        """Take a box off a mask of cells that block the view, with a cell's margin."""
        grid = self._navigation.grid
        low, high = box.corners()[:, :2].min(axis=0), box.corners()[:, :2].max(axis=0)
        (r0, c0), (r1, c1) = grid.cell_of(low[0], low[1]), grid.cell_of(high[0], high[1])
        cells[max(r0 - 1, 0) : max(r1 + 2, 0), max(c0 - 1, 0) : max(c1 + 2, 0)] = False
