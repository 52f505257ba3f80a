"""Following with all knowledge: the map, the person's whole track, and where everybody is.

What it says is a function of what it is handed, so labels, trials and the policy share it. It keeps
to the reference pose of the moment at which its action will have been done, planned anew each step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gn0.data.expert_labels import LabelSettings, is_arrived, plan_from
from gn0.data.follow import DesiredState, TargetTrack, desired_state, reference_state
from gn0.errors import PlanError
from gn0.geometry import Pose2D, wrap_angle
from gn0.maps.grid import OCCUPIED, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.ray import is_line_free
from gn0.missions.episode import AgentSpec
from gn0.sim.kinematics import step_forward
from gn0.sim.presets import find_preset
from gn0.sim.state import Action

Place = tuple[float, float]

FOLLOWER = find_preset("follower").agent  # 0.25 m, 15°, 0.2 s
# the person walks on while the agent turns: a turn is worth the step that it takes the time of
IN_TIME = LabelSettings(turn_cost=FOLLOWER.forward_step)

MARGIN = 0.10  # m between the discs of agent and person that it leaves
NEAREST, CLOSER = 0.9, 0.1  # m behind on the trail, at least, to see round a bend; in steps of
SIGHT_DEGREES = 38.0  # the person is kept within it of the axis
SIGHT_REACH = 2.5  # m: and farther off, walking comes first
AROUND = 3.0  # m: people beyond that are nobody to go round


@dataclass(frozen=True)
class FollowTask:
    """What an oracle of following knows of its episode.

    Attributes:
        track: of the person to follow, from its beginning to its end.
        distance: to keep behind [m].
        lateral: to keep to the person's right [m].
        agent: the body.
        person_radius: of people's discs [m].
        settings: `stop_distance` is how near the reference is near enough.
    """

    track: TargetTrack
    distance: float = 1.5
    lateral: float = 0.0
    agent: AgentSpec = FOLLOWER
    person_radius: float = 0.25
    settings: LabelSettings = IN_TIME


def choose_following(
    navigation: NavigationMap,
    task: FollowTask,
    pose: Pose2D,
    time: float,
    people: Sequence[Place] = (),
) -> Action:
    """The next action of an agent that follows; STOP stands still.

    Args:
        navigation: map of the scene, inflated for the agent.
        task: whom it follows, and how.
        pose: of the agent.
        time: now [s].
        people: where everybody is now (x, y) m, the person to follow as well: it walks into nobody.

    Raises:
        PlanError: the agent is cut off from the trail.
    """
    soon = time + task.agent.step_seconds
    px, py = task.track.place_at(soon)
    crowd = [*people, (px, py)]
    bearing = wrap_angle(math.atan2(py - pose.y, px - pose.x) - pose.yaw)
    wanted = _wanted(navigation, task, pose, soon)
    action = _towards(navigation, task, pose, wanted)
    if action == Action.FORWARD and not is_clear(pose, crowd, task.agent, task.person_radius):
        action = _face(bearing, task.agent)
    return _keep_in_sight(navigation, task, pose, crowd, action)


def _wanted(navigation: NavigationMap, task: FollowTask, pose: Pose2D, time: float) -> DesiredState:
    """The reference; where the person is not seen from there, nearer on the trail until it is."""
    wanted = reference_state(
        navigation, task.track, time, (pose.x, pose.y), task.distance, task.lateral
    )
    person, distance = task.track.place_at(time), task.distance
    while not is_line_free(navigation.grid, person, (wanted.x, wanted.y)):
        distance -= CLOSER
        if distance < NEAREST:
            break
        wanted = desired_state(navigation, task.track, time, distance)
    return wanted


def _towards(
    navigation: NavigationMap, task: FollowTask, pose: Pose2D, wanted: DesiredState
) -> Action:
    free = navigation.nearest_free(wanted.x, wanted.y)
    if free is None:
        raise PlanError("nothing is walkable near the track", where=f"({pose.x:g}, {pose.y:g})")
    field = navigation.geodesic(free, keep=False)
    if is_arrived(field, pose.x, pose.y, task.settings.stop_distance):
        return _face(wrap_angle(wanted.yaw - pose.yaw), task.agent)
    plan = plan_from(field, np.array(pose), task.settings, task.agent)
    return Action(int(plan[0])) if len(plan) else Action.STOP


def _keep_in_sight(
    navigation: NavigationMap,
    task: FollowTask,
    pose: Pose2D,
    crowd: Sequence[Place],
    action: Action,
) -> Action:
    """The action, unless it would lose from view a person who is near and not behind a wall.

    Then, too far off, a step towards the person, else a turn that faces it. The person is the last
    of the crowd.
    """
    person, limit = crowd[-1], math.radians(SIGHT_DEGREES)
    away = math.dist(person, (pose.x, pose.y))
    if away > SIGHT_REACH or not is_line_free(navigation.grid, person, (pose.x, pose.y)):
        return action

    def bearing(at: Pose2D) -> float:
        return wrap_angle(math.atan2(person[1] - at.y, person[0] - at.x) - at.yaw)

    if abs(bearing(after_action(pose, action, task.agent))) <= limit:
        return action
    step = after_action(pose, Action.FORWARD, task.agent)
    nears = math.dist(person, (step.x, step.y)) < away - task.agent.forward_step / 2
    if (
        nears
        and abs(bearing(step)) <= limit
        and away > task.distance + task.settings.stop_distance
        and is_clear(pose, crowd, task.agent, task.person_radius)
        and not navigation.move(pose.x, pose.y, step.x, step.y)[2]
    ):
        return Action.FORWARD
    return _face(bearing(pose), task.agent)


def _face(bearing: float, agent: AgentSpec) -> Action:
    """Turn towards a bearing [rad], or stand where half a turn would be too much."""
    if abs(bearing) <= math.radians(agent.turn_degrees) / 2 * (1 + 1e-9):
        return Action.STOP
    return Action.LEFT if bearing > 0 else Action.RIGHT


def after_action(pose: Pose2D, action: Action, agent: AgentSpec) -> Pose2D:
    """Where an action leads that nothing cuts short."""
    if action == Action.FORWARD:
        return Pose2D(*step_forward(*pose, agent.forward_step), pose.yaw)
    turns = (action == Action.LEFT) - (action == Action.RIGHT)
    return Pose2D(pose.x, pose.y, wrap_angle(pose.yaw + turns * math.radians(agent.turn_degrees)))


def is_clear(pose: Pose2D, people: Sequence[Place], agent: AgentSpec, person_radius: float) -> bool:
    """Whether FORWARD keeps a margin of 0.10 m from everybody's disc, or leads away from them."""
    end = after_action(pose, Action.FORWARD, agent)
    least = agent.radius + person_radius + MARGIN
    for person in people:
        along = (person[0] - pose.x) * math.cos(pose.yaw) + (person[1] - pose.y) * math.sin(
            pose.yaw
        )
        walked = min(max(along, 0.0), agent.forward_step)
        x, y = step_forward(*pose, walked)
        nearest = math.dist((x, y), person)
        if nearest < least and nearest < math.dist((pose.x, pose.y), person):
            return False
        if math.dist((end.x, end.y), person) < least and along > 0:
            return False
    return True


def people_map(navigation: NavigationMap, places: Sequence[Place], radius: float) -> NavigationMap:
    """The map with people who stand there as obstacles of a radius [m]."""
    grid = navigation.grid
    rows, cols = np.indices(grid.shape)
    x = grid.origin[0] + (cols + 0.5) * grid.resolution
    y = grid.origin[1] + (rows + 0.5) * grid.resolution
    cells = grid.cells.copy()
    for px, py in places:
        cells[(x - px) ** 2 + (y - py) ** 2 <= radius**2] = OCCUPIED
    return NavigationMap(OccupancyGrid(cells, grid.resolution, grid.origin), navigation.radius)


class FollowOracle:
    """Follows step by step: remembers who has been in the way, and goes round who stands there.

    Args:
        navigation: map of the scene, inflated for the agent.
        task: whom it follows, and how.
        patience: seconds in which somebody must not have moved to count as standing.
    """

    def __init__(self, navigation: NavigationMap, task: FollowTask, patience: float = 1.0) -> None:
        self.navigation, self.task = navigation, task
        self.patience = patience
        self._still: list[tuple[Place, float]] = []  # where each of the others is, since when
        self._around: tuple[tuple[Place, ...], NavigationMap] = ((), navigation)

    def act(self, pose: Pose2D, time: float, others: Sequence[Place] = ()) -> Action:
        """The next action; `others` are the places (x, y) m of everybody but the person, by number.

        Raises:
            PlanError: the agent is cut off from the trail.
        """
        walked = self._map_around(pose, time, others)
        here = self.task.track.place_at(time)
        try:
            return choose_following(walked, self.task, pose, time, [here, *others])
        except PlanError:  # shut in by people: wait for them
            if walked is self.navigation:
                raise
            return choose_following(self.navigation, self.task, pose, time, [here, *others])

    def _map_around(self, pose: Pose2D, time: float, others: Sequence[Place]) -> NavigationMap:
        before = self._still
        self._still = [
            before[k] if k < len(before) and before[k][0] == place else (place, time)
            for k, place in enumerate(others)
        ]
        standing = tuple(
            place
            for place, since in self._still
            if time - since >= self.patience and math.dist(place, (pose.x, pose.y)) <= AROUND
        )
        if standing != self._around[0]:
            radius = self.task.person_radius + MARGIN
            around = people_map(self.navigation, standing, radius) if standing else self.navigation
            self._around = (standing, around)
        walked = self._around[1]
        return walked if walked.is_free(pose.x, pose.y) else self.navigation
