"""When an agent follows a person, and when an episode of following ends: the rules, step by step.

`docs/following.md` defines them. Simulators, rewards and measures ask here, so that they agree.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, overload

import msgspec

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from gn0.geometry import F64

FollowEnd = Literal["touch", "lost", "steps", "stop", "over"]
"""What ended an episode: a touch, loss, the last step, a STOP (profile `evt`), or the time after
the person's track."""

TOUCHED_BY = "agent"
"""Who must have moved more towards the other in a tick that was not done, for it to be a touch."""
PREFERRED = 1.5  # m: distance to keep where the mission tells none
SAME_TIME = 1e-9  # s: clocks that differ by less say the same


class CutMove(Protocol):
    """A move of the agent that was cut because of a person, see `gn0.sim.people.PersonHit`."""

    @property
    def number(self) -> int:
        """Of the person."""
        ...

    @property
    def by(self) -> str:
        """Who moved more towards the other, "agent" or "person"."""
        ...


def touched_person(cut: CutMove | None) -> int | None:
    """Whom the agent touched: the number of a person for whom its move was cut, by the agent.

    A person that walks into the agent's way cuts its move, too, and is not touched by it.
    """
    return None if cut is None or cut.by != TOUCHED_BY else cut.number


class FollowRules(msgspec.Struct, frozen=True, kw_only=True):
    """The numbers of following.

    Attributes:
        name: of the profile.
        reach: a step follows within this distance of the person [m], itself included.
        least_share: share of the picture that the person must at least be.
        least_pixels: pixels that the person must be more than; 0 where only the share counts.
        most_share: share of the picture that the person must be less than.
        half_view: where there are no pictures: how far off the axis still counts as faced
            [degrees], itself included.
        lost_beyond: steps farther than this from the person [m] count towards being lost.
        lost_after: more such steps than this since the last one that followed, and it is lost.
        touch_within: a centre distance to the person below this is a touch [m]; 0 where a touch is
            a move of the agent cut because of a person, by the agent, see `touched_person`.
        nearest: at a success before the last step the person is at least this far [m].
        stop_ends: STOP ends the episode; else it stands still for one action.
        linger: how long an episode goes on after the person's track is over [s].
        max_steps: the last step.
        break_seconds: not following for at least so long is a loss [s].
        person_radius: of people's discs [m].
    """

    name: str
    reach: float = 3.0
    least_share: float = 0.004
    least_pixels: int = 0
    most_share: float = 0.30
    half_view: float = 45.0
    lost_beyond: float = 4.0
    lost_after: int = 20
    touch_within: float = 0.0
    nearest: float = 0.0
    stop_ends: bool = False
    linger: float = 3.0
    max_steps: int = 300
    break_seconds: float = 1.0
    person_radius: float = 0.25

    def is_faced(self, pixels: int, picture: int) -> bool:
        """Whether a person of so many pixels shows, in a picture of so many, as one that is faced.

        In no picture (0 pixels in all) nobody is.
        """
        if picture <= 0 or pixels <= self.least_pixels:
            return False
        share = pixels / picture
        return self.least_share <= share < self.most_share

    def follows(self, distance: float, faced: bool) -> bool:
        """Whether a step at that distance [m] follows."""
        return faced and distance <= self.reach

    @overload
    def touches(self, distance: float, hit: bool) -> bool: ...
    @overload
    def touches(self, distance: F64, hit: NDArray[np.bool_]) -> NDArray[np.bool_]: ...
    def touches(
        self, distance: float | F64, hit: bool | NDArray[np.bool_]
    ) -> bool | NDArray[np.bool_]:
        """Whether a step, or each of many, is a touch: `hit` is what `touched_person` says."""
        return distance < self.touch_within if self.touch_within > 0 else hit


FOLLOW = FollowRules(name="default")
FOLLOW_EVT = FollowRules(
    name="evt",
    least_share=0.0,
    least_pixels=3000,
    touch_within=0.5,
    nearest=1.0,
    stop_ends=True,
    person_radius=0.20,
)
"""EVT-Bench's own numbers: wsakobe/TrackVLA 0d12548, evt_bench/ and baseline_agent.py."""


def follow_rules(profile: str) -> FollowRules:
    """The rules of a suite's profile."""
    return FOLLOW_EVT if profile == FOLLOW_EVT.name else FOLLOW


class FollowSight(NamedTuple):
    """A step as the rules see it, from where it ended.

    Attributes:
        distance: of the centres of agent and person [m].
        faced: whether the person is faced.
        hit: the agent touched somebody, see `touched_person`.
        stopped: the action was STOP.
        cost: steps that the action took.
    """

    distance: float
    faced: bool
    hit: bool = False
    stopped: bool = False
    cost: int = 1


class FollowCount(NamedTuple):
    """What the rules remember: steps so far, and those far off since the last that followed."""

    steps: int = 0
    far: int = 0


def count_step(
    count: FollowCount,
    sight: FollowSight,
    rules: FollowRules,
    *,
    step_seconds: float,
    over_at: float,
) -> tuple[FollowCount, FollowEnd | None, bool]:
    """Count one step, and say whether it ends the episode and whether that is a success.

    Args:
        count: before the step.
        sight: the step.
        rules: the profile's.
        step_seconds: what a step takes [s].
        over_at: when the person's track was over [s]; infinity while it is not.

    Returns:
        (count after the step, what ended the episode or None, success).
    """
    said = count.steps * step_seconds  # when the action was chosen
    steps = count.steps + sight.cost
    follows = rules.follows(sight.distance, sight.faced)
    far = 0 if follows else count.far
    far += sight.cost if sight.distance > rules.lost_beyond else 0
    now = FollowCount(steps, far)
    if rules.touches(sight.distance, sight.hit):
        return now, "touch", False
    if far > rules.lost_after:
        return now, "lost", False
    if steps >= rules.max_steps:
        return now, "steps", follows
    kept = follows and sight.distance >= rules.nearest
    if rules.stop_ends and sight.stopped:
        return now, "stop", kept and said >= over_at - SAME_TIME
    if steps * step_seconds >= over_at + rules.linger - SAME_TIME:
        return now, "over", kept
    return now, None, False
