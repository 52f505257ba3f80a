"""Episodes: scene, mission, start, reference path. Values only; files are read elsewhere."""

from __future__ import annotations

import math
import sys
from itertools import chain
from typing import Literal, get_args

import msgspec

from gn0.errors import EpisodeError, brief
from gn0.geometry import Pose2D
from gn0.maps.goal_places import GoalSet, GoalSetInner
from gn0.missions.people import check_people_of
from gn0.paper import BODY_RADIUS, EYE_HEIGHT, FORWARD_STEP, TURN_DEGREES
from gn0.people.person import PEOPLE_MOST, EpisodePerson
from gn0.render.light import LightCondition


class GoalPicture(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a goal picture is taken: stored in place of the picture, which is drawn from it.

    Attributes:
        kind: "view", what the agent would see on arrival; "crop", the target alone, cut out.
        eye: camera (x, y, z) [m].
        yaw: direction of view [rad].
        pitch: how far it looks up [rad].
        hfov: horizontal field of view [degrees], less than the agent's own for a crop; 0 is the
            agent's own. Its picture has the size of the agent's pictures in any case.
    """

    kind: Literal["view", "crop"]
    eye: tuple[float, float, float]
    yaw: float
    pitch: float = 0.0
    hfov: float = 0.0

    def __post_init__(self) -> None:
        values = (*self.eye, self.yaw, self.pitch, self.hfov)
        if not all(map(math.isfinite, values)):
            raise EpisodeError("goal picture holds NaN or infinity")
        if not (abs(self.pitch) < math.pi / 2 and (self.hfov == 0 or 1 <= self.hfov <= 170)):
            raise EpisodeError(
                f"goal picture looks up {self.pitch} rad with a field of view of {self.hfov}°"
            )


class MissionGoal(msgspec.Struct, frozen=True, kw_only=True, tag="goal"):
    """Go to a semantic target: goal (x, y) [m] snapped to walkable ground beside the object.

    Attributes:
        goal: where one stands to be there [m].
        object_id: the target; a room's id where the goal is a room.
        category: its category, or the type of the room.
        instruction: never empty: "Go to the sofa in the living room."
        picture: how the goal picture is taken; None takes it at the goal, looking in a direction
            drawn by the episode's seed.
    """

    goal: tuple[float, float]
    object_id: str
    category: str
    instruction: str
    picture: GoalPicture | None = None


class MissionInstruction(msgspec.Struct, frozen=True, kw_only=True, tag="instruction"):
    """Follow a route instruction to goal (x, y) [m].

    Attributes:
        goal: where the route ends [m].
        instruction: the route in words.
        object_id: what stands there, where known.
        category: its category.
        style: "detailed" or "benchmark" for generated texts, "" for others.
    """

    goal: tuple[float, float]
    instruction: str
    object_id: str = ""
    category: str = ""
    style: str = ""


FollowCategory = Literal["", "cruise", "turn", "stop-and-go"]
FollowLevel = Literal["", "single", "distractors", "ambiguous"]


class MissionFollow(msgspec.Struct, frozen=True, kw_only=True, tag="follow"):
    """Follow a moving person; STOP stands still for one action and ends nothing.

    Files of before these had more than three fields leave the others as they are by default.

    Attributes:
        goal: where the person ends (x, y) [m].
        instruction: whom to follow, in words.
        human: the person's identity.
        person: its number among the episode's people; 0 when not told.
        category: how it walks; "" when not told.
        level: who else is there: nobody, others who look different, others who differ in one
            word; "" when not told.
        distance: that the agent should keep [m]; 0 when not told.
        lateral: how far to the person's right it should keep [m].
        seconds: when the person arrives, if nobody holds it up [s].
        actions: those of the reference track of the agent, a digit each, to the episode's end.

    Raises:
        EpisodeError: a value that has no meaning.
    """

    goal: tuple[float, float]
    instruction: str
    human: str
    person: int = 0
    category: FollowCategory = ""
    level: FollowLevel = ""
    distance: float = 0.0
    lateral: float = 0.0
    seconds: float = 0.0
    actions: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.person <= PEOPLE_MOST:
            raise _follow_fault("person", self.person, f"a number up to {PEOPLE_MOST}")
        for name, most in (("distance", 10.0), ("seconds", 3600.0)):
            if not 0 <= getattr(self, name) <= most:
                raise _follow_fault(name, getattr(self, name), f"0 to {most:g}")
        if not -5 <= self.lateral <= 5:
            raise _follow_fault("lateral", self.lateral, "-5 to 5 m")
        for name, known in (("category", FollowCategory), ("level", FollowLevel)):
            if getattr(self, name) not in get_args(known):
                raise _follow_fault(name, getattr(self, name), ", ".join(get_args(known)[1:]))
        if len(self.actions) > 10_000 or not set(self.actions) <= set("0123"):
            raise _follow_fault("actions", self.actions, "digits 0 to 3, an action each")

    @property
    def reference_actions(self) -> tuple[int, ...]:
        """Codes of the reference's actions."""
        return tuple(map(int, self.actions))


def _follow_fault(field: str, value: object, give: str) -> EpisodeError:
    return EpisodeError(
        f"{field} is {brief(value)}", where=f"follow mission, {field}", remedy=f"give {give}"
    )


INSIDE = sys.float_info.min  # m: less than this is 0
VISIBLE_FROM_ABOVE = "visible from above"
STEP_SECONDS = 0.5  # that an action takes unless the body says otherwise
TICKS_A_SECOND = 10  # people move in ticks: an action takes a whole number of them
LONGEST_STEP = 60.0  # s
PathSource = Literal["", "truth", "file", "resampled"]
Mission = MissionGoal | MissionInstruction | MissionFollow


def mission_kind(mission: Mission) -> str:
    """A mission's kind: "goal", "instruction" or "follow"."""
    return str(mission.__struct_config__.tag)


def mission_name(mission: Mission) -> str:
    """A mission's kind, with the style of a route instruction: "goal", "instruction/detailed"."""
    kind = mission_kind(mission)
    style = mission.style if isinstance(mission, MissionInstruction) else ""
    return f"{kind}/{style}" if style else kind


class AgentSpec(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """An embodiment: what collides, where the eye is, how far an action goes and how long it takes.

    Attributes:
        radius: footprint radius [m]; 0.20 unless given.
        camera_height: eye above the floor [m]; 1.30 unless given.
        forward_step: length of FORWARD [m]; 0.25 unless given.
        turn_degrees: angle of LEFT and RIGHT [degrees]; 15 unless given.
        sliding: what is left of a cut move goes on along the wall (`gn0.maps.slide`); not there
            for bodies that stop at it, which is the paper's Eq. collision.
        step_seconds: simulated time that an action takes [s], a multiple of 0.1 up to 60. At its
            default it stands in no file and no hash, so that those of before there was one stay.

    Raises:
        EpisodeError: a value out of range, or a time that is not a multiple of 0.1 s.
    """

    # Defaults by a factory are always written, and so is all that files have always had; of
    # `step_seconds` alone msgspec knows the default, and leaves it out.
    radius: float = msgspec.field(default_factory=lambda: BODY_RADIUS)
    camera_height: float = msgspec.field(default_factory=lambda: EYE_HEIGHT)
    forward_step: float = msgspec.field(default_factory=lambda: FORWARD_STEP)
    turn_degrees: float = msgspec.field(default_factory=lambda: TURN_DEGREES)
    sliding: bool | msgspec.UnsetType = msgspec.UNSET
    step_seconds: float = STEP_SECONDS

    def __post_init__(self) -> None:
        if not self.sliding:  # one way to say no, and suites keep the hash that they had
            msgspec.structs.force_setattr(self, "sliding", msgspec.UNSET)
        if not (0 <= self.radius <= 5 and 0 < self.camera_height <= 10):
            raise EpisodeError(f"agent radius {self.radius} m or camera {self.camera_height} m")
        if not (0 < self.forward_step <= 10 and 0 < self.turn_degrees <= 180):
            raise EpisodeError(f"agent step {self.forward_step} m, turn {self.turn_degrees}°")
        # one float for each duration: 3 * 0.1 is 0.3, and half a second is the default itself
        msgspec.structs.force_setattr(self, "step_seconds", _whole_ticks(self.step_seconds))

    def __repr__(self) -> str:
        """As it would be built; a time at its default is left out, as digests are made of this."""
        known = {name: getattr(self, name) for name in self.__struct_fields__}
        if self.step_seconds == STEP_SECONDS:
            del known["step_seconds"]
        return f"AgentSpec({', '.join(f'{name}={value!r}' for name, value in known.items())})"

    @property
    def step_ticks(self) -> int:
        """Ticks of 0.1 s that an action takes."""
        return round(self.step_seconds * TICKS_A_SECOND)

    def time_after(self, actions: int) -> float:
        """Seconds that so many actions take: of whole ticks, so that no error adds up."""
        return actions * self.step_ticks / TICKS_A_SECOND


def _whole_ticks(seconds: float) -> float:
    """A duration [s] as the nearest float to its whole number of ticks.

    Raises:
        EpisodeError: it has none, or is out of range.
    """
    try:
        ticks = round(seconds * TICKS_A_SECOND)
        fits = 1 <= ticks <= LONGEST_STEP * TICKS_A_SECOND and not isinstance(seconds, bool)
        if fits and abs(seconds * TICKS_A_SECOND - ticks) <= 1e-6:
            found = ticks / TICKS_A_SECOND
            return STEP_SECONDS if found == STEP_SECONDS else found
    except (TypeError, ValueError, OverflowError):  # a text, NaN, infinity
        pass
    raise EpisodeError(
        f"step_seconds is {brief(seconds)}",
        where="agent",
        remedy="give the seconds that an action takes: a multiple of 0.1, from 0.1 to "
        f"{LONGEST_STEP:g}; most bodies take {STEP_SECONDS}",
    )


def tell_pace(agent: AgentSpec) -> str:
    """How long an action takes, as a clause; "" at the default, which older cards do not tell."""
    return "" if agent.step_seconds == STEP_SECONDS else f", {agent.step_seconds:g} s an action"


class Episode(msgspec.Struct, frozen=True, kw_only=True):
    """One task. All coordinates in the 3DGS world frame [m], yaw [rad].

    Attributes:
        id: unique within its suite; safe as a file name.
        scene_id: the scene it belongs to.
        mission: what to do.
        start: pose at reset.
        path: reference path [(x, y) m] that nDTW scores, start first; our own end at the goal, or
            where the reference of a mission to follow somebody ends.
        split: train, val, test, …
        seed: seed of everything random in this episode.
        agent: embodiment it was planned for.
        path_id: the path it was made of: missions of one path share it; "" when not known.
        light: how the scene is lit in this episode; None as it was made.
        path_source: where an imported path comes from: "truth", a set's dense ground truth as it
            stands; "file", its path as it stands, points at most 0.25 m apart; "resampled", its
            sparse nodes joined by straight lines. "" when the path is our own.
        goal_set: all places that fit the words, where there are several: the nearest counts. The
            goal is the one of them that the reference path leads to.
        tier: "visible from above" for a target that the bird's-eye view shows; "" for others, and
            where nobody looked.
        people: who else is there, and what they do.
    """

    id: str
    scene_id: str
    mission: Mission
    start: tuple[float, float, float]
    path: tuple[tuple[float, float], ...]
    split: str = "test"
    seed: int = 0
    agent: AgentSpec = AgentSpec()
    path_id: str = ""
    light: LightCondition | None = None
    path_source: PathSource = ""
    goal_set: GoalSet | None = None
    tier: str = ""
    people: tuple[EpisodePerson, ...] = ()

    @property
    def destination(self) -> tuple[float, float] | GoalSet:
        """Whatever counts as the goal: what distances are measured to."""
        return self.goal_set or self.mission.goal

    @property
    def goals(self) -> tuple[tuple[float, float], ...]:
        """The places (x, y) [m] that count, the goal of the reference path first."""
        others = self.goal_set.points if self.goal_set is not None else ()
        return (self.goal, *(place for place in others if place != self.goal))

    @property
    def in_area(self) -> bool:
        """Whether the goal is an area: only who stands inside it is there, at no distance."""
        return self.goal_set is not None and bool(self.goal_set.areas)

    def into_area(self, depth: float) -> Episode:
        """The same, but that one is in its area only so far behind the entrance [m]; 0: at once."""
        if not depth or self.goal_set is None or not self.goal_set.areas:
            return self
        inner = GoalSetInner(areas=self.goal_set.areas, depth=depth)
        return msgspec.structs.replace(self, goal_set=inner)

    def success_within(self, radius: float) -> float:
        """Distance to the goal [m] below which, strictly, STOP is a success.

        Args:
            radius: the benchmark's own [m]; the goal set's takes its place, and of an area nothing
                counts but distance 0.
        """
        if self.goal_set is None:
            return radius
        if self.goal_set.areas:
            return INSIDE
        own = self.goal_set.radius
        return radius if own is msgspec.UNSET else own

    @property
    def start_pose(self) -> Pose2D:
        """Start as a `Pose2D`."""
        return Pose2D(*self.start)

    @property
    def followed(self) -> EpisodePerson | None:
        """The person whom the mission is to follow; None of other missions, and when not told."""
        number = self.mission.person if isinstance(self.mission, MissionFollow) else 0
        return next((p for p in self.people if p.number == number), None)

    @property
    def goal(self) -> tuple[float, float]:
        """Goal (x, y) [m] of the mission."""
        return self.mission.goal

    @property
    def instruction(self) -> str:
        """The text given to the agent; never empty."""
        return self.mission.instruction


def check_episode(episode: Episode) -> Episode:
    """The episode itself, if its values make sense on their own.

    Raises:
        EpisodeError: non-finite pose, goal or path, empty instruction, unsafe id; people who cannot
            be there together, or who stand where the agent starts.
    """
    where = f"episode {episode.id!r}"
    values = chain(episode.start, episode.goal, chain.from_iterable(episode.path))
    if not all(map(math.isfinite, values)):
        raise EpisodeError(
            "start, goal or path holds NaN or infinity", where=where, remedy="rebuild the suite"
        )
    known = episode.goal_set.points if episode.goal_set is not None else ()
    if known and episode.goal not in known:
        raise EpisodeError(
            "goal is not in its goal set", where=where, remedy="list the goal among the points"
        )
    if not episode.instruction.strip():
        raise EpisodeError("instruction is empty", where=where, remedy="give it a text")
    if not episode.id or episode.id != episode.id.strip() or any(c in episode.id for c in "/\\\0"):
        raise EpisodeError("id is not a plain name", where=where, remedy="letters, digits, - and _")
    if episode.people:
        check_people_of(episode.people, episode.start[:2], episode.agent.radius, where)
    mission = episode.mission
    if isinstance(mission, MissionFollow) and mission.person and episode.followed is None:
        raise EpisodeError(
            f"person {mission.person} is to be followed, and is not there",
            where=f"{where}, mission, person",
            remedy="give the number of one of the episode's people",
        )
    return episode
