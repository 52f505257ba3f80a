"""DAgger behind a person: each state is labelled for where the person goes from there on.

A policy that stands in a person's way holds it up, so the person is not where a track of beforehand
has it. At each state what people do is copied and stepped on with the agent out of their way; the
follower that makes reference tracks (`gn0.data.follow_oracle`) plans its next six steps against
that, each for its own time, and never onto anybody. `label_follow` aims at the place of now alone:
on reference tracks of the trials it says the reference's own action at 29 % of the states, as it
turns its back on the person to mend 0.3 m; so labels of states and of tracks come from one tracker.

An episode ends by `gn0.missions.follow_rules`, faced being judged on the map, whatever the policy
sees: so a policy without eyes and one with them are stopped by the same rule.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from gn0.data.expert_labels import I8, window_actions
from gn0.data.follow import TargetTrack, walkable_part
from gn0.data.follow_oracle import FollowOracle
from gn0.data.follow_reference import follow_task
from gn0.data.sample_table import NO_TOKEN, EpisodeRows
from gn0.data.settings import DaggerSettings
from gn0.data.step_people import StepPeople
from gn0.data.walked_way import walked_way
from gn0.data.waypoints import find_way
from gn0.errors import PlanError
from gn0.geometry import F32, F64, Pose2D, wrap_angle
from gn0.maps.grid import OccupancyGrid
from gn0.maps.ray import is_line_free
from gn0.maps.way_kernels import spread_line
from gn0.missions.episode import TICKS_A_SECOND, Episode
from gn0.missions.follow_rules import FOLLOW, FollowCount, FollowEnd, FollowSight, count_step
from gn0.paper import ACTIONS_AHEAD, POINTS, SPACING
from gn0.people.crowd import CrowdState
from gn0.people.reach import ARRIVED, MODE
from gn0.seeds import random_stream
from gn0.sim.collision import move_agent
from gn0.sim.kinematics import Heading, step_forward
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action

FORETOLD = 12.0  # s of what people do next: as long as 3 m take behind somebody slow
AT_REST = 0.01  # m: who goes no farther stands
NEAR = 0.25  # m: a trail nearer than that is walked on, not walked to
_SAME = 1e-6  # m and rad: kernels of people round otherwise where the agent is near


@dataclass(frozen=True, eq=False)
class Foretold:
    """Where people go from a state on with the agent out of their way.

    Attributes:
        places: [N+1, P, 2] m at each tick from now on.
        track: of the person to follow: as it went until now, then as it will.
    """

    places: F64
    track: TargetTrack


@dataclass
class _Plan:
    """The follower's next steps, as far as they are thought.

    Attributes:
        poses: before each step, and after the last.
        headings: likewise.
        codes: the steps.
        memories: what the follower remembers after each of them.
        places: of people while they are done, a row a tick, as foretold.
    """

    poses: list[Pose2D]
    headings: list[Heading]
    codes: list[int] = field(default_factory=list)
    memories: list[FollowOracle] = field(default_factory=list)
    places: F64 = field(default_factory=lambda: np.zeros((0, 0, 2)))

    def drop(self, ticks: int) -> None:
        """Forget the first step, which takes so many ticks: it is being done."""
        for steps in (self.poses, self.headings, self.codes, self.memories):
            del steps[0]
        self.places = self.places[ticks:]


class FollowExpert:
    """Labels one state after the other of an agent behind a person.

    Args:
        simulator: the episode's, which has just begun; read anew at each state.
        episode: with the person.
        sight: what hides people, see `gn0.missions.generate.follow_sight`.

    Raises:
        PlanError: the mission does not say whom to follow.
    """

    def __init__(self, simulator: Simulator, episode: Episode, sight: OccupancyGrid) -> None:
        self._simulator = simulator
        self._task = follow_task(episode, sight)
        self._oracle = FollowOracle(simulator.navigation, self._task)
        assert episode.followed is not None
        self.row = episode.people.index(episode.followed)
        self._times: list[float] = []
        self._places: list[F64] = []
        self._yaws: list[float] = []
        self._plan: _Plan | None = None

    def foretell(self) -> Foretold:
        """Where everybody goes from the state of now on; called once a state."""
        simulator, row = self._simulator, self.row
        places, faces = simulator.company.foretell(round(FORETOLD * TICKS_A_SECOND))
        yaws = np.arctan2(faces[:, row, 1], faces[:, row, 0])
        times = simulator.time + np.arange(len(places)) / TICKS_A_SECOND
        track = TargetTrack(
            np.r_[self._times, times],
            np.vstack([*self._places, places[:, row]]),
            np.r_[self._yaws, yaws],
        )
        self._times.append(float(times[0]))
        self._places.append(places[0, row])
        self._yaws.append(float(yaws[0]))
        return Foretold(places, track)

    def label(self) -> tuple[I8, F32, int]:
        """The next actions [6], the way ahead [13, 2] m in the agent's frame, its own points.

        Raises:
            PlanError: the agent is cut off from the person.
        """
        simulator, ahead = self._simulator, self.foretell()
        self._task = dataclasses.replace(self._task, track=ahead.track)
        plan = self._plan
        if plan is None or not self._goes_on(plan, ahead):
            plan = _Plan([simulator.pose], [simulator.heading])
        plan.places = ahead.places
        while len(plan.codes) < ACTIONS_AHEAD:
            self._think(plan, ahead)
        self._plan = plan
        line = [pose[:2] for pose in plan.poses]
        kept = [True, *(there != here for here, there in itertools.pairwise(line))]
        way, valid = self._way(ahead.track, list(itertools.compress(line, kept)))
        return np.array(plan.codes, np.int8), way, valid

    def note(self, action: int) -> None:
        """Note what the agent does in the state that was labelled last."""
        plan = self._plan
        assert plan is not None
        self._oracle = plan.memories[0]
        if action == plan.codes[0]:
            plan.drop(self._task.agent.step_ticks)
            return
        self._oracle.note(plan.poses[0], Action(action))
        self._plan = None

    def _goes_on(self, plan: _Plan, ahead: Foretold) -> bool:
        """Whether agent and people are where a plan has them and will be, so that it holds."""
        simulator = self._simulator
        if np.abs(np.subtract(simulator.pose, plan.poses[0])).max() > _SAME:
            return False
        if np.abs(ahead.places[: len(plan.places)] - plan.places).max() > _SAME:
            return False
        return plan.codes[0] != Action.FORWARD or simulator.foresee_forward() is None

    def _think(self, plan: _Plan, ahead: Foretold) -> None:
        """Add the follower's next step to a plan."""
        simulator, task, step = self._simulator, self._task, len(plan.codes)
        oracle = copy.copy(plan.memories[-1] if step else self._oracle)
        oracle.task = task
        pose, heading = plan.poses[-1], plan.headings[-1]
        begin, time = step * task.agent.step_ticks, simulator.time + task.agent.time_after(step)
        others = np.delete(ahead.places[begin], self.row, 0).tolist()
        action = oracle.act(pose, time, [(x, y) for x, y in others])
        if action == Action.FORWARD and self._touches(pose, ahead.places[begin:], first=not step):
            action = Action.STOP
            oracle.note(pose, action)
        if action == Action.FORWARD:
            there = step_forward(pose.x, pose.y, pose.yaw, task.agent.forward_step)
            move = move_agent(simulator.navigation, pose.x, pose.y, *there, task.agent)
            pose = Pose2D(move.x, move.y, pose.yaw)
        elif action != Action.STOP:
            heading = heading.turned(1 if action == Action.LEFT else -1)
            pose = Pose2D(pose.x, pose.y, heading.yaw)
        plan.codes.append(int(action))
        plan.memories.append(oracle)
        plan.poses.append(pose)
        plan.headings.append(heading)

    def _touches(self, pose: Pose2D, places: F64, *, first: bool) -> bool:
        """Whether a FORWARD at a pose meets somebody, who go through `places` [N, P, 2] then."""
        if first:
            return self._simulator.foresee_forward() is not None
        agent = self._task.agent
        share = np.arange(1, agent.step_ticks + 1)[:, None] / agent.step_ticks
        here = np.array(pose[:2])
        there = np.array(step_forward(pose.x, pose.y, pose.yaw, agent.forward_step))
        mine = here + share * (there - here)
        away = places[1 : 1 + agent.step_ticks] - mine[:, None]
        nearest = float(np.hypot(away[..., 0], away[..., 1]).min())
        return nearest < agent.radius + self._task.person_radius

    def _way(self, track: TargetTrack, line: list[tuple[float, float]]) -> tuple[F32, int]:
        """Where six steps lead, then the person's trail as far as it will be followed."""
        simulator, task = self._simulator, self._task
        navigation, end = simulator.navigation, np.array(line[-1])
        then = simulator.time + task.agent.time_after(ACTIONS_AHEAD)
        begin = max(track.arc_at(then) - task.distance, 0.0)
        last = max(track.arc_at(float(track.times[-1])) - task.distance, begin)
        trail = track.trail(begin, last)
        gaps = np.hypot(*(trail - end).T)
        nearest = int(np.argmin(gaps))
        way, onward = np.array(line), trail[nearest + 1 :]
        if last - begin < AT_REST and len(line) == 1 and gaps[nearest] <= 2 * NEAR:
            onward = onward[:0]  # it is there, and nobody goes on
        elif gaps[nearest] > NEAR:
            free = navigation.nearest_free(*trail[nearest].tolist())
            try:
                if free is None:
                    raise PlanError("nothing is walkable near the track")
                way = np.vstack([way, find_way(navigation.geodesic(free, keep=False), end)])
            except PlanError:  # the person walks where the agent cannot
                onward = onward[:0]
        out = np.zeros((POINTS, 2))
        grid = navigation.inflated
        frame = (grid.blocked, *map(float, grid.origin), float(grid.resolution))
        state = np.array(simulator.pose)
        whole = np.vstack([way, walkable_part(navigation, onward, way[-1])])
        valid = spread_line(whole, *frame, SPACING, state, out)
        return out.astype(np.float32), int(valid)


@dataclass
class _Walked:
    """What happened at each state, in order."""

    poses: list[Pose2D] = field(default_factory=list)
    states: list[CrowdState] = field(default_factory=list)
    labels: list[I8] = field(default_factory=list)
    ways: list[F32] = field(default_factory=list)
    valid: list[int] = field(default_factory=list)
    said: list[int] = field(default_factory=list)
    executed: list[int] = field(default_factory=list)
    collided: list[bool] = field(default_factory=list)


class FollowVisitor:
    """One episode of DAgger behind a person; see `gn0.data.dagger.Visitor`.

    Args:
        simulator: the episode's, which has just begun.
        episode: what is played.
        settings: who acts.
        sight: what hides people from the agent.

    Raises:
        PlanError: the mission does not say whom to follow.
    """

    def __init__(
        self,
        simulator: Simulator,
        episode: Episode,
        settings: DaggerSettings,
        sight: OccupancyGrid,
    ) -> None:
        self.episode = episode
        self._simulator, self._settings, self._sight = simulator, settings, sight
        self._draws = random_stream(settings.seed, "dagger", settings.iteration, episode.id)
        self._expert = FollowExpert(simulator, episode, sight)
        self._walked = _Walked()
        self._count = FollowCount()
        self._arrived = math.inf
        self.end: FollowEnd | None = None

    @property
    def over(self) -> bool:
        """Whether the rules have ended the episode."""
        return self.end is not None

    def look(self) -> None:
        """Label the state that the agent has come to.

        Raises:
            PlanError: the agent is cut off from the person.
        """
        simulator, walked = self._simulator, self._walked
        state = simulator.company.save()
        assert state is not None
        codes, way, valid = self._expert.label()
        walked.poses.append(simulator.pose)
        walked.states.append(state)
        walked.labels.append(codes)
        walked.ways.append(way)
        walked.valid.append(valid)

    def decide(self, said: int) -> int:
        """What is done in this state, where the policy says so; STOP stands still."""
        expert_acts = self._draws.random() < self._settings.expert_share
        action = int(self._walked.labels[-1][0]) if expert_acts else said
        self._walked.said.append(said)
        self._walked.executed.append(action)
        self._expert.note(action)
        return action

    def note(self, collided: bool) -> None:
        """Note what became of it, and whether the episode is over."""
        simulator, company = self._simulator, self._simulator.company
        self._walked.collided.append(collided)
        pose, row = simulator.pose, self._expert.row
        x, y = company.places[row].tolist()
        if math.isinf(self._arrived) and company.state.whole[0, row, MODE] == ARRIVED:
            self._arrived = simulator.time
        bearing = wrap_angle(math.atan2(y - pose.y, x - pose.x) - pose.yaw)
        faced = abs(bearing) <= math.radians(FOLLOW.half_view)
        sight = FollowSight(
            distance=math.dist((x, y), pose[:2]),
            faced=faced and is_line_free(self._sight, (x, y), pose[:2]),
            hit=company.hit is not None,
            stopped=self._walked.executed[-1] == Action.STOP,
        )
        self._count, self.end, _ = count_step(
            self._count, sight, FOLLOW,
            step_seconds=simulator.agent.step_seconds, over_at=self._arrived,
        )  # fmt: skip

    def rows(self, end: Pose2D) -> EpisodeRows:
        """The rows of the episode, which has ended there, without map tokens."""
        walked, person = self._walked, self.episode.followed
        assert person is not None
        poses = np.array(walked.poses, np.float64)
        executed = np.array(walked.executed, np.int8)
        people = StepPeople.of_states(walked.states)
        actions, waypoints = np.array(walked.labels, np.int8), np.array(walked.ways, np.float32)
        valid = np.array(walked.valid, np.int8)
        if self._settings.demonstrate:
            actions = window_actions(executed)
            waypoints, valid = walked_way(poses, (end.x, end.y))
        away = people.places[:, self._expert.row] - poses[:, :2]
        return EpisodeRows(
            episode_id=self.episode.id,
            poses=poses,
            executed=executed,
            actions=actions,
            waypoints=waypoints,
            pixels=np.full((len(poses), POINTS, 2), NO_TOKEN, np.int16),
            valid=valid,
            distance=np.hypot(away[:, 0], away[:, 1]).astype(np.float32),
            collided=np.array(walked.collided, bool),
            source="demonstration" if self._settings.demonstrate else "dagger",
            policy_actions=tuple((said,) for said in walked.said),
            people=people,
            person=person.number,
        )
