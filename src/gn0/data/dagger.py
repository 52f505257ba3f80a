"""DAgger: a policy drives, the expert says at every state what should have been done.

Who acts is drawn anew at every step, as in Ross, Gordon and Bagnell (2011): the expert with
probability β, else the policy. Whoever acts, the state is labelled with the expert's next six
actions and the way ahead, and the policy's own answer stands beside them.

Where the policy hovers near the goal without saying STOP a halting rule ends the episode:

    paper (Eq. halting): a counter starts when the agent comes within the success distance, and
        goes on while it stays there. After ten more steps the episode is cut off, and the label of
        that last state is STOP.
    gn0-release: the goal zone is a disc, as the crow flies, of a fifth of the path's length,
        1 m to 3 m. After leaving it again the agent has ten more steps; the labels of these end
        with STOP where they enter the zone.
    none: the expert's label alone.

Where people are about the expert waits for them and goes round who stands (`gn0.data.dagger_goal`);
who is to be followed is labelled against where the person goes next (`gn0.data.dagger_follow`), and
none of the rules above ends such an episode. A policy alone can be driven among people, not many
agents side by side.

A demonstration (`DaggerSettings.demonstrate`) is labelled with what was done next and the way that
was walked, as the expert's own walks are with theirs.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from gn0.data.dagger_follow import FollowVisitor
from gn0.data.dagger_goal import GoalExpert
from gn0.data.expert_labels import I8, ROUNDING, LabelSettings, cut_at, label_states, plan_from
from gn0.data.field_labels import label_poses
from gn0.data.sample_table import NO_TOKEN, EpisodeRows
from gn0.data.settings import DaggerSettings, Halting
from gn0.data.step_people import StepPeople
from gn0.data.walked_way import walked_way
from gn0.data.waypoints import sample_way_points
from gn0.data.ways_round import lead_round
from gn0.errors import ConfigError, EpisodeError, Gn0Error, PlanError, PolicyError, SimError
from gn0.geometry import F64, Pose2D, wrap_angle
from gn0.maps.distance import GeodesicField
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, MissionFollow
from gn0.missions.generate.follow_sight import sight_grid
from gn0.paper import ACTIONS_AHEAD, HALT_STEPS, POINTS
from gn0.people.crowd import CrowdState
from gn0.seeds import random_stream
from gn0.sim.kinematics import Heading
from gn0.sim.policy import Policy
from gn0.sim.rollout import begin_episode
from gn0.sim.rollout_batch import RolloutBatch
from gn0.sim.simulator import Simulator, action_code
from gn0.sim.state import Action, Displacement, Observation, Teleport
from gn0.sim.walkers import Walkers

if TYPE_CHECKING:
    from gn0.maps.grid import OccupancyGrid
    from gn0.scenes.scene import Scene

ZONE_SHARE, ZONE_LEAST, ZONE_MOST = 0.2, 1.0, 3.0  # of the path's length; m
_SAME = 1e-6  # m or rad between where a plan expects the agent and where it is


@dataclass(frozen=True)
class _Visit:
    """A state: where, what was done, what should have been, what the policy said."""

    pose: Pose2D
    executed: int
    actions: tuple[int, ...]
    said: int
    collided: bool


class _Expert:
    """Labels one state after the other, and goes on with its plan while the agent follows it."""

    def __init__(self, simulator: Standing, field: GeodesicField, labels: LabelSettings) -> None:
        self._simulator = simulator
        self._field = field
        self._labels = labels
        self._plan: list[int] = []
        self._expected: tuple[float, float, float] | None = None

    @property
    def action(self) -> int:
        """What the expert itself does here: the next of its plan."""
        return self._plan[0] if self._plan else int(Action.STOP)

    def actions(self) -> list[int]:
        """The label of where the agent is: six actions, or fewer up to the STOP."""
        pose, agent = self._simulator.pose, self._simulator.agent
        astray = self._expected is None or not _is_at(pose, self._expected)
        self._expected = (pose.x, pose.y, pose.yaw)
        state = np.array([pose])
        if self._labels.variant not in ("mpc", "field"):
            if astray:
                self._plan = plan_from(self._field, state[0], self._labels, agent).tolist()
            return self._plan[:ACTIONS_AHEAD]
        simulator = self._simulator
        goal = simulator.episode.destination
        labels = label_states(simulator.navigation, goal, state, self._labels, agent=agent)
        label = [int(code) for code in labels.actions6[0]]
        # a plan of mpc is carried out to its end: planned anew at every step it may turn to and fro
        # for ever
        if astray or not self._plan or self._labels.variant == "field":
            self._plan = [code for code in label if code]
        return label

    def follow(self, action: int) -> None:
        """Note what the agent does next."""
        if not self._plan or action != self._plan[0]:
            self._expected = None
            return
        self._plan.pop(0)
        agent = self._simulator.agent
        x, y, yaw = self._simulator.pose
        if action == Action.FORWARD:
            x += agent.forward_step * math.cos(yaw)
            y += agent.forward_step * math.sin(yaw)
        else:
            yaw = Heading(yaw, 1 if action == Action.LEFT else -1, agent.turn_degrees).yaw
        self._expected = (x, y, yaw)


def _is_at(pose: Pose2D, place: tuple[float, float, float]) -> bool:
    return (
        abs(pose.x - place[0]) <= _SAME
        and abs(pose.y - place[1]) <= _SAME
        and abs(wrap_angle(pose.yaw - place[2])) <= _SAME
    )


class _Halt:
    """Counts the steps near the goal by one of the rules."""

    def __init__(self, rule: Halting, radius: float, field: GeodesicField, length: float) -> None:
        self.rule = rule
        self._radius = radius
        self._field = field
        self.zone = min(max(ZONE_SHARE * length, ZONE_LEAST), ZONE_MOST)
        self._count: int | None = None  # steps since the counter began
        self._entered = False

    def look(self, pose: Pose2D) -> None:
        """Note a state that the agent has come to."""
        if self.rule == "paper":
            inside = self._field.distance_at(pose.x, pose.y) <= self._radius
            self._count = None if not inside else 0 if self._count is None else self._count + 1
        elif self.rule == "gn0-release":
            inside = bool(self._field.straight(np.array([pose[:2]]))[0] <= self.zone)
            if self._count is not None:
                self._count += 1
            elif self._entered and not inside:
                self._count = 0
            self._entered |= inside

    @property
    def is_due(self) -> bool:
        """Whether the episode is cut off here."""
        return self._count is not None and self._count >= HALT_STEPS

    @property
    def overshot(self) -> bool:
        """Whether the agent has left the goal zone of the release again."""
        return self.rule == "gn0-release" and self._count is not None


class Visitor:
    """One episode of DAgger: labels each state, decides who acts, and keeps what happened.

    Args:
        standing: where the agent is; read anew at every state.
        episode: what is played; it has just begun.
        settings: who acts, and what ends it.
        labels: labels of the expert.

    Raises:
        PlanError: the goal cannot be reached.
    """

    over = False  # it ends where the simulator says so

    def __init__(
        self,
        standing: Standing,
        episode: Episode,
        settings: DaggerSettings,
        labels: LabelSettings,
    ) -> None:
        self.episode = episode
        self._standing, self._settings, self._labels = standing, settings, labels
        self._draws = random_stream(settings.seed, "dagger", settings.iteration, episode.id)
        self._field = standing.navigation.geodesic(episode.destination)
        length = self._field.distance_at(episode.start[0], episode.start[1])
        within = episode.success_within(settings.success_radius)
        self._halt = _Halt(settings.halting, within, self._field, length)
        self._company = None
        self._expert: _Expert | GoalExpert
        if episode.people and isinstance(standing, Simulator):
            self._company = standing.company
            self._expert = GoalExpert(standing, labels)
        else:
            self._expert = _Expert(standing, self._field, labels)
        self._states: list[CrowdState] = []
        self._visits: list[_Visit] = []
        self._now: _Visit | None = None

    def look(self) -> None:
        """Label the state that the agent has come to."""
        pose = self._standing.pose
        self._halt.look(pose)
        state = None if self._company is None else self._company.save()
        if state is not None:
            self._states.append(state)
        ahead = np.zeros(ACTIONS_AHEAD, np.int8)
        plan = self._expert.actions()
        ahead[: len(plan)] = plan
        ahead = _apply_rules(ahead, pose, self._standing, self._field, self._labels, self._halt)
        self._now = _Visit(pose, 0, tuple(ahead.tolist()), 0, False)

    def decide(self, said: int) -> int:
        """What is done in this state, where the policy says so."""
        assert self._now is not None
        expert_acts = self._draws.random() < self._settings.expert_share
        action = self._expert.action if expert_acts else said
        if self._halt.is_due or (expert_acts and self._now.actions[0] == Action.STOP):
            action = int(Action.STOP)
        self._expert.follow(action)
        self._now = dataclasses.replace(self._now, executed=action, said=said)
        return action

    def note(self, collided: bool) -> None:
        """Note what became of it."""
        assert self._now is not None
        self._visits.append(dataclasses.replace(self._now, collided=collided))

    def rows(self, end: Pose2D) -> EpisodeRows:
        """The rows of the episode, which has ended there."""
        if self._settings.demonstrate:
            rows = _demonstration(self.episode, self._field, self._visits, end)
        else:
            rows = _rows(self.episode, self._field, self._visits)
            if self._labels.variant == "field":
                agent, near = self._standing.agent, self._labels.stop_distance - ROUNDING
                found = label_poses(self._field, rows.poses, agent, near)
                rows = dataclasses.replace(rows, waypoints=found.waypoints, valid=found.valid)
            elif self._labels.variant == "exact" and self._company is not None:
                waypoints, valid = lead_round(
                    self._standing.navigation, self.episode, rows.poses, self._company.radius,
                    (rows.waypoints, rows.valid),
                )  # fmt: skip
                rows = dataclasses.replace(rows, waypoints=waypoints, valid=valid)
        if not self._states:
            return rows
        return dataclasses.replace(rows, people=StepPeople.of_states(self._states))


def drives_alone(episode: Episode) -> bool:
    """Whether an episode is driven by itself: people react to an agent, whom they must know."""
    return bool(episode.people) or isinstance(episode.mission, MissionFollow)


def collect_visited(
    simulator: Simulator,
    policy: Policy,
    episode: Episode,
    settings: DaggerSettings,
    labels: LabelSettings,
) -> EpisodeRows:
    """Let the policy drive through an episode, and label every state that it comes to.

    With β = 0 and no halting rule the trajectory is that of `sim.rollout.run_episode`. The policy
    is asked at every state, also where the expert acts. Pixels are left out: the dataset knows its
    map frame.

    Raises:
        PolicyError: the policy wants a sensor that is not carried, or answers with anything but a
            discrete action.
        EpisodeError: the episode does not fit the scene.
        PlanError: the goal, or the person to follow, cannot be reached; or nobody says who that is.
    """
    observation = begin_episode(simulator, policy, episode)
    visitor: Visitor | FollowVisitor
    if isinstance(episode.mission, MissionFollow):
        sight = _find_sight(simulator.scene, simulator.agent.camera_height)
        visitor = FollowVisitor(simulator, episode, settings, sight)
    else:
        visitor = Visitor(simulator, episode, settings, labels)
    while True:
        visitor.look()
        result = simulator.step(visitor.decide(_ask(policy, observation, episode)))
        visitor.note(result.collided)
        observation = result.observation
        if result.terminated or result.truncated or visitor.over:
            return visitor.rows(simulator.pose)


@lru_cache(maxsize=1)
def _find_sight(scene: Scene, eye: float) -> OccupancyGrid:
    """What hides people in the scene of last time, as it takes a while to find out."""
    return sight_grid(scene, eye)


def collect_together(
    rollout: RolloutBatch,
    navigation: NavigationMap,
    episodes: Sequence[Episode],
    settings: DaggerSettings,
    labels: LabelSettings,
) -> Iterator[tuple[Episode, EpisodeRows | None]]:
    """The same for episodes of one scene side by side, as they end; None of one that cannot begin.

    Args:
        rollout: agents and policy.
        navigation: the map of the scene.
        episodes: begun in this order; without people, see `drives_alone`.
        settings: who acts, and what ends an episode.
        labels: labels of the expert.

    Raises:
        PolicyError: see `collect_visited`.
    """
    waiting = list(episodes)[::-1]
    visitors: dict[int, Visitor] = {}
    while waiting or visitors:
        while waiting and rollout.free:
            episode = waiting.pop()
            try:
                (slot,) = rollout.begin([episode])
                standing = _AgentStanding(rollout.walkers, slot, navigation, episode)
                visitors[slot] = Visitor(standing, episode, settings, labels)
            except (EpisodeError, PlanError):  # alone it says what is wrong
                rollout.give_up(episode)
                yield episode, None
        if not visitors:
            continue
        for visitor in visitors.values():
            visitor.look()
        said = _ask_all(rollout)
        codes = {slot: visitor.decide(said[slot]) for slot, visitor in visitors.items()}
        ended = rollout.advance(codes)
        for slot in sorted(visitors):
            walk = ended.get(slot) or rollout.walks[slot]
            visitors[slot].note(walk.collided[-1])
            if slot in ended:
                yield walk.episode, visitors.pop(slot).rows(walk.poses[-1])


class Standing(Protocol):
    """Where an agent is: a `Simulator`, or one agent of many."""

    @property
    def pose(self) -> Pose2D:
        """x, y [m], yaw [rad]."""
        ...

    @property
    def episode(self) -> Episode:
        """What it plays."""
        ...

    navigation: NavigationMap
    agent: AgentSpec


class _AgentStanding:
    """One agent of many."""

    def __init__(
        self, walkers: Walkers, slot: int, navigation: NavigationMap, episode: Episode
    ) -> None:
        self._walkers, self._slot = walkers, slot
        self.navigation, self.agent, self.episode = navigation, walkers.agent, episode

    @property
    def pose(self) -> Pose2D:
        return self._walkers.pose(self._slot)


def _apply_rules(
    ahead: I8,
    pose: Pose2D,
    simulator: Standing,
    field: GeodesicField,
    labels: LabelSettings,
    halt: _Halt,
) -> I8:
    """The label of a state, after goal zone and halting rule."""
    if halt.rule == "paper" and halt.is_due:
        return np.zeros_like(ahead)
    state: F64 = np.array([pose])
    if labels.variant == "gn0-release":
        ahead = cut_at(ahead[None], field, state, simulator.agent, labels.release_stop)[0]
    if halt.overshot:
        ahead = cut_at(ahead[None], field, state, simulator.agent, halt.zone)[0]
    return ahead


def _ask(policy: Policy, observation: Observation, episode: Episode) -> int:
    """The code of what a policy answers."""
    where = f"episode {episode.id!r}, step {observation.step}"
    try:
        answer = policy.act(observation)
    except Gn0Error:
        raise
    except Exception as error:  # whatever a policy of others does
        lines = str(error).splitlines() or [""]
        raise PolicyError(
            f"policy {policy.name!r}: act failed: {type(error).__name__}: {lines[0]}",
            where=where,
            remedy="fix it and run the same command again: what is done is kept",
        ) from error
    if isinstance(answer, Teleport | Displacement):
        raise PolicyError(
            f"policy {policy.name!r} answers with a {type(answer).__name__.lower()}",
            where=where,
            remedy="collect with a policy of STOP, FORWARD, LEFT and RIGHT",
        )
    try:
        return action_code(answer)
    except SimError as error:
        raise PolicyError(
            f"policy {policy.name!r} returned no valid action: {error.what}",
            where=where,
            remedy=error.remedy,
        ) from error


def _ask_all(rollout: RolloutBatch) -> dict[int, int]:
    """The codes of what a policy answers to all agents."""
    try:
        return rollout.ask()
    except Gn0Error:
        raise
    except Exception as error:  # whatever a policy of others does
        lines = str(error).splitlines() or [""]
        raise PolicyError(
            f"policy {rollout.policy.name!r}: act failed: {type(error).__name__}: {lines[0]}",
            where=f"{len(rollout.walks)} episodes side by side",
            remedy="--agents 1 says in which episode; what is done is kept",
        ) from error


def _rows(episode: Episode, field: GeodesicField, visits: list[_Visit]) -> EpisodeRows:
    poses = np.array([visit.pose for visit in visits], np.float64)
    waypoints, valid = sample_way_points(field, poses)
    count = len(visits)
    return EpisodeRows(
        episode_id=episode.id,
        poses=poses,
        executed=np.array([visit.executed for visit in visits], np.int8),
        actions=np.array([visit.actions for visit in visits], np.int8),
        waypoints=waypoints,
        pixels=np.full((count, POINTS, 2), NO_TOKEN, np.int16),
        valid=valid,
        distance=field.distance(poses[:, :2]).astype(np.float32),
        collided=np.array([visit.collided for visit in visits], bool),
        source="dagger",
        policy_actions=tuple((visit.said,) for visit in visits),
    )


def _demonstration(
    episode: Episode, field: GeodesicField, visits: list[_Visit], end: Pose2D
) -> EpisodeRows:
    """Rows that say of each state what was done from there on."""
    rows = _rows(episode, field, visits)
    done = np.r_[rows.executed, np.zeros(ACTIONS_AHEAD, np.int8)]
    actions = np.lib.stride_tricks.sliding_window_view(done, ACTIONS_AHEAD)[: len(rows)]
    waypoints, valid = walked_way(rows.poses, (end.x, end.y))
    return dataclasses.replace(
        rows,
        actions=np.ascontiguousarray(actions),
        waypoints=waypoints,
        valid=valid,
        source="demonstration",
    )


def check_options(options: Mapping[str, Any], secrets: tuple[str, ...]) -> None:
    """Refuse options that must not be written down: a dataset says how it was made.

    Raises:
        ConfigError: one is a secret by its name.
    """
    for name in options:
        if any(word in name.lower() for word in secrets):
            raise ConfigError(
                f"policy option {name!r} would be written into dataset.json",
                where="--policy-option",
                remedy="hand secrets to the policy through the environment",
            )
