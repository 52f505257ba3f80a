"""From a capture's own frame to the scene's: up, floor, scale and heading, with the evidence."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gn0.errors import SceneError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.transform import transform_cloud
from gn0.geometry import F64
from gn0.scenes.capture.floor import (
    LEAST_SHARE,
    LEAST_WALL,
    FloorPlane,
    find_ceiling,
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
from gn0.scenes.capture.settings import (
    CaptureSettings,
    read_floor,
    read_scale_rule,
    read_up,
)

SURE = 0.75  # share of the best up above which it is taken without a warning
CEILINGS = (2.1, 4.2)  # m: ceilings of rooms
USUAL_CEILING = 2.6  # m
_STILL = math.radians(0.02)  # a turn below this is within what a fit can tell


@dataclass(frozen=True)
class CapturePose:
    """x_scene = scale · rotation · x_file + (0, 0, lift), and why.

    Attributes:
        rotation: proper [3, 3]: the file's up becomes +z.
        scale: metres per unit of the file.
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
        leaned = math.degrees(math.acos(min(1.0, float(np.dot(floor.up, up)))))
        evidence["up"] += f"; levelled by the floor, {leaned:.2f}° away"
        up = np.asarray(floor.up)
        evidence["up"] = f"{name_direction(up)}, from {evidence['up']}"
        height = floor.height
        ceiling = find_ceiling(sample, floor)
        if ceiling is None and floor.share < LEAST_SHARE:
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
        ceiling = None
        evidence["floor"] = f"given: flat ground at {height:.4g} along up, seen or not"
    scale = _find_scale(sample, settings, up, height, ceiling, evidence, doubts)
    rotation, walls = _find_rotation(sample, settings, up, evidence)
    return CapturePose(
        rotation=rotation,
        scale=scale,
        lift=-height * scale,
        ground=said is not None,
        floor=floor,
        ceiling=None if ceiling is None else ceiling * scale,
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


def _lying(low: float) -> str:
    return f"{'low' if low >= 0 else 'high'} ({low:+.2f})"


def _floor_words(floor: FloorPlane) -> str:
    return (
        f"a plane at {floor.height:.4g} along up: {floor.cover:.0%} of the columns stand on it, "
        f"{floor.share:.0%} of the surface lies in it (to {floor.noise:.2g}), "
        f"{floor.under:.0%} of the matter is under it"
    )


def _find_scale(
    sample: SurfaceSample,
    settings: CaptureSettings,
    up: F64,
    height: float,
    ceiling: float | None,
    evidence: dict[str, str],
    doubts: dict[str, str],
) -> float:
    if settings.scale:
        evidence["scale"] = f"given: {settings.scale:g} m a unit"
        return float(settings.scale)
    if settings.scale_from:
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
                remedy="the point must lie above the floor; check it and --up",
            )
        scale = rule.metres / length
        evidence["scale"] = (
            f"{scale:.5g} m a unit, from {rule.kind} {rule.metres:g} m = {length:.4g} units"
        )
        return scale
    if ceiling is None:
        evidence["scale"] = "1 m a unit, assumed: no ceiling to judge by"
        doubts["scale"] = (
            f"nothing shows the scale: one unit is taken for 1 m, so the capture is "
            f"{sample.size:.3g} m from corner to corner; give --scale or --scale-from"
        )
        return 1.0
    if CEILINGS[0] <= ceiling <= CEILINGS[1]:
        evidence["scale"] = f"1 m a unit: the ceiling is {ceiling:.2f} units up, as in metres"
        return 1.0
    scale = USUAL_CEILING / ceiling
    evidence["scale"] = (
        f"{scale:.4g} m a unit, proposed: the ceiling is {ceiling:.4g} units up and taken for "
        f"{USUAL_CEILING} m"
    )
    doubts["scale"] = (
        f"the scale rests on a ceiling of {USUAL_CEILING} m; measure it and give "
        "--scale-from ceiling:METRES"
    )
    return scale


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
