"""How large a capture is: a vote of what people build to the same sizes everywhere.

Ceilings differ by a tenth from home to home, doors by a fiftieth. Each thing that a capture shows
gives one opinion, and the opinions are weighed by how much their kind varies.

Usual sizes: doors 1.98 to 2.10 m clear (leaves after DIN 18101 and of 80 inches), desks and tables
0.72 to 0.76 m (EN 527-1), seats 0.40 to 0.50 m, worktops 0.85 to 0.95 m (EN 1116), ceilings of
homes 2.4 to 2.8 m, floor to floor 2.7 to 3.1 m, slabs between storeys 0.2 to 0.35 m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F64
from gn0.scenes.capture.doorways import Doorway
from gn0.scenes.capture.levels import Storey
from gn0.scenes.capture.patches import Patch

AGREE = 0.08  # in ln scale: votes farther apart than this disagree
UNIT_NEAR = 0.05  # in ln scale: a vote so near to 1 m a unit means that the file is in metres
STOREYS = (2.1, 6.5)  # m: heights of storeys that are tried
_OUTLIER = 0.01  # likelihood of a size that means nothing
_STEP = 0.004  # of ln scale


@dataclass(frozen=True)
class Kind:
    """A size that is the same nearly everywhere.

    Attributes:
        name: what has it.
        metres: the usual size.
        spread: standard deviation of its logarithm.
        least: of a vote's own spread, however many there are.
        area: least and largest top [m²], for what is known by its top.
    """

    name: str
    metres: float
    spread: float
    least: float
    area: tuple[float, float] = (0.0, math.inf)


CEILING = Kind("ceiling", 2.6, 0.07, 0.07)
WALL_TOP = Kind("top of the walls", 2.6, 0.09, 0.09)
STOREY = Kind("floor to floor", 2.9, 0.08, 0.08)
SLAB = Kind("slab between storeys", 0.27, 0.25, 0.25)
DOOR = Kind("doors", 2.03, 0.03, 0.02)
TOPS = (
    Kind("tables", 0.74, 0.04, 0.04, (0.25, 3.0)),
    Kind("seats", 0.45, 0.06, 0.06, (0.09, 0.5)),
    Kind("worktops", 0.90, 0.03, 0.03, (0.4, 5.0)),
)
DOOR_WIDTH = (0.6, 1.15)  # m: wider ways are passages, whose heads are of any height


@dataclass(frozen=True)
class Vote:
    """One opinion on the scale.

    Attributes:
        kind: what gives it.
        count: count of such things.
        units: their size in the file.
        metres: what that size usually is.
        scale: metres a unit, in this opinion.
        spread: standard deviation of ln scale.
    """

    kind: str
    count: int
    units: float
    metres: float
    scale: float
    spread: float

    @property
    def words(self) -> str:
        """As a user reads it."""
        many = f"{self.count} " if self.count > 1 else ""
        return (
            f"{many}{self.kind} of {self.units:.4g} units, usually {self.metres:g} m: "
            f"{self.scale:.4g}"
        )


@dataclass(frozen=True)
class Tally:
    """All votes on the scale, and what they come to.

    Attributes:
        votes: the weightiest first.
        scale: metres a unit.
        spread: standard deviation of ln scale, from how much the kinds vary.
    """

    votes: tuple[Vote, ...]
    scale: float
    spread: float

    @property
    def dissent(self) -> tuple[Vote, ...]:
        """Votes that contradict what all of them come to."""
        return tuple(
            vote
            for vote in self.votes
            if abs(math.log(vote.scale / self.scale)) > max(AGREE, 2 * vote.spread)
        )


def count_votes(
    storey: Storey, doorways: tuple[Doorway, ...], tops: tuple[Patch, ...]
) -> Tally | None:
    """The scale on which most of what is seen has its usual size; None where nothing votes.

    Args:
        storey: ceilings and the like, in units of the file.
        doorways: with their heads in units of the file.
        tops: level tops of things, in units of the file.
    """
    height = storey.height
    if height is None:
        return None
    tried = np.arange(math.log(STOREYS[0] / height), math.log(STOREYS[1] / height), _STEP)
    frame = _frame_votes(storey)
    worth = np.zeros(len(tried))
    for vote in frame:
        worth += np.log(_density(tried, math.log(vote.scale), vote.spread, _OUTLIER))
    doors = [door for door in doorways if door.leaf is None]
    for door in doors:
        wide = door.width * np.exp(tried)
        fits = (wide >= DOOR_WIDTH[0]) & (wide <= DOOR_WIDTH[1])
        likely = fits * _density(tried, math.log(DOOR.metres / door.head), DOOR.spread, 0.0)
        worth += np.log(np.maximum(likely, _OUTLIER)) * min(1.0, 6 / len(doors))
    # a top is less sure to be what it seems than a door, and clutter has many
    weight = 0.5 * min(1.0, 8 / max(len(tops), 1))
    for top in tops:
        usual = np.full(len(tried), _OUTLIER * 3)
        for kind in TOPS:
            fits = np.log(kind.metres / top.height)
            area = top.area * np.exp(2 * tried)
            inside = (area >= kind.area[0]) & (area <= kind.area[1])
            usual = np.maximum(usual, inside * _density(tried, fits, kind.spread, 0.0))
        worth += weight * np.log(usual)
    best = float(tried[int(np.argmax(worth))])
    votes = list(frame)
    heads = [
        door.head
        for door in doors
        if DOOR_WIDTH[0] <= door.width * math.exp(best) <= DOOR_WIDTH[1]
        and abs(math.log(DOOR.metres / door.head) - best) <= 0.12
    ]
    votes += _vote(DOOR, _commonest(np.array(heads)))
    for kind in TOPS:
        sizes = [
            top.height
            for top in tops
            if kind.area[0] <= top.area * math.exp(2 * best) <= kind.area[1]
            and abs(math.log(kind.metres / top.height) - best) <= 2 * kind.spread
        ]
        votes += _vote(kind, np.array(sizes))
    votes.sort(key=lambda vote: vote.spread)
    heard = [v for v in votes if abs(math.log(v.scale) - best) <= max(AGREE, 3 * v.spread)] or votes
    trust = np.array([vote.spread**-2 for vote in heard])
    middle = float(trust @ np.array([math.log(vote.scale) for vote in heard]) / trust.sum())
    return Tally(tuple(votes), math.exp(middle), float(trust.sum() ** -0.5))


def _frame_votes(storey: Storey) -> list[Vote]:
    """What the building itself says."""
    found: list[Vote] = []
    if storey.ceiling is not None:
        found += _vote(CEILING, np.array([storey.ceiling]))
        if storey.next_floor is not None:
            over = storey.next_floor.height
            found += _vote(STOREY, np.array([over]))
            found += _vote(SLAB, np.array([over - storey.ceiling]))
    elif storey.wall_top is not None:
        found += _vote(WALL_TOP, np.array([storey.wall_top]))
    return found


def _vote(kind: Kind, sizes: NDArray[np.float64]) -> list[Vote]:
    """One vote of all things of a kind, or none."""
    if not len(sizes) or not (sizes > 0).all():
        return []
    middle = float(np.median(sizes))
    spread = max(kind.least, kind.spread / math.sqrt(len(sizes)))
    return [Vote(kind.name, len(sizes), middle, kind.metres, kind.metres / middle, spread)]


def _commonest(sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sizes round the one that most others come near to (2 %)."""
    if not len(sizes):
        return sizes
    near = np.abs(np.log(sizes[:, None] / sizes[None, :])) <= 0.02
    return sizes[near[int(np.argmax(near.sum(axis=1)))]]


def _density(at: F64, middle: float, spread: float, floor: float) -> F64:
    """A bell of height 1 over ln scale, never below `floor`."""
    return np.asarray(np.maximum(np.exp(-0.5 * ((at - middle) / spread) ** 2), floor))
