"""What an exporter gets: walked episodes, with poses, moves, labels and pictures.

A trip is plain values. Where it comes from is `gn0.export.dataset_source`'s business; tests and
plug-ins make their own.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.data.sample_table import EpisodeRows
from gn0.errors import EpisodeError
from gn0.geometry import F32, F64, U8
from gn0.maps.grid import OccupancyGrid
from gn0.missions.episode import STEP_SECONDS, Episode, MissionFollow
from gn0.paper import FORWARD, LEFT, RIGHT, STOP
from gn0.progress import Progress
from gn0.sim.presets import CameraPreset
from gn0.sim.sensors import MapFrame
from gn0.storage import content_hash

Sensors = tuple[Literal["rgb", "depth"], ...]
RGB: Sensors = ("rgb",)
RGBD: Sensors = ("rgb", "depth")


class Frame(NamedTuple):
    """What was seen at a pose: rgb [H, W, 3], depth [Hd, Wd] m; None where not asked for."""

    rgb: U8 | None
    depth: F32 | None


class MapView(NamedTuple):
    """The maps that an agent is shown: their frame, BEV [H, W, 3], bare occupancy [H, W, 3]."""

    frame: MapFrame
    bev: U8
    bare: U8


@dataclass(frozen=True, eq=False)
class Trip:
    """An episode and how it was walked.

    Attributes:
        episode: the task.
        poses: [N+1, 3] x, y [m], yaw [rad], world frame: before each move, and where it ended.
        moves: [N] 1 FORWARD, 2 LEFT, 3 RIGHT; the STOP at the end is not among them. Where somebody
            is followed, 0 is among them: it stands still for one action.
        ahead: [N+1, K] what should be done next at each pose, filled up with STOP.
        stopped: whether it ended with STOP; who follows somebody never does.
        source: "expert"; "dagger" for a walk of a policy with the expert's labels; "demonstration"
            for one with its own.
        rows: its samples, a row a pose: waypoints, map tokens, distances; None where unknown.
    """

    episode: Episode
    poses: F64
    moves: NDArray[np.int8]
    ahead: NDArray[np.int8]
    stopped: bool = True
    source: str = "expert"
    rows: EpisodeRows | None = None

    def __post_init__(self) -> None:
        n = len(self.moves)
        where = f"episode {self.episode.id!r}"
        if self.poses.shape != (n + 1, 3) or len(self.ahead) != n + 1 or self.ahead.ndim != 2:
            raise EpisodeError(
                f"{n} moves with poses {list(self.poses.shape)} and labels "
                f"{list(self.ahead.shape)}",
                where=where,
                remedy="a pose and labels before each move, and at the end",
            )
        waits = (STOP,) if self.follows else ()
        if not np.isin(self.moves, (*waits, FORWARD, LEFT, RIGHT)).all():
            raise EpisodeError("a move is not 1, 2 or 3", where=where, remedy="cut STOP off")
        if not np.isfinite(self.poses).all():
            raise EpisodeError("a pose is not finite", where=where, remedy="build it again")

    @property
    def frames(self) -> int:
        """Pictures of a trip: one a pose."""
        return len(self.poses)

    @property
    def way(self) -> str:
        """Digest of all that its pictures depend on, so that missions can share them."""
        episode = self.episode
        people = (repr(episode.people),) if episode.people else ()
        return content_hash(episode.scene_id, repr(episode.light), self.poses, *people)

    @property
    def follows(self) -> bool:
        """Whether the mission is to follow somebody."""
        return isinstance(self.episode.mission, MissionFollow)

    @property
    def actions(self) -> list[int]:
        """The moves, and the STOP if there was one."""
        return [*map(int, self.moves), *([STOP] if self.stopped else [])]

    @property
    def answers(self) -> list[int]:
        """What is done at each pose, the last included: STOP there, unless somebody is followed."""
        return [*map(int, self.moves), int(self.ahead[-1, 0]) if self.follows else STOP]


class Eyes(Protocol):
    """Makes pictures of trips."""

    def frames(self, trip: Trip, sensors: Sensors) -> Iterator[Frame]:
        """The pictures at the trip's own poses, through the dataset's own camera."""
        ...

    def look(
        self, trip: Trip, poses: F64, preset: CameraPreset, sensors: Sensors
    ) -> Iterator[Frame]:
        """Pictures at other poses [K, 3] of the trip's scene, or through another camera."""
        ...

    def maps(self, trip: Trip) -> MapView:
        """The maps of the trip's scene, in its light."""
        ...

    def goal(self, trip: Trip) -> U8 | None:
        """What its goal looks like [H, W, 3], through the dataset's camera; None without one."""
        ...


@dataclass(frozen=True, eq=False)
class EyesTold:
    """Eyes that tell of each picture they make; a trip of many pictures is not silent.

    Attributes:
        eyes: that make them.
        progress: progress sink; how many pictures there will be is not known.
    """

    eyes: Eyes
    progress: Progress
    _count: Iterator[int] = field(default_factory=lambda: itertools.count(1))

    def frames(self, trip: Trip, sensors: Sensors) -> Iterator[Frame]:
        """See `Eyes.frames`."""
        return self._told(self.eyes.frames(trip, sensors))

    def look(
        self, trip: Trip, poses: F64, preset: CameraPreset, sensors: Sensors
    ) -> Iterator[Frame]:
        """See `Eyes.look`."""
        return self._told(self.eyes.look(trip, poses, preset, sensors))

    def maps(self, trip: Trip) -> MapView:
        """See `Eyes.maps`."""
        return self.eyes.maps(trip)

    def goal(self, trip: Trip) -> U8 | None:
        """See `Eyes.goal`."""
        return self.eyes.goal(trip)

    def _told(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        for frame in frames:
            self.progress("pictures", next(self._count), 0)
            yield frame


class SceneCard(NamedTuple):
    """What a reader should know of a scene: id, source, licence, content hash."""

    id: str
    source: str
    licence: str
    hash: str


@dataclass(frozen=True, eq=False)
class ExportSource:
    """A dataset as exporters see it.

    Attributes:
        name: what people call it.
        digest: digest of everything an export depends on; another digest is another export.
        preset: camera of the dataset's own pictures.
        scenes: what is known of each scene, by id.
        trips: gives every trip, always in the same order.
        grid: the map of a scene.
        eyes: makes pictures.
        depth: whether the dataset stores depth.
        step_seconds: what an action took in its walks [s].
    """

    name: str
    digest: str
    preset: CameraPreset
    scenes: dict[str, SceneCard]
    trips: Callable[[], Iterable[Trip]]
    grid: Callable[[str], OccupancyGrid]
    eyes: Eyes
    depth: bool = False
    step_seconds: float = STEP_SECONDS

    def frames(self, trip: Trip, preset: CameraPreset, sensors: Sensors) -> Iterator[Frame]:
        """The pictures at a trip's poses through a camera, the dataset's own where it is that."""
        if preset == self.preset:
            return self.eyes.frames(trip, sensors)
        return self.eyes.look(trip, trip.poses, preset, sensors)


@dataclass(frozen=True)
class Recovered:
    """A trip as an export holds it; None where the format does not hold it.

    Attributes:
        id: the episode's id, where the format keeps it, else its number in the export.
        scene: scene id.
        instruction: the text.
        frames: number of pictures; 0 for a format without.
        moves: actions without STOP.
        poses: [K, 3] of the pictures.
        start, goal, path: [1, 3], [1, 3] and [M, 3] as poses in the world frame; yaw 0 where there
            is none.
        labels: the answers, one a sample, as (pose number, next actions or amounts).
        picture: reads the frame of a pose.
    """

    id: str
    scene: str
    instruction: str
    frames: int = 0
    moves: tuple[int, ...] | None = None
    poses: F64 | None = None
    start: F64 | None = None
    goal: F64 | None = None
    path: F64 | None = None
    labels: tuple[tuple[int, str], ...] | None = None
    picture: Callable[[int], Frame] | None = None

    def named(self, name: str) -> Recovered:
        """The same under another id."""
        return replace(self, id=name)


def differing_fields(trip: Trip, found: Recovered, kept: F64, tolerance: float = 1e-5) -> list[str]:
    """Names of the fields in which a trip that was read back differs from the one written.

    Args:
        trip: what was written.
        found: what was read; what its format does not hold is not compared.
        kept: the poses [K, 3] whose pictures the export holds.
        tolerance: tolerance of positions [m] and angles [rad].
    """
    episode = trip.episode
    pairs = {
        "id": (found.id, episode.id),
        "scene": (found.scene, episode.scene_id),
        "instruction": (found.instruction, episode.instruction),
        "frames": (found.frames or len(kept), len(kept)),
        "moves": (trip.moves.tolist() if found.moves is None else [*found.moves],
                  trip.moves.tolist()),
    }  # fmt: skip
    wrong = [name for name, (a, b) in pairs.items() if a != b]
    far = {
        "poses": (found.poses, kept),
        "start": (found.start, np.array([episode.start])),
        "goal": (found.goal, np.array([[*episode.goal, 0.0]])),
        "path": (found.path, np.array([[x, y, 0.0] for x, y in episode.path]).reshape(-1, 3)),
    }
    for name, (values, wanted) in far.items():
        if values is not None and _apart(values, wanted) > tolerance:
            wrong.append(name)
    return wrong


def _apart(a: F64, b: F64) -> float:
    """How far poses [N, 3] lie apart: the greatest difference [m or rad]."""
    if a.shape != b.shape:
        return float("inf")
    turn = np.abs(np.angle(np.exp(1j * (a[:, 2] - b[:, 2]))))
    return float(max(np.abs(a[:, :2] - b[:, :2]).max(initial=0.0), turn.max(initial=0.0)))
