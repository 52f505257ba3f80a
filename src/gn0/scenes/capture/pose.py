"""From a capture's own frame to the scene's: up, floor, scale and heading, with the evidence."""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from gn0.errors import SceneError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.transform import transform_cloud
from gn0.geometry import F64
from gn0.scenes.capture.floor import (
    LEAST_SHARE,
    LEAST_WALL,
    FloorPlane,
    find_wall_yaw,
    fit_floor,
)
from gn0.scenes.capture.gravity import (
    SurfaceSample,
    UpCandidate,
    name_direction,
    plane_axes,
    propose_up,
    sample_surface,
    weigh_ends,
    weighted_quantile,
)
from gn0.scenes.capture.levels import Storey, find_storey
from gn0.scenes.capture.scale import ScaleFound, collect_votes, find_scale
from gn0.scenes.capture.settings import CaptureSettings, read_floor, read_up

SURE = 0.75  # share of the best up above which it is taken without a warning
_HANGING = -0.05  # of UpCandidate.low: things of rooms the right way up lie at +0.1
_LID = 0.6  # of the built columns under a level that closes a storey
_STILL = math.radians(0.02)  # a turn below this is within what a fit can tell


@dataclass(frozen=True)
class CapturePose:
    """x_scene = scale · rotation · x_file + (0, 0, lift), and why.

    Attributes:
        rotation: proper [3, 3]: the file's up becomes +z.
        scale: metres per unit of the file.
        found: how the scale was found, with every vote.
        lift: added to z [m]: the floor comes to 0.
        ground: the floor was given, so it is assumed to be flat and everywhere.
        floor: what was found, in the file's units; None when the floor was given.
        ceiling: height above the floor [m], or None.
        candidates: up directions that were weighed, the likeliest first; empty when given.
        walls: share of upright surface along the two main headings.
        evidence: statements in words, by topic.
        doubts: what the user should look at, in words, by topic.
    """

    rotation: F64
    scale: float
    found: ScaleFound
    lift: float
    ground: bool
    floor: FloorPlane | None
    ceiling: float | None
    candidates: tuple[UpCandidate, ...]
    walls: float
    evidence: dict[str, str]
    doubts: dict[str, str]

    @property
    def noise(self) -> float:
        """Standard deviation [m] of the floor's points about it; 0 when the floor was given."""
        return 0.0 if self.floor is None else self.floor.noise * self.scale

    def apply(self, cloud: GaussianCloud) -> GaussianCloud:
        """The cloud in the scene's frame; what needs no turning keeps its bytes."""
        turned = None if np.array_equal(self.rotation, np.eye(3)) else self.rotation
        return transform_cloud(
            cloud, rotation=turned, scale=self.scale, shift=(0.0, 0.0, self.lift)
        )


def propose_pose(cloud: GaussianCloud, settings: CaptureSettings) -> CapturePose:
    """Where the scene's frame lies in a capture.

    Raises:
        SceneError: nothing to see, or no floor and none given.
        ConfigError: a setting does not make sense.
    """
    sample = sample_surface(cloud)
    evidence: dict[str, str] = {}
    doubts: dict[str, str] = {}
    up, candidates = _find_up(sample, settings, evidence, doubts)
    said = read_floor(settings.floor)
    floor: FloorPlane | None = None
    if said is None:
        floor = fit_floor(sample, up)
        evidence["floor"] = _floor_words(floor)
        if not floor.credible:
            raise SceneError(
                f"no floor found with {name_direction(up)} up: the best is {evidence['floor']}",
                remedy="an object on its own? `--floor bottom` puts it on flat ground; "
                + doubts.get("up", "wrong way up? give --up"),
            )
        storey = find_storey(sample, floor)
        _refuse_ceilings(candidates, storey)
        leaned = math.degrees(math.acos(min(1.0, float(np.dot(floor.up, up)))))
        evidence["up"] += f"; levelled by the floor, {leaned:.2f}° away"
        up = np.asarray(floor.up)
        evidence["up"] = f"{name_direction(up)}, from {evidence['up']}"
        height = floor.height
        if storey.height is None and floor.share < LEAST_SHARE:
            doubts["floor"] = (
                f"there is no ceiling, and only {floor.share:.0%} of the surface is floor: this "
                "may be an object with its side taken for a floor; then give --up and "
                "--floor bottom"
            )
    else:
        if said == "bottom":
            height = weighted_quantile(sample.points @ up, sample.weight, (0.005,))[0]
        else:
            height = said
            _refuse_far(height, sample, up)
        storey = Storey()
        evidence["floor"] = f"given: flat ground at {height:.4g} along up, seen or not"
    rotation, walls = _find_rotation(sample, settings, up, evidence)
    along = rotation
    if settings.yaw != "walls":  # doors are looked for along the walls all the same
        along = _find_rotation(sample, msgspec.structs.replace(settings, yaw="walls"), up, {})[0]
    tally = collect_votes(cloud, along, height, storey)
    found = find_scale(settings, up, height, storey, tally, sample.size)
    evidence["scale"] = found.evidence
    if found.tally is not None:
        evidence["votes"] = found.votes
    if found.doubt:
        doubts["scale"] = found.doubt
    scale = found.scale
    if len(storey.ceilings) > 1 or storey.next_floor is not None:
        evidence["levels"] = _level_words(storey, scale)
    return CapturePose(
        rotation=rotation,
        scale=scale,
        found=found,
        lift=-height * scale,
        ground=said is not None,
        floor=floor,
        ceiling=None if storey.ceiling is None else storey.ceiling * scale,
        candidates=tuple(candidates),
        walls=walls,
        evidence=evidence,
        doubts=doubts,
    )


def _find_up(
    sample: SurfaceSample,
    settings: CaptureSettings,
    evidence: dict[str, str],
    doubts: dict[str, str],
) -> tuple[F64, list[UpCandidate]]:
    given = read_up(settings.up)
    if given is not None:
        evidence["up"] = f"{name_direction(given)} as given"
        against, why = weigh_ends(sample, given)
        if against >= SURE:
            other = name_direction(-given).split()[0]
            doubts["up"] = (
                f"this may stand on its head: with --up={other} {why}; look at the picture"
            )
        return given, []
    candidates = propose_up(sample)
    best = candidates[0]
    others = [c for c in candidates[1:] if np.dot(c.up, best.up) < 0.9]
    runner = others[0] if others else best
    evidence["up"] = (
        f"{best.name} ({best.share:.0%}): {best.levels:.0%} of the level surface lies at two "
        f"heights, {best.cover:.0%} of the columns stand on the lowest, {best.under:.0%} of the "
        f"matter is under it, things lie {_lying(best.low)}, {best.flat:.0%} flatter than wide; "
        f"runner-up {runner.name} ({runner.share:.0%}): {runner.levels:.0%}, {runner.cover:.0%}, "
        f"{runner.under:.0%}, {_lying(runner.low)}, {runner.flat:.0%}"
    )
    if best.share < SURE:
        doubts["up"] = (
            f"up may be {best.name} ({best.share:.0%}) or {runner.name} ({runner.share:.0%}): "
            f"look at the picture; to turn it, give --up={runner.name.split()[0]}"
        )
    return np.asarray(best.up), candidates


def _refuse_ceilings(candidates: list[UpCandidate], storey: Storey) -> None:
    """Refuse a room stood on its ceiling: all that it holds then hangs, and nothing is above.

    Raises:
        SceneError: what was taken for the floor is the ceiling of a room whose floor is missing.
    """
    if not candidates or storey.height is None:
        return
    if any(level.cover >= _LID for level in storey.ceilings):
        return
    best = candidates[0]
    if best.low >= _HANGING:
        return
    up = name_direction(-np.asarray(best.up))
    raise SceneError(
        f"no floor found: the one large level surface is a ceiling, for things lie {best.low:+.2f} "
        "from it, at the other end of the walls, where no floor was scanned",
        remedy=f"to lay flat ground at the foot of the walls, give --up={up.split()[0]} "
        f"--floor bottom; if it was scanned without its ceiling, --up="
        f"{best.name.split()[0]} takes the surface for the floor",
    )


def _lying(low: float) -> str:
    return f"{'low' if low >= 0 else 'high'} ({low:+.2f})"


def _refuse_far(height: float, sample: SurfaceSample, up: F64) -> None:
    """Refuse ground farther from everything scanned than the scan is large.

    Raises:
        SceneError: says between which heights the splats lie.
    """
    low, high = weighted_quantile(sample.points @ up, sample.weight, (0.005, 0.995))
    if not low - sample.size <= height <= high + sample.size:
        raise SceneError(
            f"{height:g} lies far from the splats, which lie at {low:.4g} to {high:.4g} along up",
            where="--floor",
            remedy="give a height along up in the file's units, or --floor bottom",
        )


def _floor_words(floor: FloorPlane) -> str:
    return (
        f"a plane at {floor.height:.4g} along up: {floor.cover:.0%} of the columns stand on it, "
        f"{floor.share:.0%} of the surface lies in it (to {floor.noise:.2g}), "
        f"{floor.under:.0%} of the matter is under it"
    )


def _level_words(storey: Storey, scale: float) -> str:
    rooms = ", ".join(
        f"{level.height * scale:.2f} m over {level.cover:.0%}" for level in storey.ceilings
    )
    words = f"ceilings at {rooms} of what is built"
    if storey.next_floor is not None:
        words += f"; a storey above at {storey.next_floor.height * scale:.2f} m"
    return words


def _find_rotation(
    sample: SurfaceSample, settings: CaptureSettings, up: F64, evidence: dict[str, str]
) -> tuple[F64, float]:
    """Rotation that takes `up` to +z with the least turn, then the walls to the axes."""
    rotation = _least_turn(up)
    a, b = plane_axes(up)
    yaw, walls = find_wall_yaw(sample, up)
    if settings.yaw == "walls" and walls >= LEAST_WALL:
        wall = math.cos(yaw) * a + math.sin(yaw) * b
        heading = rotation @ wall
        turn = -math.atan2(heading[1], heading[0])
        quarter = math.pi / 2
        turn = math.remainder(turn, quarter)
        evidence["yaw"] = (
            f"turned by {math.degrees(turn):.2f}°: {walls:.0%} of the upright surface faces two "
            "directions at right angles"
        )
        if abs(turn) > _STILL:
            c, s = math.cos(turn), math.sin(turn)
            rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ rotation
    elif settings.yaw == "walls":
        evidence["yaw"] = (
            f"kept: only {walls:.0%} of the upright surface faces two directions at right angles"
        )
    else:
        evidence["yaw"] = "kept, as told"
    return rotation, walls


def _least_turn(up: F64) -> F64:
    """The smallest rotation [3, 3] that takes a unit vector to +z; exactly none when it is +z."""
    c = float(up[2])
    if math.acos(min(1.0, max(-1.0, c))) < _STILL:
        return np.eye(3)
    if c < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = np.cross(up, (0.0, 0.0, 1.0))
    k = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.asarray(np.eye(3) + k + k @ k / (1 + c))
