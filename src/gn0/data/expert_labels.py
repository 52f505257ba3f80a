"""What the expert would do: the next six actions and the next three metres, from any state.

Actions come from `gn0.maps.pose_astar`, the planner of the oracle: whole plans from the exact pose
under the simulator's own collision rule, so executing the labels is what the oracle does. The other
planner of actions, `gn0.maps.lattice`, follows a path it is given over a short horizon: right for a
robot with a route, but a label made with it would end with the horizon. Its exact states serve the
variant `mpc`.

Variants:
    exact: the plan of least length to within `stop_distance` of the goal, then STOP.
    mpc: the paper's discounted tracking objective (Eq. mpc_action), see `gn0.data.tracking`.
    gn0-release: exact, but STOP from the first place within 1 m of the goal as the crow flies, as
        the official release labels.
    field: one step ahead on the distance field, see `gn0.maps.field_expert`: nothing is searched,
        so it is quick, and `VectorEnvDevice.labels` gives the same bits on a GPU.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.config import Config
from gn0.data.field_labels import label_poses, walk_from
from gn0.data.tracking import plan_tracking
from gn0.data.waypoints import sample_way_points
from gn0.errors import PlanError
from gn0.geometry import F32, F64, wrap_angle
from gn0.maps.distance import GeodesicField
from gn0.maps.field_expert import ROUNDING, STOP_DISTANCE
from gn0.maps.goal_places import GoalSet
from gn0.maps.navigation import NavigationMap
from gn0.maps.pose_astar import plan_actions
from gn0.maps.ray import is_line_free, trace_move
from gn0.missions.episode import AgentSpec, Episode
from gn0.paper import ACTIONS_AHEAD, POINTS
from gn0.sim.collision import move_agent
from gn0.sim.kinematics import Heading, heading_cycle, step_forward
from gn0.sim.state import Action

LabelVariant = Literal["exact", "mpc", "gn0-release", "field"]
# plans from arbitrary states: at most 2 % dearer than the best, found four times as quickly
STATE_WEIGHT, STATE_SUBCELLS = 1.02, 1
ESCAPE_STEPS = 6  # steps, cut short or not, that may lead out of a nook
I8 = NDArray[np.int8]


class LabelSettings(Config, frozen=True):
    """What a label says.

    Attributes:
        variant: see the module.
        stop_distance: STOP within this walking distance of the goal, in line of sight [m].
        turn_cost: price of a turn against travelled length [m]; `field` has its own, a quarter.
        horizon: actions that `mpc` looks ahead.
        discount: γ of `mpc`.
        release_stop: where `gn0-release` says STOP, as the crow flies [m].
        inside: where the goal is an area, how far behind its entrance it begins [m]; unset in files
            where it is 0.
    """

    variant: LabelVariant = "exact"
    stop_distance: Annotated[float, msgspec.Meta(gt=0, le=10)] = STOP_DISTANCE
    turn_cost: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.02
    horizon: Annotated[int, msgspec.Meta(ge=6, le=14)] = 8
    discount: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.95
    release_stop: Annotated[float, msgspec.Meta(gt=0, le=10)] = 1.0
    inside: Annotated[float, msgspec.Meta(ge=0, le=5)] | msgspec.UnsetType = msgspec.UNSET

    def __post_init__(self) -> None:
        if self.inside == 0:  # one way to say it
            msgspec.structs.force_setattr(self, "inside", msgspec.UNSET)

    @property
    def depth(self) -> float:
        """How far behind its entrance an area begins [m]."""
        return 0.0 if self.inside is msgspec.UNSET else self.inside


EXACT = LabelSettings()
DEFAULT_BODY = AgentSpec()


@dataclass(frozen=True, eq=False)
class Labels:
    """Labels of N states.

    Attributes:
        actions6: [N, 6] int8 what to do next; STOP from the end on.
        waypoints: [N, 13, 2] float32 m in the agent's frame, x forward and y left: its own place,
            then the way ahead at 0.25 m of arc length, the goal repeated where it is nearer.
        valid: [N] int8 how many waypoints are not repetitions.
    """

    actions6: I8
    waypoints: F32
    valid: I8

    def __len__(self) -> int:
        return len(self.valid)


def plan_expert(
    navigation: NavigationMap, episode: Episode, settings: LabelSettings = EXACT
) -> tuple[F64, I8]:
    """The expert's walk through an episode: the same actions as the policy `oracle`.

    With variant `field` it is the walk of its own labels, some of whose steps may be cut short.

    Returns:
        (poses float64 [T+1, 3] x, y [m], yaw [rad], before each action and after the last;
        actions int8 [T], the last one STOP).

    Raises:
        PlanError: the goal cannot be reached.
    """
    x, y, yaw = episode.start
    if settings.variant == "field":
        field = navigation.geodesic(episode.destination)
        near = settings.stop_distance - ROUNDING
        plan = walk_from(field, np.array(episode.start), episode.agent, near)
        actions = np.append(plan, np.int8(Action.STOP))
        return walk_actions(navigation, episode.agent, episode.start, actions)[0], actions
    plan = plan_actions(
        navigation.geodesic(episode.destination),
        (x, y),
        heading_cycle(Heading(wrap_angle(yaw), 0, episode.agent.turn_degrees)),
        tolerance=settings.stop_distance - ROUNDING,
        step=episode.agent.forward_step,
        turn_cost=settings.turn_cost,
    )
    actions = np.append(plan, np.int8(Action.STOP))
    poses, collided = walk_actions(navigation, episode.agent, episode.start, actions)
    if collided.any():
        raise PlanError(
            f"action {int(np.argmax(collided))} of the plan is cut short",
            where=f"episode {episode.id!r}",
            remedy="report this: planner and simulator disagree",
        )
    return poses, actions


def walk_actions(
    navigation: NavigationMap,
    agent: AgentSpec,
    start: tuple[float, float, float] | NDArray[np.floating],
    actions: NDArray[np.integer],
) -> tuple[F64, NDArray[np.bool_]]:
    """Where actions lead, by the simulator's rule of motion.

    Returns:
        (poses [T+1, 3] x, y [m], yaw [rad]; [T] whether each action was cut short).
    """
    x, y, yaw = (float(v) for v in start)
    heading = Heading(wrap_angle(yaw), 0, agent.turn_degrees)
    poses = np.empty((len(actions) + 1, 3))
    collided = np.zeros(len(actions), np.bool_)
    poses[0] = x, y, heading.yaw
    for i, action in enumerate(actions.tolist()):
        if action == Action.FORWARD:
            target = step_forward(x, y, heading.yaw, agent.forward_step)
            x, y, _, collided[i] = move_agent(navigation, x, y, *target, agent)
        elif action != Action.STOP:
            heading = heading.turned(1 if action == Action.LEFT else -1)
        poses[i + 1] = x, y, heading.yaw
    return poses, collided


def label_along(
    navigation: NavigationMap,
    episode: Episode,
    poses: NDArray[np.floating],
    actions: NDArray[np.integer],
    settings: LabelSettings = EXACT,
) -> Labels:
    """Labels along a walk that ends at the goal: what follows in it, and the way ahead.

    Args:
        navigation: map of the episode's scene, inflated for its agent.
        episode: whose goal it is.
        poses: [T+1, 3] or [T, 3] x, y [m], yaw [rad] of an expert's walk.
        actions: [T] its actions.
        settings: with variants `mpc` and `field` each pose is labelled anew.

    Raises:
        PlanError: a pose is blocked or cut off; names the row.
    """
    states = np.ascontiguousarray(poses, np.float64).reshape(-1, 3)[: len(actions)]
    field = navigation.geodesic(episode.destination)
    if settings.variant == "field":
        return _by_field(field, states, settings, episode.agent)
    waypoints, valid = sample_way_points(field, states)
    if settings.variant == "mpc":
        ahead = _track(field, episode.agent, states, waypoints, valid, settings)
    else:
        ahead = window_actions(np.asarray(actions, np.int8))
        if settings.variant == "gn0-release":
            ahead = cut_at(ahead, field, states, episode.agent, settings.release_stop)
    return Labels(ahead, waypoints, valid)


def window_actions(actions: NDArray[np.integer]) -> I8:
    """The six actions from each step on [T, 6], filled up with STOP."""
    out = np.zeros((len(actions), ACTIONS_AHEAD), np.int8)
    for k in range(min(ACTIONS_AHEAD, len(actions))):
        out[: len(actions) - k, k] = actions[k:]
    return out


def label_states(
    navigation: NavigationMap,
    goal: Episode | tuple[float, float] | GoalSet,
    poses: NDArray[np.floating],
    settings: LabelSettings = EXACT,
    *,
    agent: AgentSpec | None = None,
) -> Labels:
    """Labels of arbitrary states.

    Args:
        navigation: map of the scene, inflated for the agent.
        goal: an episode, (x, y) m, or a set of places.
        poses: [N, 3] x, y [m], yaw [rad].
        settings: see `LabelSettings`.
        agent: by default the episode's, else the default body.

    Raises:
        PlanError: a state is blocked or cut off; names the row.
    """
    body = agent or (goal.agent if isinstance(goal, Episode) else DEFAULT_BODY)
    field = navigation.geodesic(goal.destination if isinstance(goal, Episode) else goal)
    states = np.ascontiguousarray(poses, np.float64).reshape(-1, 3)
    if settings.variant == "field":
        return _by_field(field, states, settings, body)
    waypoints, valid = sample_way_points(field, states)
    if settings.variant == "mpc":
        return Labels(_track(field, body, states, waypoints, valid, settings), waypoints, valid)
    ahead = np.zeros((len(states), ACTIONS_AHEAD), np.int8)
    for i, state in enumerate(states):
        try:
            plan = plan_from(field, state, settings, body)[:ACTIONS_AHEAD]
        except PlanError as error:
            raise PlanError(error.what, where=f"state {i}", remedy=error.remedy) from None
        ahead[i, : len(plan)] = plan
    if settings.variant == "gn0-release":
        ahead = cut_at(ahead, field, states, body, settings.release_stop)
    return Labels(ahead, waypoints, valid)


def _by_field(
    field: GeodesicField, states: F64, settings: LabelSettings, agent: AgentSpec
) -> Labels:
    found = label_poses(field, states, agent, settings.stop_distance - ROUNDING)
    return Labels(found.actions, found.waypoints, found.valid)


def plan_from(
    field: GeodesicField,
    state: NDArray[np.floating],
    settings: LabelSettings = EXACT,
    agent: AgentSpec = DEFAULT_BODY,
) -> I8:
    """The expert's plan [T] from one state x, y [m], yaw [rad], without the STOP at its end.

    Where whole steps do not lead out of a nook (an agent gets there by steps cut short), the plan
    begins with the fewest steps that may be cut short, too. With variant `field` it is that
    expert's own walk.

    Raises:
        PlanError: no plan exists.
    """
    if settings.variant == "field":
        return walk_from(field, state, agent, settings.stop_distance - ROUNDING)
    x, y, yaw = (float(v) for v in state)
    try:
        return _plan_whole(field, x, y, yaw, settings, agent)
    except PlanError:
        if not math.isfinite(field.distance_at(x, y)):
            raise
        return _escape(field, x, y, yaw, settings, agent)


def _plan_whole(
    field: GeodesicField, x: float, y: float, yaw: float, settings: LabelSettings, agent: AgentSpec
) -> I8:
    return plan_actions(
        field,
        (x, y),
        heading_cycle(Heading(wrap_angle(yaw), 0, agent.turn_degrees)),
        tolerance=settings.stop_distance - ROUNDING,
        step=agent.forward_step,
        turn_cost=settings.turn_cost,
        weight=STATE_WEIGHT,
        subcells=STATE_SUBCELLS,
    )


def _escape(
    field: GeodesicField, x: float, y: float, yaw: float, settings: LabelSettings, agent: AgentSpec
) -> I8:
    """A plan that bumps its way out of a nook: breadth first over steps, nearest the goal first."""
    grid = field.grid
    heading = Heading(wrap_angle(yaw), 0, agent.turn_degrees)
    circle = len(heading_cycle(heading))
    turns = sorted(range(-(circle // 2), circle - circle // 2), key=lambda k: (abs(k), k))
    layer: list[tuple[float, float, int, list[int]]] = [(x, y, 0, [])]
    seen = {grid.cell_of(x, y)}
    for _ in range(ESCAPE_STEPS):
        reached: list[tuple[float, float, int, list[int]]] = []
        for px, py, turned, plan in layer:
            for k in turns:
                here = heading.turned(turned + k)
                target = step_forward(px, py, here.yaw, agent.forward_step)
                qx, qy, _ = trace_move(grid, (px, py), target)
                if grid.cell_of(qx, qy) in seen:
                    continue
                seen.add(grid.cell_of(qx, qy))
                code = Action.LEFT if k > 0 else Action.RIGHT
                steps = [*plan, *[int(code)] * abs(k), int(Action.FORWARD)]
                reached.append((qx, qy, turned + k, steps))
        reached.sort(key=lambda state: (field.distance_at(state[0], state[1]), len(state[3])))
        for qx, qy, turned, plan in reached:
            with contextlib.suppress(PlanError):
                yaw = heading.turned(turned).yaw
                rest = _plan_whole(field, qx, qy, yaw, settings, agent)
                return np.append(np.array(plan, np.int8), rest)
        layer = reached
    raise PlanError(
        f"no actions lead from ({x:g}, {y:g}) to within {settings.stop_distance:g} m of "
        f"{field.goal}",
        remedy="label states that the agent can reach, or give it smaller steps",
    )


def is_arrived(field: GeodesicField, x: float, y: float, stop_distance: float) -> bool:
    """Whether the expert stops at (x, y) m: near the goal on foot, and in sight of it."""
    near = stop_distance - ROUNDING
    if field.inside is not None:
        return field.is_inside(x, y)
    if field.distance_at(x, y) > near:
        return False
    return any(
        math.hypot(x - gx, y - gy) <= near and is_line_free(field.grid, (x, y), (gx, gy))
        for gx, gy in field.goals.tolist()
    )


def cut_at(actions: I8, field: GeodesicField, states: F64, agent: AgentSpec, radius: float) -> I8:
    """Actions [N, 6] with STOP from the first place on that is within `radius` [m] of the goal.

    As the crow flies, or in the area that is the goal; the actions must not be cut short by
    obstacles.
    """
    radius = radius if field.inside is None else 0.0
    yaw = states[:, 2].copy()
    places = states[:, :2].copy()
    out = np.asarray(actions, np.int8).copy()
    inside = field.straight(places) <= radius
    turn = math.radians(agent.turn_degrees)
    for k in range(out.shape[1]):
        out[inside, k] = Action.STOP
        forward = out[:, k] == Action.FORWARD
        places[forward, 0] += agent.forward_step * np.cos(yaw[forward])
        places[forward, 1] += agent.forward_step * np.sin(yaw[forward])
        yaw += turn * ((out[:, k] == Action.LEFT) * 1.0 - (out[:, k] == Action.RIGHT) * 1.0)
        inside |= field.straight(places) <= radius
    return out


def _track(
    field: GeodesicField,
    agent: AgentSpec,
    states: F64,
    waypoints: F32,
    valid: I8,
    settings: LabelSettings,
) -> I8:
    """Actions [N, 6] by the tracking objective over the way ahead of each state."""
    near = settings.stop_distance - ROUNDING
    out = np.zeros((len(states), ACTIONS_AHEAD), np.int8)
    for i, (x, y, yaw) in enumerate(states.tolist()):
        if is_arrived(field, x, y, settings.stop_distance):
            continue
        ahead = waypoints[i, : int(valid[i])].astype(np.float64)
        ends_at_goal = int(valid[i]) < POINTS or field.distance_at(x, y) <= 3.0
        if field.inside is not None:  # only inside is there: no stop before the way's end
            near = 0.5 * field.grid.resolution
        plan = plan_tracking(
            field.grid,
            (x, y, yaw),
            ahead,
            stop_distance=near if ends_at_goal else 0.0,
            step=agent.forward_step,
            turn_degrees=agent.turn_degrees,
            horizon=settings.horizon,
            discount=settings.discount,
        )[:ACTIONS_AHEAD]
        out[i, : len(plan)] = plan
    return out
