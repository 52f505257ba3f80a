"""The simulator: one agent in one scene, driven by actions, answering with observations.

Time is counted in actions: each takes the body's `step_seconds`, half a second for most (the 0.25 m
of a FORWARD at 0.5 m/s), whether it moves, turns or collides. A Teleport or Displacement lasts as
many actions as the body would need to turn and walk there, and takes as many steps, unless moves
are said to take one step: then it lasts as long and counts as one. Nothing survives from one
episode to the next.
"""

from __future__ import annotations

import math
import operator
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from gn0.config import whole_number
from gn0.errors import EpisodeError, SimError, brief
from gn0.geometry import F32, U8, Pose2D, wrap_angle
from gn0.missions.episode import (
    AgentSpec,
    Episode,
    GoalPicture,
    MissionFollow,
    MissionGoal,
    check_episode,
)
from gn0.people.person import RADIUS
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.collision import Move, check_finite, check_places, move_agent
from gn0.sim.history import History
from gn0.sim.kinematics import Heading, heading_yaw, plan_journey, step_forward
from gn0.sim.mapping import Mapper
from gn0.sim.motion import Moment
from gn0.sim.noise import sample_move
from gn0.sim.people import Company, PersonHit
from gn0.sim.sensors import SensorConfig, SensorSuite
from gn0.sim.standpoint import Standpoint
from gn0.sim.state import (
    OBSERVED,
    Action,
    AnyAction,
    Displacement,
    Observation,
    StepResult,
    Teleport,
)
from gn0.sim.state import (
    STEP_SECONDS as STEP_SECONDS,
)
from gn0.sim.ticks import cut_journey, cut_move

MOVE_CODE = -1  # a Teleport or Displacement among codes of actions

if TYPE_CHECKING:
    from gn0.avatars.bank import AvatarBank
    from gn0.maps.explored import ExploredState
    from gn0.maps.navigation import NavigationMap
    from gn0.people.crowd import CrowdState
    from gn0.render.bev import BevPicture
    from gn0.render.instance import Instance
    from gn0.render.light import LightCondition
    from gn0.render.renderer import DrawnScene
    from gn0.sim.motion import Motion
    from gn0.sim.people_eyes import PeopleEyes


@dataclass(frozen=True, eq=False)
class SimState:
    """Everything that changes within an episode; see `Simulator.save_state`.

    Attributes:
        episode: the episode in progress.
        wanted: sensors in use.
        x, y: position [m].
        base, turns: heading as base [rad] and whole turns (see `kinematics`).
        steps: steps taken.
        collided: the last action was truncated.
        over: the episode has ended.
        tiles: history tiles, newest first.
        explored: the agent's own map, in map mode `explored`.
        spent: what the steps lasted, in actions: more than `steps` only where moves of any length
            take one step; None: as many.
        people: what the people of the episode do; None where there is nobody.
    """

    episode: Episode
    wanted: frozenset[str]
    x: float
    y: float
    base: float
    turns: int
    steps: int
    collided: bool
    over: bool
    tiles: tuple[U8, ...]
    explored: ExploredState | None = None
    spent: int | None = None
    people: CrowdState | None = None


class Simulator:
    """Moves an agent through a scene and measures what its sensors see.

    Args:
        scene: where.
        navigation: the scene's map, inflated by the agent's radius.
        sensors: what the agent carries.
        renderer: draws rgb, depth and history; not needed without them.
        bev: the map picture for sensor bev.
        agent: the body; the preset's when None. It is the simulator's agent that moves: the one
            in an episode says what the episode was planned for.
        max_steps: steps until an episode is truncated.
        motion: what moves in the scene, by the time since the episode began.
        bank: of the people who have names in one; generated ones need none.
        light: how the renderer's scene is lit, for people in it; as it was made when None.
        one_step_moves: a Teleport or Displacement counts as one step whatever its length, as in
            the paper's global action space; it lasts as long as otherwise.
        person_radius: of people's discs [m].

    Raises:
        SimError: a sensor lacks its renderer or picture, the map was inflated for another
            radius.
        ConfigError: max_steps is not a whole number of at least 1.
        SceneError: ego maps are to be painted by categories, and nothing is labelled.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        navigation: NavigationMap,
        sensors: SensorConfig | None = None,
        renderer: DrawnScene | None = None,
        bev: BevPicture | None = None,
        agent: AgentSpec | None = None,
        max_steps: int = 500,
        one_step_moves: bool = False,
        motion: Motion | None = None,
        bank: AvatarBank | Path | str | None = None,
        light: LightCondition | None = None,
        person_radius: float = RADIUS,
    ) -> None:
        config = sensors or SensorConfig()
        self.scene = scene
        self.navigation = navigation
        self.agent = agent or config.preset.agent
        self.max_steps = whole_number(max_steps, "max_steps")
        self.one_step_moves = one_step_moves
        if abs(navigation.radius - self.agent.radius) > 1e-9:
            raise SimError(
                f"map inflated by {navigation.radius:g} m, agent radius {self.agent.radius:g} m",
                remedy="build the NavigationMap with the agent's radius",
            )
        self._suite = SensorSuite(
            config, navigation, self.agent.camera_height, renderer, bev, motion, scene.objects
        )
        own = weakref.proxy(self)  # no circle: renderers go when simulators do
        self._here = Standpoint(
            self._suite,
            lambda output: own._look()[output],
            lambda: own._history.tiles,
            lambda: own._look_from_goal(),
            lambda: own.look_at_people(),
        )
        self._mapper: Mapper | None = None
        if config.explores:
            self._mapper = Mapper(
                navigation.grid, config.preset, self.agent, config.cut_height,
                coloured="rgb" in config.carried.explored,
            )  # fmt: skip
        self._here.mapper = self._mapper
        self._actuation = config.noise.actuation if config.noise.moves else None
        self._company = Company(navigation, self.agent, person_radius)
        self._here.company = self._company
        self.bank, self._light = bank, light
        self._people: PeopleEyes | None = None
        self._numbers: tuple[int, ...] = ()
        self._episode: Episode | None = None
        self._history = History(size=config.preset.history_tile)
        self._over = True
        self._x = self._y = self._yaw = math.nan  # nowhere yet

    @property
    def sensors(self) -> frozenset[str]:
        """Sensors that can be asked for."""
        return self._suite.active

    @property
    def config(self) -> SensorConfig:
        """Sensor settings, with the camera preset."""
        return self._suite.config

    @property
    def suite(self) -> SensorSuite:
        """The sensors themselves (map frame, pictures at any pose)."""
        return self._suite

    @property
    def episode(self) -> Episode:
        """The episode in progress.

        Raises:
            SimError: before the first reset.
        """
        if self._episode is None:
            raise SimError("no episode yet", remedy="call reset(episode) first")
        return self._episode

    @property
    def pose(self) -> Pose2D:
        """Where the agent stands.

        Raises:
            SimError: before the first reset.
        """
        _ = self.episode
        return Pose2D(self._x, self._y, self._yaw)

    @property
    def heading(self) -> Heading:
        """The pose's yaw as base and whole turns: what LEFT and RIGHT really count.

        Raises:
            SimError: before the first reset.
        """
        _ = self.episode
        return Heading(self._base, self._turns, self.agent.turn_degrees)

    @property
    def steps(self) -> int:
        """Steps taken since reset: one an action, but see `Journey.steps` for moves."""
        return self._steps if self._episode is not None else 0

    @property
    def time(self) -> float:
        """Simulated seconds since reset."""
        return self.agent.time_after(self._spent) if self._episode is not None else 0.0

    @property
    def company(self) -> Company:
        """The people of the episode, and where they are: privileged."""
        return self._company

    @property
    def over(self) -> bool:
        """Whether the episode has ended, or none has begun."""
        return self._over

    def reset(self, episode: Episode, *, sensors: frozenset[str] | None = None) -> Observation:
        """Begin an episode.

        `sensors` narrows what is observed in this episode to a subset of `self.sensors`.

        Raises:
            EpisodeError: of another scene, with NaN, with a blocked or unreachable start or goal,
                or with people who walk through walls.
            SimError: a sensor is asked for that the agent does not carry.
        """
        check_episode(episode)
        wanted = self.sensors if sensors is None else frozenset(sensors)
        self._check_fits(episode, wanted)
        check_places(self.navigation, episode, self.agent.radius)
        self._company.begin(episode)
        if episode.people and self._suite.renderer is not None:
            self._show_people(self._suite.renderer, episode)
        self._episode = episode
        self._want(wanted)
        if self._mapper is not None:
            self._mapper.reset()
        self._steps = self._spent = 0
        self._collided = False
        self._over = False
        self._history.clear()
        self._last_look: tuple[Pose2D, bytes, dict[str, NDArray[Any]]] | None = None
        self._last_who: tuple[Pose2D, bytes, tuple[U8, F32]] | None = None
        self._last_moment: tuple[tuple[object, ...], Moment] | None = None
        self._goal_picture: U8 | None = None
        self._place(episode.start[0], episode.start[1], wrap_angle(episode.start[2]), 0)
        return self._observe()

    def step(self, action: AnyAction | int) -> StepResult:
        """Take one action.

        FORWARD, Teleport and Displacement are cut at the first blocked cell (paper, Eq.
        collision); a teleport takes its yaw, a displacement its turn in any case. They take the
        steps of `gn0.sim.kinematics.Journey`, and end where the episode's steps do; cut, they are
        one collision. Each of those steps lasts as long as an action. STOP ends the episode
        (`terminated`), but where a person is to be followed: there it stands still for one action.
        Reaching `max_steps` without an end truncates it.

        With people, a move stops at the tick before it would touch one: `collided`, and
        `info["hit_person"]` is a `gn0.sim.people.PersonHit`, else None; `info["action"]` is the
        action's code, −1 of a move of any length.

        Raises:
            SimError: before reset, after the end, or not a valid action (unknown, holds NaN, or
                leads farther than 10⁹ m).
        """
        if self._over:
            raise SimError(
                "no episode is in progress" if self._episode is None else "the episode is over",
                remedy="call reset(episode) first",
            )
        moved, collided, stop, spent, code = 0.0, False, False, 1, MOVE_CODE
        company, ticks = self._company, self.agent.step_ticks
        company.hit = None
        x, y = self._x, self._y
        if self._actuation is not None and isinstance(action, Displacement | Teleport):
            raise SimError(
                f"a {type(action).__name__} has no noise",
                remedy="give FORWARD, LEFT, RIGHT or STOP, or leave out noise.actuation",
            )
        if isinstance(action, Displacement):
            check_finite("displacement", *action)
            action = action.at(Pose2D(x, y, self._yaw))
        if isinstance(action, Teleport):
            check_finite("teleport", *action)
            self._keep_view()
            moved, collided, spent = self._go(*map(float, action))
        else:
            code = action_code(action)
            if self._keeps_views:
                self._keep_view()
            if self._actuation is not None and code:
                moved, collided = self._slip(code)
            elif code == 1:
                target = step_forward(x, y, self._yaw, self.agent.forward_step)
                move = self._move(*target)
                self._x, self._y, moved, collided = move
            else:
                company.wait(x, y, ticks)
                if code == 0:
                    stop = not isinstance(self.episode.mission, MissionFollow)
                else:
                    self._turn(1 if code == 2 else -1)
        steps = 1 if self.one_step_moves else spent
        self._steps += steps
        self._spent += spent
        self._collided = collided
        truncated = not stop and self._steps >= self.max_steps
        self._over = stop or truncated
        observation = self._observe()
        info: dict[str, Any] = {"pose": self._here.pose}
        if company:
            info |= {"hit_person": company.hit, "action": code}
        return StepResult(observation, moved, collided, stop, truncated, info, steps)

    def _move(self, x1: float, y1: float) -> Move:
        """Move towards (x1, y1) [m] for the time of an action, everybody else with it."""
        if self._company:
            return self._company.move(self._x, self._y, x1, y1)
        return move_agent(self.navigation, self._x, self._y, x1, y1, self.agent)

    def _slip(self, code: int) -> tuple[float, bool]:
        """Do FORWARD, LEFT or RIGHT with the body's noise: metres covered, and whether cut."""
        assert self._actuation is not None
        agent, episode = self.agent, self.episode
        rng = random_stream(episode.seed, "actuation", episode.id, self._steps)
        turn = math.radians(agent.turn_degrees) * (0, 0, 1, -1)[code]
        ahead = agent.forward_step if code == 1 else 0.0
        there = Displacement(*sample_move(self._actuation, ahead, turn, rng)).at(
            Pose2D(self._x, self._y, self._yaw)
        )
        move = self._move(there.x, there.y)
        self._place(move.x, move.y, wrap_angle(there.yaw), 0)
        return move.moved, move.collided

    def _go(self, x1: float, y1: float, yaw: float) -> tuple[float, bool, int]:
        """Move to (x1, y1) [m] and look along `yaw` [rad]: metres covered, cut, actions it took."""
        x, y = self._x, self._y
        move = move_agent(self.navigation, x, y, x1, y1, self.agent)
        journey = plan_journey(Pose2D(x, y, self._yaw), x1, y1, yaw, self.agent)
        steps = journey.steps_until(move.moved) if move.collided else journey.steps
        left = self.max_steps - self._steps
        if steps > left and not self.one_step_moves:  # the episode ends on the way
            steps = left
            gone, yaw = journey.part(left)
            target = step_forward(x, y, journey.bearing, gone)
            x1, y1 = target
            move = move_agent(self.navigation, x, y, x1, y1, self.agent)
        company, ticks = self._company, self.agent.step_ticks
        if company:
            places = (*cut_journey(journey, x, y, x1, y1)[: steps * ticks - 1], (x1, y1))
            move, stopped = company.go(x, y, places)
            if stopped:
                steps = -(-stopped // ticks)
                company.wait(move.x, move.y, steps * ticks - stopped)
        self._place(move.x, move.y, wrap_angle(yaw), 0)
        return move.moved, move.collided, steps

    def observe_at(self, pose: Pose2D) -> Observation:
        """What the agent would see at another pose now; it does not move.

        Raises:
            SimError: before reset, or the pose holds NaN or is farther than 10⁹ m.
        """
        _ = self.episode
        check_finite("pose", *pose)
        kept = self.save_state()
        self._place(float(pose.x), float(pose.y), wrap_angle(float(pose.yaw)), 0)
        try:
            return self._observe()
        finally:
            self.restore_state(kept)

    def foresee_forward(self) -> PersonHit | None:
        """Who would cut a FORWARD of now short; nothing moves. Privileged, and without noise."""
        x, y = self._x, self._y
        there = step_forward(x, y, self._yaw, self.agent.forward_step)
        return self._company.foresee(x, y, cut_move(x, y, *there, self.agent.step_ticks))

    def pose_after(self, action: Action) -> Pose2D:
        """Where an action that nothing cuts short leads from here; nothing moves."""
        if action == Action.FORWARD:
            there = step_forward(self._x, self._y, self._yaw, self.agent.forward_step)
            return Pose2D(*there, self._yaw)
        if action == Action.STOP:
            return self.pose
        turned = self.heading.turned(1 if action == Action.LEFT else -1)
        return Pose2D(self._x, self._y, turned.yaw)

    def save_state(self) -> SimState:
        """The whole state, to be restored later in this simulator.

        Raises:
            SimError: before the first reset.
        """
        return SimState(
            episode=self.episode,
            wanted=self._wanted,
            x=self._x,
            y=self._y,
            base=self._base,
            turns=self._turns,
            steps=self._steps,
            collided=self._collided,
            over=self._over,
            tiles=self._history.tiles,
            explored=None if self._mapper is None else self._mapper.save(),
            spent=self._spent,
            people=self._company.save(),
        )

    def restore_state(self, state: SimState) -> None:
        """Go back to a saved state, bit for bit.

        Raises:
            EpisodeError: of another scene.
            SimError: not a saved state, or of an agent with other sensors.
        """
        if not isinstance(state, SimState):
            raise SimError(
                f"{brief(state)} is not a saved state", remedy="give what save_state() returned"
            )
        self._check_fits(state.episode, state.wanted)
        self._company.restore(state.episode, state.people)
        self._episode = state.episode
        self._want(state.wanted)
        if self._mapper is not None and state.explored is not None:
            self._mapper.restore(state.explored)
        self._steps, self._collided, self._over = state.steps, state.collided, state.over
        self._spent = state.steps if state.spent is None else state.spent
        self._history = History(state.tiles, self.config.preset.history_tile)
        self._last_look = self._last_who = self._last_moment = None
        self._goal_picture = None
        self._place(state.x, state.y, state.base, state.turns)

    def _check_fits(self, episode: Episode, wanted: frozenset[str]) -> None:
        """Refuse another scene's episode, and sensors that the agent does not carry.

        Raises:
            EpisodeError, SimError: of the one and of the other.
        """
        if episode.scene_id != self.scene.id:
            raise EpisodeError(
                f"episode belongs to scene {episode.scene_id!r}, not to {self.scene.id!r}",
                where=f"episode {episode.id!r}",
                remedy="open the simulator with the episode's own scene",
            )
        if not wanted <= self.sensors:
            raise SimError(
                f"sensors {sorted(wanted - self.sensors)} are not carried by this agent",
                remedy="open the simulator with them",
            )

    def _want(self, wanted: frozenset[str]) -> None:
        """Choose what is observed, and what must be drawn for it."""
        self._wanted = wanted
        carried = self._suite.config.carry(wanted)
        self._keeps_views = carried.views
        self._scaled = bool(carried.maps)
        self._maps = self._mapper is not None and self._scaled
        self._outputs = carried.drawn(self._maps)
        self._fields = tuple((s.name, s.read) for s in carried.sensors if s.name in OBSERVED)
        self._others = tuple(
            (s, s.find_space(self._suite.config)) for s in carried.sensors if s.name not in OBSERVED
        )

    def _place(self, x: float, y: float, base: float, turns: int) -> None:
        self._x, self._y, self._base, self._turns = x, y, base, turns
        self._turn(0)

    def _turn(self, turns: int) -> None:
        self._turns += turns
        self._yaw = heading_yaw(self._base, self._turns, self.agent.turn_degrees)

    def _look(self) -> dict[str, NDArray[Any]]:
        """Pictures here and now; not drawn again while nothing moves, the agent included."""
        pose, last = Pose2D(self._x, self._y, self._yaw), self._last_look
        moment = self._moment(pose)
        if last is None or last[0] != pose or last[1] != moment.key:
            last = (pose, moment.key, self._suite.look(pose, self._outputs, moment))
            self._last_look = last
        return last[2]

    def _moment(self, pose: Pose2D) -> Moment:
        """Whatever moves, people among it, as an eye at a pose sees it now."""
        moment = self._suite.moment_at(self.agent.time_after(self._spent))
        if not self._company or self._people is None:
            return moment
        state = self._company.state
        now = pose, moment.time, state.real.tobytes(), state.whole.tobytes()
        if self._last_moment is None or self._last_moment[0] != now:
            parts, self._numbers, key = self._people.show(
                self._company, pose, self.config.preset.rgb.fx, self._suite.sight
            )
            self._last_moment = now, Moment(moment.time, (*moment.parts, *parts), key)
        return self._last_moment[1]

    def _show_people(self, renderer: DrawnScene, episode: Episode) -> None:
        """Make sure that the people of an episode can be shown.

        Raises:
            EpisodeError: nobody plays one of them.
        """
        if self._people is None:
            from gn0.sim.people_eyes import PeopleEyes  # bodies are needed only for pictures

            self._people = PeopleEyes(self.scene, renderer, self.bank, self._light)
        self._people.cast.check(episode.people, f"episode {episode.id!r}")

    def look_at_people(self) -> tuple[U8, F32]:
        """Who is in the agent's picture: person numbers [H, W], and what is seen of each [16, 6].

        Privileged, as the sensors `who` and `people_seen` are; nobody without a renderer. Not drawn
        again while nothing moves.
        """
        pose, last = Pose2D(self._x, self._y, self._yaw), self._last_who
        moment = self._moment(pose)
        if last is None or last[0] != pose or last[1] != moment.key:
            self._last_who = last = (pose, moment.key, self._who(pose, moment))
        picture, table = last[2]
        return picture.copy(), table.copy()

    def show_people(self, pose: Pose2D, focal: float) -> tuple[Instance, ...]:
        """What moves, people among it, as an eye at a pose sees it now: `parts` for a renderer.

        Privileged. Nobody where nothing is drawn for the agent. The renderer knows their clouds
        until others are asked for.

        Args:
            pose: of the eye.
            focal: of its picture [px], which decides levels of detail.

        Raises:
            SimError: before the first reset.
        """
        _ = self.episode
        moment = self._suite.moment_at(self.agent.time_after(self._spent))
        if not self._company or self._people is None:
            return moment.parts
        self._last_moment = None  # those clouds may go
        return (*moment.parts, *self._people.show(self._company, pose, focal)[0])

    def _who(self, pose: Pose2D, moment: Moment) -> tuple[U8, F32]:
        from gn0.sim.people_eyes import read_who

        return read_who(self._suite, pose, moment.parts if self._company else (), self._numbers)

    def _look_from_goal(self) -> U8:
        """The goal picture; drawn once an episode."""
        if self._goal_picture is None:
            record, goal = goal_record(self.episode), goal_view(self.episode)
            self._goal_picture = self._suite.look_at_goal(record, goal)
        return self._goal_picture

    def _keep_view(self) -> None:
        if self._keeps_views:
            self._history.add(self._look()["rgb"])

    def _observe(self) -> Observation:
        assert self._episode is not None
        step, time = self._steps, self.agent.time_after(self._spent)
        here = self._here
        here.pose = pose = Pose2D(self._x, self._y, self._yaw)
        if not self._wanted:
            return Observation(step, time, self._episode.instruction, collided=self._collided)
        episode = self._episode
        if self._maps and self._mapper is not None:
            seen = self._look()
            moving = self._suite.motion is not None or bool(episode.people)
            self._mapper.update(pose, seen["depth"], seen.get("rgb"), time if moving else None)
        here.episode, here.steps, here.time = episode, step, time
        fields: dict[str, Any] = {name: read(here) for name, read in self._fields}
        if self._scaled:
            frame = self._suite.map_frame
            fields["bev_metres_per_pixel"] = frame.metres_per_pixel
            fields["map_origin"] = frame.x_min, frame.y_min
        if self._others:
            fields["more"] = {s.name: s.measure(here, space) for s, space in self._others}
        return Observation(
            step=step,
            time=time,
            instruction=episode.instruction,
            collided=self._collided,
            **fields,
        )


def goal_record(episode: Episode) -> GoalPicture | None:
    """How an episode says that its goal picture is taken; None when it does not."""
    return episode.mission.picture if isinstance(episode.mission, MissionGoal) else None


def goal_view(episode: Episode) -> Pose2D:
    """Where a goal picture without a record is taken: at the goal, looking somewhere."""
    yaw = random_stream(episode.seed, "goal picture", episode.id).uniform(-math.pi, math.pi)
    return Pose2D(*episode.goal, yaw)


def action_code(action: Action | int) -> int:
    """The code 0..3 of a local action.

    Raises:
        SimError: it is not an action.
    """
    if type(action) is int and 0 <= action <= 3:  # what most callers give
        return action
    try:
        code = operator.index(action)
    except TypeError:
        code = -1
    if not 0 <= code <= 3 or isinstance(action, bool):
        raise SimError(
            f"{action!r} is not an action",
            remedy="give STOP 0, FORWARD 1, LEFT 2, RIGHT 3, a Teleport or a Displacement",
        )
    return code
