"""Pictures of many agents: what they need of one scene goes to its renderer as one batch."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64, Pose2D
from gn0.sim.history import History
from gn0.sim.sensors import EYES, SensorConfig

if TYPE_CHECKING:
    from gn0.sim.sensors import SensorSuite


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Where agents stood at one moment, so that their pictures can be drawn a little later.

    Attributes:
        agents: int64 [K] their numbers.
        scenes: [K] ids of their scenes.
        poses: [K, 3] x, y [m], yaw [rad].
        starts: [K, 3] the same at their episodes' start.
        mosaics: [K] history mosaics, when they carry that sensor.
    """

    agents: NDArray[np.int64]
    scenes: list[str]
    poses: F64
    starts: F64
    mosaics: list[NDArray[np.uint8]] = field(default_factory=list)


class BatchEyes:
    """The picture sensors of N agents.

    Args:
        count: N.
        config: which sensors, and their cameras.
        open_suite: scene id → the sensors of an agent in that scene, renderer included.
        scenes_kept: scenes held while nobody is in them.
    """

    def __init__(
        self,
        count: int,
        config: SensorConfig,
        open_suite: Callable[[str], SensorSuite],
        scenes_kept: int,
    ) -> None:
        self.config = config
        self._wanted = frozenset(config.active)
        self._open_suite = open_suite
        self._scenes_kept = scenes_kept
        self._suites: OrderedDict[str, SensorSuite] = OrderedDict()
        self._histories = [History() for _ in range(count)] if "history" in self._wanted else []
        self._place: list[tuple[str, bytes] | None] = [None] * count  # of the pictures below
        self._rgb: NDArray[np.uint8] | None = None
        self._depth: NDArray[np.float32] | None = None
        self._count = count

    def begin(self, which: NDArray[np.int64]) -> None:
        """Agents `which` begin an episode: nothing has been seen."""
        if self._histories:
            for i in which.tolist():
                self._histories[i].clear()

    def keep_views(self) -> None:
        """All agents are about to act: what each sees goes into its history."""
        if self._histories:
            assert self._rgb is not None
            for history, rgb in zip(self._histories, self._rgb, strict=True):
                history.add(rgb)

    def mosaics(self, which: NDArray[np.int64]) -> list[NDArray[np.uint8]]:
        """History mosaics of agents `which`, as they are now."""
        return [self._histories[i].mosaic() for i in which.tolist()] if self._histories else []

    def draw(self, snapshots: Sequence[Snapshot]) -> list[dict[str, Any]]:
        """The pictures of each snapshot, an array [K, …] a sensor.

        A scene's renderer is called once for all of them (twice where colour and depth have
        cameras of their own). Who has not moved is not drawn again. The last snapshot that names
        an agent is where it stands now.
        """
        self._load({name for snapshot in snapshots for name in snapshot.scenes})
        found: list[dict[str, Any]] = [{} for _ in snapshots]
        if self._wanted & EYES:
            self._draw_eyes(snapshots, found)
        for snapshot, pictures in zip(snapshots, found, strict=True):
            if self._histories:
                pictures["history"] = np.array(snapshot.mosaics, np.uint8)
            if self._wanted & {"bev", "occupancy"}:
                self._draw_maps(snapshot, pictures)
        return found

    def _load(self, names: set[str]) -> None:
        for name in sorted(names):
            if name not in self._suites:
                idle = [other for other in self._suites if other not in names]
                while len(idle) > self._scenes_kept:  # let go before loading, not after
                    del self._suites[idle.pop(0)]
                self._suites[name] = self._open_suite(name)
            self._suites.move_to_end(name)

    def _draw_eyes(self, snapshots: Sequence[Snapshot], found: list[dict[str, Any]]) -> None:
        """Colour and depth."""
        requests = [
            (s, k, agent, (scene, pose.tobytes()))
            for s, snapshot in enumerate(snapshots)
            for k, (agent, scene, pose) in enumerate(
                zip(snapshot.agents.tolist(), snapshot.scenes, snapshot.poses, strict=True)
            )
        ]
        missing = dict.fromkeys(
            place for _, _, agent, place in requests if self._place[agent] != place
        )
        drawn: dict[tuple[str, bytes], tuple[Any, Any]] = {}
        for scene in sorted({scene for scene, _ in missing}):
            places = [place for place in missing if place[0] == scene]
            poses = [Pose2D(*np.frombuffer(raw, np.float64).tolist()) for _, raw in places]
            rgb, depth = self._suites[scene].look_many(poses, self._wanted)
            for k, place in enumerate(places):
                drawn[place] = (
                    None if rgb is None else rgb[k],
                    None if depth is None else depth[k],
                )
        self._allocate()
        for snapshot, pictures in zip(snapshots, found, strict=True):
            for name, kept in (("rgb", self._rgb), ("depth", self._depth)):
                if kept is not None and name in self._wanted:
                    pictures[name] = np.empty((len(snapshot.agents), *kept.shape[1:]), kept.dtype)
        for s, k, agent, place in requests:
            known = self._place[agent] == place
            for column, (name, kept) in enumerate((("rgb", self._rgb), ("depth", self._depth))):
                if kept is None:
                    continue
                picture = kept[agent] if known else drawn[place][column]
                if name in self._wanted:
                    found[s][name][k] = picture
        latest = {agent: place for _, _, agent, place in requests}
        for agent, place in latest.items():  # only now: snapshots used what was kept
            if self._place[agent] != place:
                rgb, depth = drawn[place]
                if self._rgb is not None:
                    self._rgb[agent] = rgb
                if self._depth is not None:
                    self._depth[agent] = depth
                self._place[agent] = place

    def _allocate(self) -> None:
        preset = self.config.preset
        if self._rgb is None and self._wanted & {"rgb", "history"}:
            width, height = preset.picture_size
            self._rgb = np.empty((self._count, height, width, 3), np.uint8)
        if self._depth is None and "depth" in self._wanted:
            shape = (self._count, preset.depth.height, preset.depth.width)
            self._depth = np.empty(shape, np.float32)

    def _draw_maps(self, snapshot: Snapshot, pictures: dict[str, Any]) -> None:
        """Map pictures, each of its scene's own size."""
        suites = [self._suites[name] for name in snapshot.scenes]
        fields = [
            suite.read_static(Pose2D(*pose), Pose2D(*start), (0.0, 0.0), self._wanted & _MAPS)
            for suite, pose, start in zip(
                suites, snapshot.poses.tolist(), snapshot.starts.tolist(), strict=True
            )
        ]
        for name in self._wanted & _MAPS:
            pictures[name] = [found[name] for found in fields]
        pictures["bev_metres_per_pixel"] = [found["bev_metres_per_pixel"] for found in fields]


_MAPS = frozenset({"bev", "occupancy"})
