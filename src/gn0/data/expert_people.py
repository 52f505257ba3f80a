"""The expert's walks among people, played in the simulator: to goals, and behind somebody.

To a goal it walks as the policy `oracle` does among people: it waits by turning to and fro, and
goes round who stands. Where somebody is to be followed it does the mission's own reference track
(paper, X_a), which the generator has proved. Everybody moves on the episode's clock, see
`gn0.sim.people`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from gn0.data.codec import encode_waypoints
from gn0.data.dataset import Dataset
from gn0.data.expert_labels import Labels, LabelSettings, label_along, window_actions
from gn0.data.follow import TargetTrack, label_follow
from gn0.data.follow_reference import follow_task
from gn0.data.sample_table import NO_TOKEN, EpisodeRows
from gn0.data.step_people import StepPeople
from gn0.data.walked_way import walked_way
from gn0.data.ways_round import lead_round
from gn0.errors import PlanError
from gn0.geometry import F64
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, MissionFollow
from gn0.paper import POINTS
from gn0.people.crowd import CrowdState
from gn0.plugins import build_plugin
from gn0.sim.policy import Policy
from gn0.sim.rollout import begin_episode
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action

MOST_STEPS = 2000  # actions after which an expert has lost its way to a goal among people


@dataclass(eq=False)
class PeopleWalk:
    """A walk among people, step by step.

    Attributes:
        poses: before each action, [T, 3] x, y [m] and yaw [rad] when all are there.
        actions: what was done.
        collided: whether each was cut short.
        states: what people did before each action.
        end: pose after the last one.
    """

    poses: list[tuple[float, float, float]] = field(default_factory=list)
    actions: list[int] = field(default_factory=list)
    collided: list[bool] = field(default_factory=list)
    states: list[CrowdState] = field(default_factory=list)
    end: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def note(self, simulator: Simulator, action: int) -> bool:
        """Let the simulator do an action, and keep what was before it; True when it is over."""
        pose, state = simulator.pose, simulator.company.save()
        assert state is not None
        self.poses.append((pose.x, pose.y, pose.yaw))
        self.states.append(state)
        self.actions.append(int(action))
        result = simulator.step(action)
        self.collided.append(bool(result.collided))
        x, y, yaw = simulator.pose
        self.end = (x, y, yaw)
        return bool(result.terminated or result.truncated)

    def rows(self, episode: Episode, labels: Labels, distance: F64) -> EpisodeRows:
        """Its rows, without map tokens."""
        person = episode.followed
        return EpisodeRows(
            episode_id=episode.id,
            poses=np.array(self.poses),
            executed=np.array(self.actions, np.int8),
            actions=labels.actions6,
            waypoints=labels.waypoints,
            pixels=np.full((len(self.actions), POINTS, 2), NO_TOKEN, np.int16),
            valid=labels.valid,
            distance=distance.astype(np.float32),
            collided=np.array(self.collided, bool),
            people=StepPeople.of_states(self.states),
            person=0 if person is None else person.number,
        )


class PeopleExpert:
    """Walks through episodes with people; the simulator of the last scene is kept.

    Args:
        dataset: whose scenes, agent and settings.
    """

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self._scene = ""
        self._simulator: Simulator | None = None

    def collect(self, episode: Episode) -> EpisodeRows:
        """The rows of an episode.

        Raises:
            PlanError: the goal, or the person, cannot be reached.
            EpisodeError: somebody would walk through a wall.
        """
        about = self._dataset.about
        simulator = self._open(episode)
        navigation, labels = simulator.navigation, about.settings.labels
        if isinstance(episode.mission, MissionFollow):
            rows = follow_person(simulator, episode, labels)
        else:
            rows = walk_to_goal(simulator, episode, labels)
        frame = about.settings.tokens.of_grid(navigation.grid)
        return replace(rows, pixels=encode_waypoints(frame, rows.waypoints, rows.poses))

    def _open(self, episode: Episode) -> Simulator:
        if self._simulator is None or self._scene != episode.scene_id:
            self._simulator = None  # let go of the old scene first
            self._simulator = Simulator(
                self._dataset.scene(episode.scene_id),
                navigation=self._dataset.navigation(episode.scene_id),
                agent=self._dataset.about.agent,
                max_steps=MOST_STEPS,
            )
            self._scene = episode.scene_id
        return self._simulator


def walk_to_goal(simulator: Simulator, episode: Episode, labels: LabelSettings) -> EpisodeRows:
    """The oracle's walk to a goal among people, labelled along the way, without map tokens.

    The way ahead of exact labels goes round those who stand or sit, as the actions do, and else is
    the shortest one of the scene without people.

    Raises:
        PlanError: the goal cannot be reached.
        EpisodeError: somebody would walk through a wall.
    """
    options = {"stop_distance": labels.stop_distance, "turn_cost": labels.turn_cost}
    policy: Policy = build_plugin("policy", "oracle", options)
    observation, walk, over = begin_episode(simulator, policy, episode), PeopleWalk(), False
    while not over:
        action = policy.act(observation)
        assert isinstance(action, Action)  # ours; and it looks at nothing
        over = walk.note(simulator, action)
    if walk.actions[-1] != Action.STOP:
        raise PlanError(
            f"the expert is not at the goal after {len(walk.actions)} actions: people are in its "
            "way",
            where=f"episode {episode.id!r}",
            remedy="give the episode fewer people, or other paths of theirs",
        )
    navigation, poses = simulator.navigation, np.array(walk.poses)
    found = label_along(navigation, episode, poses, np.array(walk.actions), labels)
    if labels.variant == "exact":
        radius, plain = simulator.company.radius, (found.waypoints, found.valid)
        found = Labels(found.actions6, *lead_round(navigation, episode, poses, radius, plain))
    distance = navigation.geodesic(episode.destination).distance(poses[:, :2])
    return walk.rows(episode, found, distance)


def follow_person(simulator: Simulator, episode: Episode, labels: LabelSettings) -> EpisodeRows:
    """The reference track behind a person, labelled along the way, without map tokens.

    With the exact labels a step says what the reference does next and where it walks then; with
    `mpc` and `field`, each state is labelled towards the desired one of its time, see
    `gn0.data.follow.label_follow`. The distance is the one to the person.

    Raises:
        PlanError: the mission says neither whom to follow nor how, or the agent is cut off.
        EpisodeError: somebody would walk through a wall.
    """
    mission, task = episode.mission, follow_task(episode)  # refuses whom nobody is told of
    assert isinstance(mission, MissionFollow)
    actions = mission.reference_actions
    if not len(actions):
        raise PlanError(
            "the mission has no reference track",
            where=f"episode {episode.id!r}, actions",
            remedy="make it with `gn0 missions generate --types follow`",
        )
    simulator.reset(episode)
    walk = PeopleWalk()
    for code in actions:
        walk.note(simulator, int(code))
    found = label_reference(simulator.navigation, task.track, walk, episode, labels)
    assert episode.followed is not None
    row = episode.people.index(episode.followed)
    people = StepPeople.of_states(walk.states).places[:, row]
    away = np.hypot(*(people - np.array(walk.poses)[:, :2]).T)
    return walk.rows(episode, found, away)


def lead_in(track: TargetTrack, start: tuple[float, float, float]) -> TargetTrack:
    """The track with a trail that begins where the agent does, behind the person.

    Without it the place behind a person who has hardly walked would be its own first one.
    """
    yaws = None if track.yaws is None else np.r_[track.yaws[0], track.yaws]
    times = np.r_[track.times[0] - 1.0, track.times]
    return TargetTrack(times, np.vstack([start[:2], track.places]), yaws)


def label_reference(
    navigation: NavigationMap,
    track: TargetTrack,
    walk: PeopleWalk,
    episode: Episode,
    labels: LabelSettings,
) -> Labels:
    """Labels along a reference track; see `follow_person`.

    Raises:
        PlanError: a state is cut off from the person's trail; names the row.
    """
    poses, mission = np.array(walk.poses), episode.mission
    assert isinstance(mission, MissionFollow)
    if labels.variant in ("mpc", "field"):
        times = episode.agent.step_seconds * np.arange(len(poses))
        return label_follow(
            navigation, lead_in(track, episode.start), poses, times, labels, agent=episode.agent,
            distance=mission.distance or 1.5,
        )  # fmt: skip
    waypoints, valid = walked_way(poses, walk.end[:2])
    return Labels(window_actions(np.array(walk.actions, np.int8)), waypoints, valid)
