"""What stands in the browser's 3D scene: splats, labels, agents, trails, tasks, and the camera."""

from __future__ import annotations

import contextlib
import inspect
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64, U8, Pose2D
from gn0.missions.episode import AgentSpec
from gn0.scenes.scene import Scene
from gn0.viewer.floor_plan import plan_bounds
from gn0.viewer.live_map import GOAL, REFERENCE
from gn0.viewer.live_splats import LiveSplats
from gn0.viewer.live_text import name_line

if TYPE_CHECKING:
    import viser

Colour = tuple[int, int, int]
BUMP: Colour = (255, 196, 0)
BODY_HEIGHT = 1.5  # of the cylinder that is drawn [m]
OVERVIEW_FOV = math.radians(50)
_HALF_LIMIT = 6e4  # what a 16-bit float holds
_FINE = 16.0  # splats are sent this much larger: a thin disc's variance is lost in 16 bits else


class LiveBody:
    """An agent in the scene: a cylinder with a nose, and the line of its steps."""

    def __init__(self, server: viser.ViserServer, name: str, agent: AgentSpec, colour: Colour):
        self._scene, self._name, self._colour = server.scene, name, colour
        self._trail_shown = True
        self._frame = server.scene.add_frame(name, show_axes=False)
        height = max(BODY_HEIGHT, agent.camera_height + 0.15)
        radius = max(agent.radius, 0.05)
        self._cylinder = server.scene.add_cylinder(
            f"{name}/body", radius, height, color=colour, opacity=0.75, position=(0, 0, height / 2)
        )
        self._nose = server.scene.add_mesh_simple(
            f"{name}/nose", *_nose(radius, agent.camera_height), color=(255, 255, 255)
        )
        self._line: Any = None

    def move(
        self, pose: Pose2D, trail: Sequence[tuple[float, float]] = (), bumped: bool = False
    ) -> None:
        """Stand at a pose; draw the way here [(x, y) m]."""
        self._frame.position = (pose.x, pose.y, 0.0)
        self._frame.wxyz = (math.cos(pose.yaw / 2), 0.0, 0.0, math.sin(pose.yaw / 2))
        self._cylinder.color = BUMP if bumped else self._colour
        if self._line is not None:
            self._line.remove()
            self._line = None
        if len(trail) > 1:
            self._line = add_line(self._scene, f"{self._name}_trail", trail, self._colour, 0.08, 4)
            self._line.visible = self._trail_shown

    def show(self, visible: bool, *, trail: bool = True) -> None:
        """Show or hide the body, and its trail."""
        self._frame.visible = visible
        self._trail_shown = trail
        if self._line is not None:
            self._line.visible = trail

    def remove(self) -> None:
        """Take body and trail away."""
        for handle in (self._line, self._frame):
            if handle is not None:
                handle.remove()


def _nose(radius: float, height: float) -> tuple[F64, NDArray[np.int64]]:
    """Vertices and faces of a wedge that points ahead at eye height."""
    a, b, h = radius * 0.8, radius * 2.0, 0.09
    corners = [(a, radius * 0.7), (a, -radius * 0.7), (b, 0.0)]
    vertices = np.array([(x, y, height + z) for z in (-h, h) for x, y in corners])
    faces = [(0, 2, 1), (3, 4, 5), (0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (2, 0, 3), (2, 3, 5)]
    return vertices, np.array(faces)


def add_line(
    scene: Any,
    name: str,
    points: NDArray[np.floating] | Sequence[tuple[float, float]],
    colour: Colour,
    height: float,
    width: float,
) -> Any:
    """A line on the floor through points [N, 2] m, `height` [m] above it, `width` [px]."""
    xy = np.asarray(points, np.float32).reshape(-1, 2)
    line = np.column_stack([xy, np.full(len(xy), height, np.float32)])
    pairs = np.stack([line[:-1], line[1:]], axis=1)
    wide: dict[str, Any] = {"line_width": width}
    if "thickness" in inspect.signature(scene.add_line_segments).parameters:  # viser 1.1 and later
        wide = {"thickness": width, "thickness_units": "screen"}
    return scene.add_line_segments(name, pairs, colors=colour, **wide)


class LiveStage:
    """The browser's scene. All names of nodes are ours; texts of others appear in labels only."""

    def __init__(self, server: viser.ViserServer) -> None:
        self.server = server
        self._splats: dict[str, Any] = {}
        self._rooms: list[Any] = []
        self._things: list[Any] = []
        self._task: list[Any] = []
        self._plan: Any = None
        self._fitted: dict[int, tuple[float, F64]] = {}  # visitor -> aspect, position of overview
        self.ceiling = False
        self.splats_shown = True
        self.veiled = False
        self._names_shown = {"rooms": False, "objects": False}

    def show_splats(self, splats: LiveSplats, cut: float | None) -> None:
        """Put splats on the stage; those above `cut` [m] are the ceiling and can be hidden."""
        high = splats.centres[:, 2] > cut if cut is not None else np.zeros(len(splats), bool)
        for name, part in (("low", splats.select(~high)), ("high", splats.select(high))):
            old = self._splats.pop(name, None)
            if old is not None:
                old.remove()
            if len(part):
                self._splats[name] = self.server.scene.add_gaussian_splats(
                    f"/splats/{name}",
                    centers=part.centres * np.float32(_FINE),
                    covariances=np.clip(part.covariances * _FINE**2, -_HALF_LIMIT, _HALF_LIMIT),
                    rgbs=part.colours,
                    opacities=part.opacities[:, None],
                    scale=1 / _FINE,
                    visible=self._is_shown(name),
                )

    def show(self, *, splats: bool | None = None, ceiling: bool | None = None) -> None:
        """Show or hide the splats, or those of the ceiling."""
        self.splats_shown = self.splats_shown if splats is None else splats
        self.ceiling = self.ceiling if ceiling is None else ceiling
        for name, handle in self._splats.items():
            handle.visible = self._is_shown(name)

    def _is_shown(self, name: str) -> bool:
        return self.splats_shown and not self.veiled and (name == "low" or self.ceiling)

    def veil(self, veiled: bool) -> None:
        """Put everything but the agents out of sight, or show again what was shown."""
        if veiled == self.veiled:
            return
        self.veiled = veiled
        self.show()
        self.show_labels(**self._names_shown)
        for handle in (*self._task, *([] if self._plan is None else [self._plan])):
            handle.visible = not veiled

    def add_labels(self, scene: Scene, *, rooms: bool, objects: bool) -> None:
        """Names of rooms and objects, shown or not."""
        self._names_shown = {"rooms": rooms, "objects": objects}
        rooms, objects = rooms and not self.veiled, objects and not self.veiled
        for number, room in enumerate(scene.rooms):
            x, y = np.asarray(room.polygon, np.float64).mean(axis=0)
            self._rooms.append(
                self.server.scene.add_label(
                    f"/labels/room_{number}",
                    name_line(room.type, 40).upper(),
                    position=(float(x), float(y), 1.2),
                    anchor="center-center",
                    font_screen_scale=1.1,
                    visible=rooms,
                )
            )
        for number, thing in enumerate(scene.objects):
            x, y, z = thing.box.centre
            self._things.append(
                self.server.scene.add_label(
                    f"/labels/thing_{number}",
                    name_line(thing.category, 40),
                    position=(x, y, z + thing.box.size[2] / 2 + 0.05),
                    anchor="bottom-center",
                    font_screen_scale=0.75,
                    visible=objects,
                )
            )

    def show_labels(self, *, rooms: bool | None = None, objects: bool | None = None) -> None:
        """Show or hide the names of rooms, of objects."""
        for kind, wanted, handles in (
            ("rooms", rooms, self._rooms),
            ("objects", objects, self._things),
        ):
            if wanted is not None:
                self._names_shown[kind] = wanted
                for handle in handles:
                    handle.visible = wanted and not self.veiled

    def show_plan(self, picture: U8 | None, bounds: tuple[float, float, float, float]) -> None:
        """Lay a plan [H, W, 3] of x0, y0, x1, y1 [m] on the floor; None takes it away."""
        if self._plan is not None:
            self._plan.remove()
            self._plan = None
        if picture is not None:
            x0, y0, x1, y1 = bounds
            self._plan = self.server.scene.add_image(
                "/plan",
                picture,
                render_width=x1 - x0,
                render_height=y1 - y0,
                wxyz=(0.0, 1.0, 0.0, 0.0),  # viser draws pictures y down, as seen by a camera
                position=((x0 + x1) / 2, (y0 + y1) / 2, 0.015),
                visible=not self.veiled,
            )

    def show_task(
        self, path: Sequence[tuple[float, float]], goal: tuple[float, float] | None, radius: float
    ) -> None:
        """A task's reference path, its goal as a pole, and the circle of success [m].

        There is no goal where somebody is to be followed.
        """
        for handle in self._task:
            handle.remove()
        scene = self.server.scene
        self._task = []
        if goal is not None:
            turn = np.linspace(0, 2 * np.pi, 65)
            ring = goal + radius * np.column_stack([np.cos(turn), np.sin(turn)])
            self._task = [
                scene.add_cylinder(
                    "/task/goal", 0.07, 2.2, color=GOAL, opacity=0.85, position=(*goal, 1.1)
                ),
                scene.add_label(
                    "/task/name", "GOAL", position=(*goal, 2.3), anchor="bottom-center"
                ),
                add_line(scene, "/task/ring", ring, GOAL, 0.06, 2),
            ]
        if len(path) > 1:
            self._task.append(add_line(scene, "/task/path", path, REFERENCE, 0.06, 4))
        for handle in self._task:
            handle.visible = not self.veiled

    def clear(self) -> None:
        """Empty the stage for another scene."""
        for handle in (*self._splats.values(), *self._rooms, *self._things, *self._task):
            handle.remove()
        self._splats, self._rooms, self._things, self._task = {}, [], [], []
        self.show_plan(None, (0, 0, 0, 0))

    def look(self, position: F64, target: F64, fov: float) -> None:
        """Move every visitor's camera: from, to [m], vertical field of view [rad]."""
        for client in self.server.get_clients().values():
            _turn_camera(client, position, target, fov)

    def look_over(self, scene: Scene) -> None:
        """Show every visitor the whole scene, as it fits into his window."""
        for client in self.server.get_clients().values():
            with contextlib.suppress(RuntimeError, AssertionError, ZeroDivisionError):
                self._fit(client, scene)

    def refit(self, client: viser.ClientHandle, scene: Scene) -> None:
        """Look again where a window changed its shape and its visitor has not moved since."""
        with contextlib.suppress(RuntimeError, AssertionError, ZeroDivisionError):
            aspect, place = self._fitted.get(client.client_id, (0.0, np.zeros(3)))
            moved = float(np.linalg.norm(client.camera.position - place))
            if aspect and abs(client.camera.aspect / aspect - 1) > 0.03 and moved < 0.05:
                self._fit(client, scene)

    def _fit(self, client: viser.ClientHandle, scene: Scene) -> None:
        aspect = client.camera.aspect
        position, target = overview(scene, aspect)
        self._fitted[client.client_id] = (aspect, position)
        _turn_camera(client, position, target, OVERVIEW_FOV)

    def start_at(self, position: F64, target: F64, fov: float) -> None:
        """Where a new visitor's camera begins."""
        camera = self.server.initial_camera
        camera.position = position
        camera.look_at = target
        camera.fov = fov


def _turn_camera(client: viser.ClientHandle, position: F64, target: F64, fov: float) -> None:
    # a visitor may leave at any moment; that is no error of ours
    with contextlib.suppress(RuntimeError, AssertionError, KeyError), client.atomic():
        client.camera.up_direction = (0.0, 0.0, 1.0)
        client.camera.position = position
        client.camera.look_at = target
        client.camera.fov = fov


def overview(scene: Scene, aspect: float = 1.3) -> tuple[F64, F64]:
    """Position and target [m] of a camera, high up, that sees the whole scene.

    It looks north or west, whichever shows the scene larger in a picture of that `aspect`.
    """
    x0, y0, x1, y1 = plan_bounds(scene)
    corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (0.0, 2.4)])
    target = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.6])
    choices = [
        _fit(corners - target, np.array([x, y, 0.9]), aspect) for x, y in ((0, -0.5), (0.5, 0))
    ]
    return target + min(choices, key=lambda away: float(np.linalg.norm(away))), target


def _fit(corners: F64, away: F64, aspect: float) -> F64:
    """The least multiple of `away` from where all corners [8, 3] m are in the picture."""
    back = away / np.linalg.norm(away)
    right = np.cross((0.0, 0.0, 1.0), back)
    right /= np.linalg.norm(right)
    half = math.tan(OVERVIEW_FOV / 2) * 0.94
    across, up = np.abs(corners @ right), np.abs(corners @ np.cross(back, right))
    distance = corners @ back + np.maximum(across / (half * aspect), up / half)
    return np.asarray(back * float(distance.max()))


def from_above(scene: Scene) -> tuple[F64, F64]:
    """Position and target [m] of a camera that looks straight down, north up."""
    x0, y0, x1, y1 = plan_bounds(scene)
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    height = 1.15 * max((x1 - x0) / 1.3, y1 - y0)
    return middle + np.array([0.0, -0.01 * height, height]), middle


def behind(pose: Pose2D) -> tuple[F64, F64]:
    """Position and target [m] of a camera over the agent's shoulder."""
    ahead = np.array([math.cos(pose.yaw), math.sin(pose.yaw), 0.0])
    here = np.array([pose.x, pose.y, 0.0])
    return here - 1.5 * ahead + (0, 0, 2.1), here + 1.2 * ahead + (0, 0, 0.9)
