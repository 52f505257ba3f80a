"""Pictures of many agents: what they need of one scene goes to its renderer as one batch."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64, Pose2D
from gn0.missions.episode import AgentSpec, GoalPicture
from gn0.sim.history import History
from gn0.sim.mapping import Mapper
from gn0.sim.motion import STILL, Moment
from gn0.sim.sensors import EYES, MAPS, SensorConfig, outputs_of

if TYPE_CHECKING:
    from gn0.sim.sensors import SensorSuite


@dataclass(eq=False)
class Kept:
    """What an agent keeps through one episode: made when first drawn, left to its last snapshot."""

    mapper: Mapper | None = None
    goal_picture: NDArray[np.uint8] | None = None


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Where agents stood at one moment, so that their pictures can be drawn a little later.

    Attributes:
        agents: int64 [K] their numbers.
        scenes: [K] ids of their scenes.
        poses: [K, 3] x, y [m], yaw [rad].
        starts: [K, 3] the same at their episodes' start.
        goals: [K, 3] the same where their goal pictures are taken, if no record says otherwise.
        records: [K] how they are taken, where the episode says.
        kept: [K] what an agent has kept of its episode.
        due: [K] whether the agent's own map lacks what it sees now.
        mosaics: [K] history mosaics, when they carry that sensor.
        times: [K] since their episodes began [s].
    """

    agents: NDArray[np.int64]
    scenes: list[str]
    poses: F64
    starts: F64
    goals: F64
    records: list[GoalPicture | None]
    kept: list[Kept]
    due: NDArray[np.bool_]
    mosaics: list[NDArray[np.uint8]]
    times: F64


Place = tuple[str, bytes]  # a scene, and a pose with the key of the moment there


class BatchEyes:
    """The picture sensors of N agents.

    Args:
        count: N.
        config: which sensors, and their cameras.
        open_suite: scene id → the sensors of an agent in that scene, renderer included.
        scenes_kept: scenes held while nobody is in them.
        agent: the body they have.
    """

    def __init__(
        self,
        count: int,
        config: SensorConfig,
        open_suite: Callable[[str], SensorSuite],
        scenes_kept: int,
        agent: AgentSpec,
    ) -> None:
        self.config = config
        self._agent = agent
        self._wanted = frozenset(config.active)
        self._explores = config.explores and bool(self._wanted & MAPS)
        self._drawn: frozenset[str] = self._wanted
        if self._explores:  # an agent's own map is made from depth, its colours from rgb
            self._drawn |= {"depth", "rgb"} if "bev" in self._wanted else {"depth"}
        self._kept = [Kept() for _ in range(count)]
        self._due = np.ones(count, np.bool_)
        self._spared = {"rgb", "depth"} - self._wanted  # drawn for others' sake
        self.open_suite = open_suite
        self._scenes_kept = scenes_kept
        self._suites: OrderedDict[str, SensorSuite] = OrderedDict()
        self._histories = [History() for _ in range(count)] if "history" in self._wanted else []
        self._place: list[Place | None] = [None] * count  # of the pictures below
        self._outputs = outputs_of(self._drawn)
        self._seen: dict[str, NDArray[Any]] = {}  # by output, of all agents
        self._count = count

    def begin(self, which: NDArray[np.int64]) -> None:
        """Agents `which` begin an episode: nothing has been seen."""
        self._due[which] = True
        for i in which.tolist():
            self._kept[i] = Kept()
        if self._histories:
            for i in which.tolist():
                self._histories[i].clear()

    def keep_views(self) -> None:
        """All agents are about to act: what each sees goes into its history."""
        self._due[:] = True
        if self._histories:
            for history, rgb in zip(self._histories, self._seen["rgb"], strict=True):
                history.add(rgb)

    def snapshot(
        self,
        which: NDArray[np.int64],
        scenes: list[str],
        poses: F64,
        starts: F64,
        goals: F64,
        records: list[GoalPicture | None],
        times: F64,
    ) -> Snapshot:
        """Where agents `which` stand now, with what they have kept of their episodes."""
        due = self._due[which]
        self._due[which] = False
        agents = which.tolist()
        mosaics = [self._histories[i].mosaic() for i in agents] if self._histories else []
        kept = [self._kept[i] for i in agents]
        return Snapshot(which, scenes, poses, starts, goals, records, kept, due, mosaics, times)

    def draw(self, snapshots: Sequence[Snapshot]) -> list[dict[str, Any]]:
        """The pictures of each snapshot, an array [K, …] a sensor.

        A scene's renderer is called once for all of them (twice where colour and depth have
        cameras of their own). Who has not moved is not drawn again. The last snapshot that names
        an agent is where it stands now.
        """
        self._load({name for snapshot in snapshots for name in snapshot.scenes})
        found: list[dict[str, Any]] = [{} for _ in snapshots]
        if self._drawn & EYES:
            self._draw_eyes(snapshots, found)
        for snapshot, pictures in zip(snapshots, found, strict=True):
            if self._histories:
                pictures["history"] = np.array(snapshot.mosaics, np.uint8)
            if self._wanted & MAPS:
                self._draw_maps(snapshot, pictures)
        return [{name: p[name] for name in p if name not in self._spared} for p in found]

    def _load(self, names: set[str]) -> None:
        for name in sorted(names):
            if name not in self._suites:
                idle = [other for other in self._suites if other not in names]
                while len(idle) > self._scenes_kept:  # let go before loading, not after
                    del self._suites[idle.pop(0)]
                self._suites[name] = self.open_suite(name)
            self._suites.move_to_end(name)

    def _draw_eyes(self, snapshots: Sequence[Snapshot], found: list[dict[str, Any]]) -> None:
        """Colour and depth."""
        requests: list[tuple[int, int, int, Place]] = []
        moments: dict[Place, Moment] = {}
        for s, snapshot in enumerate(snapshots):
            rows = zip(
                snapshot.agents.tolist(),
                snapshot.scenes,
                snapshot.poses,
                snapshot.times.tolist(),
                strict=True,
            )
            for k, (agent, scene, pose, time) in enumerate(rows):
                suite, place = self._suites[scene], (scene, pose.tobytes())
                if suite.motion is not None:
                    moment = suite.moment_at(time)
                    place = (scene, pose.tobytes() + moment.key)
                    moments[place] = moment
                requests.append((s, k, agent, place))
        missing = dict.fromkeys(
            place for _, _, agent, place in requests if self._place[agent] != place
        )
        goals: list[tuple[Kept, Place]] = []
        if "goal_picture" in self._wanted:
            for snapshot in snapshots:
                for kept, scene, goal, record in zip(
                    snapshot.kept, snapshot.scenes, snapshot.goals, snapshot.records, strict=True
                ):
                    if kept.goal_picture is None and record is not None:
                        where = Pose2D(*goal.tolist())
                        kept.goal_picture = self._suites[scene].look_at_goal(record, where)
                    elif kept.goal_picture is None:
                        goals.append((kept, (scene, goal.tobytes())))
            missing |= dict.fromkeys(place for _, place in goals)
        drawn: dict[Place, dict[str, NDArray[Any]]] = {}
        for scene in sorted({scene for scene, _ in missing}):
            places = [place for place in missing if place[0] == scene]
            poses = [Pose2D(*np.frombuffer(raw[:24], np.float64).tolist()) for _, raw in places]
            outputs = self._outputs | {"rgb"} if goals else self._outputs
            then = [moments.get(place, STILL) for place in places]
            seen = self._suites[scene].look_many(poses, outputs, then)
            for k, place in enumerate(places):
                drawn[place] = {name: pixels[k] for name, pixels in seen.items()}
        for kept, place in goals:
            kept.goal_picture = np.array(drawn[place]["rgb"])
        self._allocate(next(iter(drawn.values()), {}))
        for snapshot, pictures in zip(snapshots, found, strict=True):
            for name, now in self._seen.items():
                pictures[name] = np.empty((len(snapshot.agents), *now.shape[1:]), now.dtype)
            if "goal_picture" in self._wanted:
                pictures["goal_picture"] = np.array([k.goal_picture for k in snapshot.kept])
        for s, k, agent, place in requests:
            known = self._place[agent] == place
            for name, now in self._seen.items():
                found[s][name][k] = now[agent] if known else drawn[place][name]
        latest = {agent: place for _, _, agent, place in requests}
        for agent, place in latest.items():  # only now: snapshots used what was kept
            if self._place[agent] != place:
                for name, now in self._seen.items():
                    now[agent] = drawn[place][name]
                self._place[agent] = place

    def _allocate(self, sample: dict[str, NDArray[Any]]) -> None:
        """Keep a picture an agent, of the size and kind of those that were drawn."""
        if not self._seen and sample:
            self._seen = {
                name: np.empty((self._count, *sample[name].shape), sample[name].dtype)
                for name in sorted(self._outputs, reverse=True)
            }

    def _draw_maps(self, snapshot: Snapshot, pictures: dict[str, Any]) -> None:
        """Map pictures, each of its scene's own size."""
        found = []
        for k, scene in enumerate(snapshot.scenes):
            suite, kept = self._suites[scene], snapshot.kept[k]
            pose = Pose2D(*snapshot.poses[k].tolist())
            if self._explores:
                if kept.mapper is None:
                    kept.mapper = Mapper(
                        *(suite.grid, self.config.preset, self._agent, self.config.cut_height),
                        coloured="bev" in self._wanted,
                    )
                if snapshot.due[k]:
                    rgb = pictures["rgb"][k] if "rgb" in pictures else None
                    kept.mapper.update(pose, pictures["depth"][k], rgb)
            start = Pose2D(*snapshot.starts[k].tolist())
            maps = self._wanted & MAPS
            found.append(suite.read_static(pose, start, (0.0, 0.0), maps, kept.mapper))
        for name in (*(self._wanted & MAPS), "bev_metres_per_pixel"):
            pictures[name] = [fields[name] for fields in found]
