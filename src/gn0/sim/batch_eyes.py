"""Pictures of many agents: what they need of one scene goes to its renderer as one batch."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64, U8, Pose2D
from gn0.missions.episode import AgentSpec, Episode
from gn0.people.crowd import CrowdState
from gn0.sim.history import History
from gn0.sim.mapping import Mapper
from gn0.sim.motion import STILL, Moment
from gn0.sim.people import Company
from gn0.sim.sensor.sensor import MAP_SIDE
from gn0.sim.sensors import SensorConfig
from gn0.sim.simulator import goal_record, goal_view
from gn0.sim.standpoint import Standpoint
from gn0.sim.state import OBSERVED

if TYPE_CHECKING:
    from gn0.sim.people_eyes import PeopleEyes, Wanted
    from gn0.sim.sensors import SensorSuite

CLOUDS_AT_ONCE = 100  # posed clouds of a call of the renderer; all of them fit in a PosedBank


@dataclass(eq=False)
class Kept:
    """What an agent keeps through one episode: made when first drawn, left to its last snapshot."""

    mapper: Mapper | None = None
    goal_picture: NDArray[np.uint8] | None = None
    company: Company | None = None


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Where agents stood at one moment, so that their pictures can be drawn a little later.

    Attributes:
        agents: int64 [K] their numbers.
        scenes: [K] ids of their scenes.
        poses: [K, 3] x, y [m], yaw [rad].
        episodes: [K] that they play.
        steps: [K] that they have taken.
        kept: [K] what an agent has kept of its episode.
        due: [K] whether the agent's own map lacks what it sees now.
        views: [K] tiles of earlier views, where a sensor looks at them.
        people: [K] what the people around it do; None where there is nobody.
    """

    agents: NDArray[np.int64]
    scenes: list[str]
    poses: F64
    episodes: list[Episode]
    steps: list[int]
    kept: list[Kept]
    due: NDArray[np.bool_]
    views: list[tuple[U8, ...]]
    people: list[CrowdState | None]


Place = tuple[str, bytes]  # a scene, and a pose with the keys of the moment there and of people
OpenPeople = Callable[[str, "SensorSuite"], "PeopleEyes"]
Seen = dict[str, NDArray[Any]]  # a picture by output


class BatchEyes:
    """The picture sensors of N agents.

    Args:
        count: N.
        config: which sensors, and their cameras.
        open_suite: scene id → the sensors of an agent in that scene, renderer included.
        scenes_kept: scenes held while nobody is in them.
        agent: the body they have.
        open_people: scene id and sensors there → what shows people; needed where episodes have
            some.

    Attributes:
        reuses: what all agents see now is given in the same arrays each time.
    """

    def __init__(
        self,
        count: int,
        config: SensorConfig,
        open_suite: Callable[[str], SensorSuite],
        scenes_kept: int,
        agent: AgentSpec,
        open_people: OpenPeople | None = None,
    ) -> None:
        self.config = config
        self._open_people = open_people
        self._people: dict[str, PeopleEyes] = {}
        self._agent = agent
        carried = config.carried
        self._sensors = tuple(sensor for sensor in carried.sensors if sensor.many is None)
        self._explores = config.explores
        self._coloured = "rgb" in carried.explored
        self._outputs = carried.drawn(self._explores)
        self._goals = carried.goal_view
        self._scaled = bool(carried.maps)
        self._kept = [Kept() for _ in range(count)]
        self._due = np.ones(count, np.bool_)
        self.open_suite = open_suite
        self._scenes_kept = scenes_kept
        self._suites: OrderedDict[str, SensorSuite] = OrderedDict()
        self._histories = [
            History(size=config.preset.history_tile) for _ in range(count if carried.views else 0)
        ]
        self._place: list[Place | None] = [None] * count  # of the pictures below
        self._seen: Seen = {}  # of all agents
        self._spaces = {s.name: s.find_space(config) for s in self._sensors}
        self._lists = frozenset(n for n, s in self._spaces.items() if MAP_SIDE in s.shape)
        self._count = count
        self.reuses = False
        self._arrays: dict[str, NDArray[Any]] = {}

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
        episodes: list[Episode],
        steps: list[int],
        people: list[CrowdState | None],
    ) -> Snapshot:
        """Where agents `which` stand now, with what they have kept of their episodes."""
        due = self._due[which]
        self._due[which] = False
        agents = which.tolist()
        views = [self._histories[i].tiles for i in agents] if self._histories else []
        kept = [self._kept[i] for i in agents]
        return Snapshot(which, scenes, poses, episodes, steps, kept, due, views, people)

    def draw(self, snapshots: Sequence[Snapshot]) -> list[dict[str, Any]]:
        """What sensors read at each snapshot, an array [K, …] each; of maps a list of pictures.

        A scene's renderer is called once for all of them (twice where colour and depth have
        cameras of their own). Who has not moved is not drawn again. The last snapshot that names
        an agent is where it stands now.
        """
        self._load({name for snapshot in snapshots for name in snapshot.scenes})
        seen, latest = self._draw_eyes(snapshots)
        found = [
            self._read(snapshot, pictures, self.reuses and snapshot is snapshots[-1])
            for snapshot, pictures in zip(snapshots, seen, strict=True)
        ]
        for agent, (place, drawn) in latest.items():  # only now: snapshots used what was kept
            for name, now in self._seen.items():
                now[agent] = drawn[name]
            self._place[agent] = place
        return found

    def _load(self, names: set[str]) -> None:
        for name in sorted(names):
            if name not in self._suites:
                idle = [other for other in self._suites if other not in names]
                while len(idle) > self._scenes_kept:  # let go before loading, not after
                    self._people.pop(idle[0], None)
                    del self._suites[idle.pop(0)]
                self._suites[name] = self.open_suite(name)
            self._suites.move_to_end(name)

    def _draw_eyes(
        self, snapshots: Sequence[Snapshot]
    ) -> tuple[list[list[Seen]], dict[int, tuple[Place, Seen]]]:
        """What lies before the eyes of each snapshot's agents, and what is new of it by agent."""
        if not self._outputs and not self._goals:
            return [[{}] * len(snapshot.agents) for snapshot in snapshots], {}
        requests: list[list[tuple[int, Place]]] = []
        moments: dict[Place, Moment] = {}
        crowds: dict[Place, Wanted] = {}
        for snapshot in snapshots:
            rows: list[tuple[int, Place]] = []
            for k, (agent, scene, pose) in enumerate(
                zip(snapshot.agents.tolist(), snapshot.scenes, snapshot.poses, strict=True)
            ):
                suite, about = self._suites[scene], pose.tobytes()
                moment = STILL
                if suite.motion is not None:
                    moment = suite.moment_at(self._agent.time_after(snapshot.steps[k]))
                    about += moment.key
                company = self._meet(snapshot, k)
                if company is not None and self._outputs:
                    crowd = self._eyes_for_people(scene).want(
                        *(company, Pose2D(*pose.tolist()), self.config.preset.rgb.fx, suite.sight)
                    )
                    about += crowd.key
                    crowds[scene, about] = crowd
                if suite.motion is not None:
                    moments[scene, about] = moment
                rows.append((agent, (scene, about)))
            requests.append(rows)
        missing = dict.fromkeys(
            place for rows in requests for agent, place in rows if self._place[agent] != place
        )
        goals = self._find_goals(snapshots) if self._goals else []
        missing |= dict.fromkeys(place for _, place in goals)
        drawn: dict[Place, Seen] = {}
        for scene in sorted({scene for scene, _ in missing}):
            places = [place for place in missing if place[0] == scene]
            outputs = self._outputs | {"rgb"} if goals else self._outputs
            for group in _split_crowds(places, crowds):
                poses = [Pose2D(*np.frombuffer(raw[:24], np.float64).tolist()) for _, raw in group]
                then = self._show_people(scene, group, moments, crowds)
                pictures = self._suites[scene].look_many(poses, outputs, then)
                for k, place in enumerate(group):
                    drawn[place] = {name: pixels[k] for name, pixels in pictures.items()}
        for kept, place in goals:
            kept.goal_picture = np.array(drawn[place]["rgb"])
        self._allocate(next(iter(drawn.values()), {}))
        latest: dict[int, tuple[Place, Seen]] = {}
        seen: list[list[Seen]] = []
        for rows in requests:
            seen.append([])
            for agent, place in rows:
                fresh = self._place[agent] != place
                if fresh:
                    latest[agent] = place, drawn[place]
                else:
                    latest.pop(agent, None)
                now = {name: pixels[agent] for name, pixels in self._seen.items()}
                seen[-1].append(drawn[place] if fresh else now)
        return seen, latest

    def _show_people(
        self,
        scene: str,
        places: Sequence[Place],
        moments: Mapping[Place, Moment],
        crowds: Mapping[Place, Wanted],
    ) -> list[Moment]:
        """Whatever moves at places of one scene, people among it."""
        then = [moments.get(place, STILL) for place in places]
        here = [k for k, place in enumerate(places) if place in crowds]
        if here:
            shown = self._eyes_for_people(scene).show_many([crowds[places[k]] for k in here])
            for k, parts in zip(here, shown, strict=True):
                then[k] = Moment(then[k].time, (*then[k].parts, *parts), crowds[places[k]].key)
        return then

    def _eyes_for_people(self, scene: str) -> PeopleEyes:
        if scene not in self._people:
            assert self._open_people is not None, "episodes with people need open_people"
            self._people[scene] = self._open_people(scene, self._suites[scene])
        return self._people[scene]

    def _meet(self, snapshot: Snapshot, k: int) -> Company | None:
        """The people around agent k of a snapshot as they were then; None of nobody."""
        state, kept = snapshot.people[k], snapshot.kept[k]
        if state is None:
            return None
        if kept.company is None:
            navigation = self._suites[snapshot.scenes[k]].navigation
            kept.company = Company(navigation, self._agent)
        kept.company.restore(snapshot.episodes[k], state)
        return kept.company

    def _find_goals(self, snapshots: Sequence[Snapshot]) -> list[tuple[Kept, Place]]:
        """Goal pictures that are still to be drawn, with the agents' other pictures."""
        goals = []
        for snapshot in snapshots:
            for kept, scene, episode in zip(
                snapshot.kept, snapshot.scenes, snapshot.episodes, strict=True
            ):
                if kept.goal_picture is not None:
                    continue
                record, goal = goal_record(episode), goal_view(episode)
                if record is not None:
                    kept.goal_picture = self._suites[scene].look_at_goal(record, goal)
                else:
                    goals.append((kept, (scene, np.array(goal).tobytes())))
        return goals

    def _allocate(self, sample: Seen) -> None:
        """Keep a picture an agent, of the size and kind of those that were drawn."""
        if not self._seen and sample:
            self._seen = {
                name: np.empty((self._count, *sample[name].shape), sample[name].dtype)
                for name in sorted(self._outputs)
            }

    def _read(self, snapshot: Snapshot, seen: list[Seen], reuse: bool) -> dict[str, Any]:
        """What each sensor reads at a snapshot; into the arrays of the last time with `reuse`."""
        places = [self._stand(snapshot, k, pictures) for k, pictures in enumerate(seen)]
        found: dict[str, Any] = {}
        for sensor in self._sensors:
            if sensor.name in OBSERVED:
                values = [sensor.read(place) for place in places]
            else:
                space = self._spaces[sensor.name]
                values = [sensor.measure(place, space) for place in places]
            if sensor.array is None and sensor.name not in self._lists:
                kept = self._arrays.get(sensor.name) if reuse else None
                found[sensor.name] = np.stack(values, out=kept)
                if reuse:
                    self._arrays[sensor.name] = found[sensor.name]
            else:
                found[sensor.name] = values
        if self._scaled:
            frames = [self._suites[scene].map_frame for scene in snapshot.scenes]
            found["bev_metres_per_pixel"] = [frame.metres_per_pixel for frame in frames]
            found["map_origin"] = [(frame.x_min, frame.y_min) for frame in frames]
        return found

    def _stand(self, snapshot: Snapshot, k: int, seen: Seen) -> Standpoint:
        """Where agent k of a snapshot stands; its own map is brought up to date."""
        suite, kept = self._suites[snapshot.scenes[k]], snapshot.kept[k]
        place = Standpoint(
            suite,
            seen.__getitem__,
            lambda: snapshot.views[k],
            lambda: kept.goal_picture,  # type: ignore[arg-type, return-value]
            lambda: self._tell_who(snapshot, k),
        )
        place.pose = pose = Pose2D(*snapshot.poses[k].tolist())
        place.company = self._meet(snapshot, k)
        place.episode, place.steps = snapshot.episodes[k], snapshot.steps[k]
        place.time = self._agent.time_after(place.steps)
        if self._explores:
            if kept.mapper is None:
                kept.mapper = Mapper(
                    *(suite.grid, self.config.preset, self._agent, self.config.cut_height),
                    coloured=self._coloured,
                )
            if snapshot.due[k]:
                moves = suite.motion is not None or snapshot.people[k] is not None
                time = place.time if moves else None
                kept.mapper.update(pose, seen["depth"], seen.get("rgb"), time)
            place.mapper = kept.mapper
        return place

    def _tell_who(self, snapshot: Snapshot, k: int) -> tuple[U8, F32]:
        """Which person each pixel of an agent's picture shows, and how much is seen of each."""
        from gn0.sim.people_eyes import read_who  # bodies are needed only for pictures

        scene, company = snapshot.scenes[k], self._meet(snapshot, k)
        suite, pose = self._suites[scene], Pose2D(*snapshot.poses[k].tolist())
        if company is None:
            return read_who(suite, pose, (), ())
        moment = suite.moment_at(self._agent.time_after(snapshot.steps[k]))
        return self._eyes_for_people(scene).tell_who(suite, company, pose, moment)


def _split_crowds(
    places: Sequence[Place], crowds: Mapping[Place, Wanted]
) -> Iterator[Sequence[Place]]:
    """Places that are drawn in one call each: no more posed clouds than are surely kept."""
    group: list[Place] = []
    clouds: set[Hashable] = set()
    for place in places:
        more = {key for key, _ in crowds[place].clouds} if place in crowds else set()
        if group and len(clouds | more) > CLOUDS_AT_ONCE:
            yield group
            group, clouds = [], set()
        group.append(place)
        clouds |= more
    if group:
        yield group
