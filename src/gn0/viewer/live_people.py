"""People in the browser's 3D scene: figures in the colours of their clothes, and their tracks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import Gn0Error
from gn0.geometry import F64, U8, Pose2D
from gn0.people.person import EpisodePerson
from gn0.viewer.live_map import FOLLOWED, PERSON, MapPerson
from gn0.viewer.live_stage import Colour, add_line

if TYPE_CHECKING:
    import viser

FOLLOW_WORD = "FOLLOW"
_HEIGHT = {"sit": 1.25}  # m, of who does not stand
_STANDS = 1.72
_SKIN: Colour = (214, 170, 140)
_SIDES = 16


class LivePeople:
    """Those around one agent, as figures: legs, trunk and head, with a nose where they look.

    Args:
        server: whose scene.
        name: of the node that holds them.
    """

    def __init__(self, server: viser.ViserServer, name: str) -> None:
        self._scene, self._name = server.scene, name
        self._figures: list[_Figure] = []
        self._shown = self._tracks = True

    def cast(self, people: Sequence[EpisodePerson], followed: int = -1) -> None:
        """Put figures for people on the stage in place of those there; `followed` is a row."""
        self.clear()
        self._figures = [
            _Figure(self._scene, f"{self._name}/{row}", person, row == followed)
            for row, person in enumerate(people)
        ]
        self.show(self._shown, tracks=self._tracks)

    def move(self, people: Sequence[MapPerson]) -> None:
        """Stand where they are, with the tracks that led there."""
        for figure, person in zip(self._figures, people, strict=True):
            figure.move(person, self._tracks)

    def show(self, visible: bool, *, tracks: bool = True) -> None:
        """Show or hide figures, and their tracks."""
        self._shown, self._tracks = visible, tracks
        for figure in self._figures:
            figure.show(visible, tracks)

    def clear(self) -> None:
        """Take everybody away."""
        for figure in self._figures:
            figure.remove()
        self._figures = []


class _Figure:
    def __init__(self, scene: Any, name: str, person: EpisodePerson, followed: bool) -> None:
        self._scene, self._name = scene, name
        self._line: Any = None
        self._colour = FOLLOWED if followed else PERSON
        self._frame = scene.add_frame(name, show_axes=False)
        height = _HEIGHT.get(person.behaviour, _STANDS)
        top, bottom, skin = wear_colours(person.identity)
        hip, neck = 0.48 * height, 0.85 * height
        for part, shape, colour in (
            ("legs", lathe(((0.10, 0.02), (0.15, hip), (0.0, hip))), bottom),
            (
                "trunk",
                lathe(((0.0, hip), (0.17, hip), (0.21, 0.92 * neck), (0.06, neck), (0.0, neck))),
                top,
            ),
            ("head", _ball(0.13, height - 0.13), skin),
            ("nose", _wedge(height - 0.15), (255, 255, 255)),
        ):
            scene.add_mesh_simple(f"{name}/{part}", *shape, color=colour, side="double")
        if followed:
            turn = np.linspace(0, 2 * np.pi, 33)
            ring = 0.34 * np.column_stack([np.cos(turn), np.sin(turn)])
            add_line(scene, f"{name}/ring", ring, FOLLOWED, 0.05, 5)
            scene.add_label(
                f"{name}/word", FOLLOW_WORD, position=(0, 0, height + 0.2), anchor="bottom-center"
            )

    def move(self, person: MapPerson, tracks: bool) -> None:
        pose = person.pose
        self._frame.position = (pose.x, pose.y, 0.0)
        self._frame.wxyz = (math.cos(pose.yaw / 2), 0.0, 0.0, math.sin(pose.yaw / 2))
        if self._line is not None:
            self._line.remove()
            self._line = None
        if len(person.trail) > 1:
            width = 4 if person.followed else 2
            self._line = add_line(
                self._scene, f"{self._name}_track", person.trail, self._colour, 0.05, width
            )
            self._line.visible = tracks

    def show(self, visible: bool, tracks: bool) -> None:
        self._frame.visible = visible
        if self._line is not None:
            self._line.visible = tracks

    def remove(self) -> None:
        for handle in (self._line, self._frame):
            if handle is not None:
                handle.remove()


def mark_people(
    places: Sequence[F64], face: F64, row: int = -1, *, kept: int = 4000
) -> tuple[MapPerson, ...]:
    """People as a map marks them.

    Args:
        places: [P, 2] m each, where everybody was from the start until now.
        face: unit vectors of their headings now [P, 2].
        row: of whom the agent is to follow; −1 nobody.
        kept: points of a track at most, the latest.
    """
    tracks = np.asarray(places, np.float64)[-kept:]
    return tuple(
        MapPerson(
            Pose2D(
                float(tracks[-1, k, 0]), float(tracks[-1, k, 1]), math.atan2(face[k, 1], face[k, 0])
            ),
            k == row,
            _without_rests(tracks[:, k]),
        )
        for k in range(tracks.shape[1])
    )


def _without_rests(track: F64) -> F64:
    """A track [N, 2] without the points at which nobody moved."""
    moved = np.ones(len(track), np.bool_)
    moved[1:] = (track[1:] != track[:-1]).any(axis=1)
    return track[moved]


def frame_person(picture: U8, box: tuple[int, int, int, int] | None) -> None:
    """Draw a frame round left, top, right, bottom [px] into a picture [H, W, 3]; None: nobody."""
    if box is None:
        return
    height, width = picture.shape[:2]
    left, top = max(box[0] - 3, 0), max(box[1] - 3, 0)
    right, bottom = min(box[2] + 3, width), min(box[3] + 3, height)
    for line in (
        np.s_[top : top + 2, left:right],
        np.s_[max(bottom - 2, 0) : bottom, left:right],
        np.s_[top:bottom, left : left + 2],
        np.s_[top:bottom, max(right - 2, 0) : right],
    ):
        picture[line] = FOLLOWED


def wear_colours(identity: str) -> tuple[Colour, Colour, Colour]:
    """Colours of somebody's top, bottom and skin, grey where the record is not at hand."""
    from gn0.avatars.colour_names import PROTOTYPES  # not needed for scenes without people
    from gn0.avatars.skin_paint import TONES
    from gn0.people.identities import find_identity

    try:
        who = find_identity(identity)
    except Gn0Error:
        return (140, 140, 146), (96, 98, 104), _SKIN
    top, bottom = (_colour_of(PROTOTYPES[n][0]) for n in (who.top_colour, who.bottom_colour))
    return top, bottom, _colour_of(TONES[who.tone])


def _colour_of(code: str) -> Colour:
    """A colour of its code "#rrggbb"."""
    digits = code.lstrip("#")
    return int(digits[:2], 16), int(digits[2:4], 16), int(digits[4:6], 16)


def lathe(profile: Sequence[tuple[float, float]]) -> tuple[F64, NDArray[np.int64]]:
    """Vertices and faces of a body turned round the z axis; `profile` is (radius, z) [m]."""
    turn = 2 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    vertices = np.concatenate(
        [np.column_stack([radius * ring, np.full(_SIDES, z)]) for radius, z in profile]
    )
    faces = []
    for level in range(len(profile) - 1):
        for k in range(_SIDES):
            a, b = level * _SIDES + k, level * _SIDES + (k + 1) % _SIDES
            faces += [(a, b, b + _SIDES), (a, b + _SIDES, a + _SIDES)]
    return vertices, np.array(faces)


def _ball(radius: float, height: float) -> tuple[F64, NDArray[np.int64]]:
    angles = np.linspace(-np.pi / 2, np.pi / 2, 9)
    return lathe([(radius * math.cos(a), height + radius * math.sin(a)) for a in angles])


def _wedge(height: float) -> tuple[F64, NDArray[np.int64]]:
    """A small pyramid that points ahead at eye height [m]."""
    corners = ((0.10, 0.05, 0.0), (0.10, -0.05, 0.0), (0.11, 0.0, 0.06), (0.24, 0.0, 0.0))
    vertices = np.array([(x, y, height + z) for x, y, z in corners])
    return vertices, np.array([(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)])
