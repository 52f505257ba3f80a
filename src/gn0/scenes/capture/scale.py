"""How many metres one unit of a capture's file is: given, measured, or voted for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gn0.errors import SceneError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.scenes.capture.doorways import find_doorways
from gn0.scenes.capture.gravity import sample_surface
from gn0.scenes.capture.levels import Storey
from gn0.scenes.capture.patches import TOPS, find_patches, level_sample
from gn0.scenes.capture.settings import CaptureSettings, read_scale_rule
from gn0.scenes.capture.votes import AGREE, DOOR, UNIT_NEAR, Tally, count_votes

CEILINGS = (2.1, 4.2)  # m: ceilings of rooms
USUAL_CEILING = 2.6  # m
FRAME_ONLY = 0.06  # spread of a tally of the building alone: no door, no table has voted
VOTERS = 1_500_000  # Gaussians looked at
_AGAINST = 0.15  # in ln scale: votes this far from a given scale are told


@dataclass(frozen=True)
class ScaleFound:
    """A scale and what speaks for it.

    Attributes:
        scale: metres a unit.
        evidence: in words.
        doubt: in words; "" when there is none.
        tally: the votes; None where nothing votes.
    """

    scale: float
    evidence: str
    doubt: str = ""
    tally: Tally | None = None

    @property
    def votes(self) -> str:
        """Every vote in words, the weightiest first; "" without any."""
        if self.tally is None:
            return ""
        words = "; ".join(vote.words for vote in self.tally.votes)
        return f"{words}; together {self.tally.scale:.4g} m a unit"


def collect_votes(
    cloud: GaussianCloud, rotation: F64, height: float, storey: Storey
) -> Tally | None:
    """The votes of a capture.

    Args:
        cloud: in the file's frame.
        rotation: [3, 3] from the file's axes to level ones along the walls.
        height: height of the floor along up.
        storey: what was found over the floor.
    """
    if storey.height is None:
        return None
    sample = level_sample(sample_surface(cloud, VOTERS), rotation, height, storey.height)
    return count_votes(storey, find_doorways(sample), find_patches(sample, TOPS))


def find_scale(
    settings: CaptureSettings,
    up: F64,
    height: float,
    storey: Storey,
    tally: Tally | None,
    size: float,
) -> ScaleFound:
    """The scale that is given, measured or voted for, in this order.

    Args:
        settings: what the user says.
        up: in the file's frame.
        height: height of the floor along up.
        storey: what was found over the floor.
        tally: the votes.
        size: size of the capture from corner to corner, in units.

    Raises:
        SceneError: a known length cannot be measured.
    """
    if settings.scale:
        scale = float(settings.scale)
        return ScaleFound(scale, f"given: {scale:g} m a unit", _against(scale, tally), tally)
    if settings.scale_from:
        scale, words = _measure(settings, up, height, storey.ceiling)
        return ScaleFound(scale, words, _against(scale, tally), tally)
    if tally is None:
        return ScaleFound(
            1.0,
            "1 m a unit, assumed: no ceiling and no walls to judge by",
            f"nothing shows the scale: one unit is taken for 1 m, so the capture is "
            f"{size:.3g} m from corner to corner; give --scale or --scale-from",
        )
    return _voted(storey, tally)


def _voted(storey: Storey, tally: Tally) -> ScaleFound:
    ceiling = storey.ceiling
    alone = tally.spread > FRAME_ONLY  # the building alone has voted
    room = ceiling is not None and CEILINGS[0] <= ceiling <= CEILINGS[1]
    split = _dissent(tally)
    if abs(math.log(tally.scale)) <= max(UNIT_NEAR, 2 * tally.spread) or (alone and room):
        seen = f"the ceiling is {ceiling:.2f} units up, as in metres" if room else "in metres"
        return ScaleFound(1.0, f"1 m a unit: {seen}{_many(tally)}", split, tally)
    if alone:
        what = "ceiling is" if ceiling is not None else "tops of the walls are"
        scale = USUAL_CEILING / (ceiling or storey.wall_top or 1.0)
        return ScaleFound(
            scale,
            f"{scale:.4g} m a unit, proposed: the {what} {ceiling or storey.wall_top:.4g} units "
            f"up and taken for {USUAL_CEILING} m",
            f"the scale rests on a ceiling of {USUAL_CEILING} m, for no door, table or seat was "
            "found to vote; measure it and give --scale-from ceiling:METRES, or --scale",
            tally,
        )
    within = f"right to about {max(5, round(200 * tally.spread))} %"
    if not any(vote.kind == DOOR.name for vote in tally.votes):
        # shelves of a shop stand at the heights of tables and seats of another size
        within = "of things that may not be what they seem, for no door was found"
    return ScaleFound(
        tally.scale,
        f"{tally.scale:.4g} m a unit, proposed{_many(tally)}",
        split
        or f"the scale is a vote {within}; to settle it, measure something and give --scale-from",
        tally,
    )


def _many(tally: Tally) -> str:
    kinds = [vote.kind for vote in tally.votes]
    return f"; {', '.join(kinds)} vote for {tally.scale:.4g}"


def _dissent(tally: Tally) -> str:
    if not tally.dissent:
        return ""
    against = ", ".join(f"{vote.kind} {vote.scale:.4g}" for vote in tally.dissent)
    return (
        f"the votes on the scale disagree: {against} against {tally.scale:.4g} m a unit; measure "
        "something and give --scale-from"
    )


def _against(scale: float, tally: Tally | None) -> str:
    """What is said when the votes contradict a scale that was given."""
    if tally is None or tally.spread > FRAME_ONLY:
        return ""
    if abs(math.log(tally.scale / scale)) <= max(_AGAINST, 3 * tally.spread, AGREE):
        return ""
    kinds = ", ".join(vote.kind for vote in tally.votes)
    return (
        f"the scale given is {scale:.4g} m a unit, but {kinds} vote for {tally.scale:.4g}; "
        "look at the one metre bar of the picture"
    )


def _measure(
    settings: CaptureSettings, up: F64, height: float, ceiling: float | None
) -> tuple[float, str]:
    """The scale of a known length, and the words for it."""
    rule = read_scale_rule(settings.scale_from)
    points = np.asarray(rule.points, np.float64)
    if rule.kind == "ceiling":
        if ceiling is None:
            raise SceneError(
                "no ceiling found to take the scale from",
                where="--scale-from",
                remedy="use two-points:METRES@x,y,z@x,y,z, or --scale FACTOR",
            )
        length = ceiling
    elif rule.kind == "two-points":
        length = float(np.linalg.norm(points[1] - points[0]))
    else:
        length = float(points[0] @ up - height)
    if not length > 0:
        raise SceneError(
            f"{rule.kind} measures {length:.4g} units in the file",
            where="--scale-from",
            remedy="give two points that lie apart"
            if rule.kind == "two-points"
            else "the point must lie above the floor; check it and --up",
        )
    scale = rule.metres / length
    return scale, f"{scale:.5g} m a unit, from {rule.kind} {rule.metres:g} m = {length:.4g} units"
