"""An agent walked by hand: the simulator's own actions and collisions, and what its eyes see."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gn0.errors import EpisodeError
from gn0.geometry import F32, F64, U8, Pose2D
from gn0.missions.episode import Episode, MissionFollow, MissionGoal
from gn0.people.person import EpisodePerson
from gn0.scenes.rooms import room_at
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action, Observation
from gn0.viewer.live_map import MapPerson, PictureKind
from gn0.viewer.live_people import frame_person, mark_people

WORDS = {
    Action.STOP: "stop",
    Action.FORWARD: "forward",
    Action.LEFT: "turn left",
    Action.RIGHT: "turn right",
}
STEPS = 1_000_000  # a walk by hand never runs out of steps
TRAIL = 4000  # poses kept

# dark blue, teal, green, yellow, pale: even in lightness, told apart without colour vision
_RAMP = np.array(
    [
        (252, 246, 206), (246, 212, 104), (196, 198, 74), (112, 178, 92), (44, 150, 118),
        (22, 118, 132), (34, 84, 128), (44, 52, 104), (36, 22, 62),
    ],
    np.float64,
)  # fmt: skip


@dataclass(frozen=True)
class LastMove:
    """What the last action did.

    Attributes:
        word: the action in words.
        moved: distance covered [m].
        bumped: an obstacle cut it short.
        person: number of the person who was the obstacle; 0 for nobody.
    """

    word: str = "–"
    moved: float = 0.0
    bumped: bool = False
    person: int = 0


class AgentWalk:
    """One agent in one scene, without a task; people go on with what they do wherever it is put.

    Args:
        simulator: with sensors rgb, depth, bev and occupancy; see `open_simulator`.
        people: who is there.
        followed: number of the one whom the agent would follow; 0 nobody.

    Attributes:
        past: [P, 2] m each, where people were after each action, the latest last.
    """

    def __init__(
        self, simulator: Simulator, people: tuple[EpisodePerson, ...] = (), followed: int = 0
    ) -> None:
        self.simulator, self.people, self.followed = simulator, people, followed
        self.past: list[F64] = []
        self.last = LastMove()
        self.trail: list[tuple[float, float]] = []
        self.bumps = 0
        self._observation: Observation | None = None

    @property
    def pose(self) -> Pose2D:
        """Where the agent stands."""
        return self.simulator.pose

    @property
    def standing(self) -> bool:
        """Whether it has been put anywhere yet."""
        return self._observation is not None

    def place(self, x: float, y: float, yaw: float) -> bool:
        """Put the agent at x, y [m], yaw [rad]; False, and no change, where it has no room."""
        here, company = (float(x), float(y)), self.simulator.company
        mission: MissionGoal | MissionFollow = MissionGoal(
            goal=here, object_id="", category="", instruction="Look around."
        )
        if self.people:  # STOP is to wait
            mission = MissionFollow(goal=here, instruction="Look around.", human="")
        episode = Episode(
            id="walk",
            scene_id=self.simulator.scene.id,
            mission=mission,
            start=(*here, float(yaw)),
            path=(here, here),
            agent=self.simulator.agent,
            people=self.people,
        )
        kept = company.save() if self.standing else None
        if kept is not None:
            away = np.hypot(*(company.places - here).T)
            if away.min() < company.radius + self.simulator.agent.radius:
                self.last = LastMove("somebody stands there", 0.0, True)
                return False
        try:
            self._observation = self.simulator.reset(episode)
        except EpisodeError as error:
            if not self.standing and self.people and "person" in error.where:
                raise  # people who cannot be there at all
            self.last = LastMove("no room for the agent there", 0.0, True)
            return False
        if kept is not None:
            company.restore(episode, kept)
            self._observation = self.simulator.observe_at(self.pose)
        if self.people and not self.past:
            self.past = [np.array(company.places)]
        self.last = LastMove("put here")
        self.trail = [here]
        return True

    def act(self, action: Action) -> LastMove:
        """Take one action exactly as a policy would.

        Raises:
            SimError: before `place`.
        """
        result = self.simulator.step(action)
        self._observation = result.observation
        word = "wait" if self.people and action == Action.STOP else WORDS[action]
        hit = result.info.get("hit_person")
        self.last = LastMove(word, result.moved, result.collided, 0 if hit is None else hit.number)
        self.bumps += result.collided
        if self.people:
            self.past = [*self.past[1 - TRAIL :], np.array(self.simulator.company.places)]
        if result.moved > 0:
            self.trail = [*self.trail[1 - TRAIL :], (self.pose.x, self.pose.y)]
        return self.last

    def picture(self, kind: PictureKind) -> U8:
        """What the agent sees or is told, as a picture [H, W, 3].

        Raises:
            EpisodeError: before `place`.
        """
        seen = self._observation
        if seen is None:
            raise EpisodeError("the agent has no position yet", remedy="call place first")
        if kind == "depth":
            assert seen.depth is not None
            return colour_depth(seen.depth, self.simulator.config.preset.depth_range[1])
        if kind == "RGB" and self.followed:
            assert seen.rgb is not None
            framed = seen.rgb.copy()
            frame_person(framed, self._find_followed())
            return framed
        picture = {"RGB": seen.rgb, "BEV": seen.bev, "occupancy": seen.occupancy}[kind]
        assert picture is not None
        return picture

    def _find_followed(self) -> tuple[int, int, int, int] | None:
        """Box of whom the agent would follow in its picture [px]; None out of sight."""
        _, pixels, *box = self.simulator.look_at_people()[1][self.followed - 1].tolist()
        if not pixels:
            return None
        left, top, right, bottom = map(int, box)
        return left, top, right, bottom

    @property
    def marks(self) -> tuple[MapPerson, ...]:
        """People where they are now, with where they have been."""
        if not self.past:
            return ()
        row = next((k for k, p in enumerate(self.people) if p.number == self.followed), -1)
        return mark_people(self.past, self.simulator.company.faces, row)

    @property
    def text(self) -> str:
        """Pose, last action and place, one fact a line."""
        pose = self.pose
        room = room_at(self.simulator.scene.rooms, pose.x, pose.y)
        kind = next((r.type for r in self.simulator.scene.rooms if r.id == room), "")
        lines = [
            f"x {pose.x:.2f} m   y {pose.y:.2f} m   yaw {math.degrees(pose.yaw):.0f}°",
            f"step {self.simulator.steps}: {self.last.word}"
            + (f", {self.last.moved:.2f} m" if self.last.word == WORDS[Action.FORWARD] else ""),
        ]
        return "\n".join(lines + ([f"in: {kind}"] if kind else []))


def colour_depth(depth: F32, limit: float) -> U8:
    """Depth [H, W] m as colours: near is pale, far is dark; `limit` [m] and beyond the darkest."""
    share = np.clip(np.nan_to_num(depth, nan=limit, posinf=limit) / limit, 0, 1) ** 0.6
    place = share * (len(_RAMP) - 1)
    low = np.minimum(place.astype(np.int64), len(_RAMP) - 2)
    part = (place - low)[..., None]
    return np.asarray(_RAMP[low] * (1 - part) + _RAMP[low + 1] * part + 0.5, np.uint8)
