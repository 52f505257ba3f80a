"""Whether feet stay where they stand and hands out of thighs, and whether motions come over whole.

Joints are placed here by a few lines of our own, soles are the skin of the body's own feet, and
where bones of a file point is read from its joints, not from what the retargeting says of itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gn0.avatars.avatar import TO_WORLD, Avatar
from gn0.avatars.bank import digest_avatar
from gn0.avatars.identity import Identity, draw_people
from gn0.avatars.motion.cycles import cut_cycle, find_cycles
from gn0.avatars.motion.legs import Build, measure_build
from gn0.avatars.motion.lhm import save_lhm_document
from gn0.avatars.motion.library import BY_SPEED, CLIPS, ClipLibrary
from gn0.avatars.motion.motion import Motion
from gn0.avatars.motion.name_maps import map_joints
from gn0.avatars.motion.open_motion import decode_rig, load_motion
from gn0.avatars.motion.play import play_motion
from gn0.avatars.motion.retarget import retarget
from gn0.avatars.motion.rig import RigMotion
from gn0.avatars.motion.standing_joints import STANDING_JOINTS
from gn0.avatars.person import build_person, shape_identity
from gn0.avatars.skeleton import INDEX, PARENTS
from gn0.avatars.skinning import SkinWeights
from gn0.gaussians.ply import save_ply
from gn0.gaussians.splat_files import load_cloud
from gn0.geometry import F64
from gn0.people.cast import Actor
from gn0.people.crowd import build_walls, empty_crowd, place_people, step_crowd
from gn0.people.person import EpisodePerson, PersonStop
from gn0.people.route import build_routes
from gn0.people.shown import show_person, turn_shown
from gn0.scenes import build_example_scene
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most

PEOPLE = (
    Identity(seed=1, stature="short", build="slim"),
    Identity(seed=2, stature="tall", build="average"),
    Identity(seed=3, sex="man", stature="tall", build="heavy"),
    Identity(seed=4, sex="man", stature="short", build="muscular"),
)
SPEEDS = (0.3, 0.5, 0.8, 1.0, 1.3, 1.6)  # m/s
STYLES = 2  # seeds of the style of each
NEAR = 0.004  # m above the floor: skin that is lower rests on it
_RESTS = 3  # points of a foot that rest make it stand
_SIDES = ("left", "right")
_HANDS = [INDEX[f"{s}_{n}"] for s in _SIDES for n in ("wrist", "middle1", "index3")]
_BONES = ("hip knee", "knee ankle", "shoulder elbow", "elbow wrist")
# same names and axes of joints as ours, or a rig of its own
SAME = (
    "bvh/cmu1/jumping_jacks.bvh", "bvh/cmu_assimp/01_01.bvh", "bvh/fair1/dab.bvh",
    "bvh/fair1/jumping.bvh", "bvh/fair1/wave_hello.bvh", "bvh/fair1/zombie.bvh",
    "rigged/maya_kenney_character_7700_binary.fbx",
)  # fmt: skip
OTHER = ("rigged/RobotExpressive/RobotExpressive.glb",)


@dataclass(frozen=True, eq=False)
class Walker:
    """A body that moves, and the points of its feet and thighs.

    Attributes:
        joints: at rest [55, 3] m.
        points: of its skin or splats at rest [N, 3] m; weights: which joints carry them.
        main: joint that carries each most [N].
        build: what its motions are made from.
    """

    joints: F64
    points: F64
    weights: SkinWeights
    main: np.ndarray
    build: Build

    @classmethod
    def of(cls, joints: F64, points: F64, weights: SkinWeights) -> Walker:
        """A body with the build of its points."""
        main = weights.joint[np.arange(len(points)), np.argmax(weights.weight, axis=1)]
        return cls(joints, points, weights, main, measure_build(joints, points, weights))

    def feet(self, turned: F64, placed: F64) -> list[F64]:
        """Points of the left and the right foot [T, P, 3] m of posed joints."""
        found = []
        for side in _SIDES:
            owns = np.isin(self.main, [INDEX[f"{side}_ankle"], INDEX[f"{side}_foot"]])
            low = self.points[:, 1] < self.points[owns, 1].min() + 0.03
            rows = np.flatnonzero(owns & low)
            there = np.zeros((len(turned), len(rows), 3))
            for k in range(self.weights.joint.shape[1]):
                joint, share = self.weights.joint[rows, k], self.weights.weight[rows, k]
                away = self.points[rows] - self.joints[joint]
                moved = np.einsum("tpab,pb->tpa", turned[:, joint], away) + placed[:, joint]
                there += share[:, None] * moved
            found.append(there)
        return found


def open_walkers(people: Sequence[Identity] = PEOPLE) -> list[Walker]:
    """Bare bodies of identities."""
    walkers = []
    for who in people:
        shape = shape_identity(who)
        skin = np.unique(shape.model.triangles)
        carried = shape.model.weights
        weights = SkinWeights(carried.joint[skin], carried.weight[skin])
        walkers.append(Walker.of(shape.joints, shape.vertices[skin], weights))
    return walkers


def place_joints(rest: F64, poses: F64, shift: F64) -> tuple[F64, F64]:
    """Rotations [T, 55, 3, 3] and places [T, 55, 3] of axis-angles, along the parents."""
    angle = np.linalg.norm(poses, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(poses, -1, 0)
    none = np.zeros_like(x)
    cross = np.stack([none, -z, y, z, none, -x, -y, x, none], -1).reshape(*x.shape, 3, 3)
    # Rodrigues: sin θ / θ and (1 − cos θ) / θ²
    local = np.eye(3) + np.sinc(angle / np.pi) * cross
    local = local + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross @ cross
    turned, placed = np.empty_like(local), np.empty(poses.shape)
    for k, parent in enumerate(PARENTS):
        if parent < 0:
            turned[:, k], placed[:, k] = local[:, k], rest[k] + shift
        else:
            turned[:, k] = turned[:, parent] @ local[:, k]
            placed[:, k] = placed[:, parent] + turned[:, parent] @ (rest[k] - rest[parent])
    return turned, placed


class Meeting(NamedTuple):
    """How feet meet the floor.

    `slides` is the pace of the slowest point of each foot that stands, the one that it rolls on
    [N] m/s; `lowest` the lowest point of all [m].
    """

    slides: F64
    lowest: float


def meet_floor(feet: Iterable[F64], fps: float, up: int = 1) -> Meeting:
    """Of points of each foot [T, P, 3] m, height along the axis `up`."""
    slides, lows = [], []
    level = [axis for axis in range(3) if axis != up]
    for foot in feet:
        pace = np.linalg.norm(np.diff(foot[..., level], axis=0), axis=-1) * fps
        rests = (foot[1:, :, up] < NEAR) & (foot[:-1, :, up] < NEAR)
        stands = rests.sum(axis=1) >= _RESTS
        slides.append(np.where(rests, pace, np.inf).min(axis=1)[stands])
        lows.append(float(foot[..., up].min()))
    return Meeting(np.concatenate(slides), min(lows))


@dataclass
class _Clips:
    """What was seen of one kind of clip over all bodies and styles."""

    slides: list[F64]
    lowest: list[float]
    knees: list[float]
    hands: list[float]
    loops: list[float]


def watch_clips(
    walkers: Sequence[Walker], styles: int, wanted: Sequence[tuple[str, float]]
) -> _Clips:
    """Clips, each (name, speed), of all bodies in some styles."""
    found = _Clips([], [], [], [], [])
    for number, walker in enumerate(walkers):
        for style in range(styles):
            library = ClipLibrary(walker.build, seed=10 * number + style)
            for name, speed in wanted:
                _watch(walker, library.motion(name, speed), found)
    return found


def _watch(walker: Walker, motion: Motion, found: _Clips) -> None:
    turned, placed = place_joints(walker.joints, motion.poses, motion.shift)
    way = np.zeros(len(motion)) if motion.displacement is None else motion.displacement
    feet = walker.feet(turned, placed)
    for foot in feet:
        foot[..., 2] += way[:, None]
    meeting = meet_floor(feet, motion.fps)
    found.slides.append(meeting.slides)
    found.lowest.append(meeting.lowest)
    if motion.loop:
        found.loops.append(float(np.abs(placed[0] - placed[-1]).max()))
    for side in _SIDES:
        hip, knee, ankle = (INDEX[f"{side}_{part}"] for part in ("hip", "knee", "ankle"))
        thigh, shank = placed[:, knee] - placed[:, hip], placed[:, ankle] - placed[:, knee]
        bend = np.arctan2(
            (np.cross(thigh, shank) * turned[:, hip, :, 0]).sum(1), (thigh * shank).sum(1)
        )
        found.knees.append(float(np.degrees(bend.min())))
        found.hands.append(_gap_of_hands(walker, placed, hip, knee))


def _gap_of_hands(walker: Walker, placed: F64, hip: int, knee: int) -> float:
    """The least distance of hands from the skin of a thigh [m], below 0 inside; 1 far away.

    Hands come from outside and before; how thick a thigh is there is the 90th percentile around it.
    """
    bone = walker.joints[knee] - walker.joints[hip]
    rest = walker.points[walker.main == hip] - walker.joints[hip]
    part = rest @ bone / (bone @ bone)
    radius = np.linalg.norm(rest - part[:, None] * bone, axis=1)
    at = (0.3, 0.5, 0.7, 0.9)
    thick = [float(np.quantile(radius[np.abs(part - p) < 0.06], 0.9)) for p in at]
    axis = placed[:, knee] - placed[:, hip]
    gap = placed[:, _HANDS] - placed[:, None, hip]
    along = np.einsum("tkc,tc->tk", gap, axis) / (bone @ bone)
    away = np.linalg.norm(gap - along[..., None] * axis[:, None], axis=-1)
    clear = np.where((along > 0.25) & (along < 1.0), away - np.interp(along, at, thick), 1.0)
    return float(clear.min())


DOING = {"walk": "walking on", "set off": "setting off", "stop": "stopping",
         "turn": "standing and turning"}  # fmt: skip


def watch_ticks(avatar: Avatar, speed: float, seconds: float = 20.0) -> dict[str, F64]:
    """Paces [N] m/s of feet that stand, of somebody in the simulator, as drawn from tick to tick.

    He walks to and fro, and turns by 75 and 70 degrees on the spot at two stops.

    Returns:
        by what he does, of `DOING`.
    """
    actor = Actor("somebody", digest_avatar(avatar), (avatar,) * 4)
    person = EpisodePerson(
        number=1, identity="drawn:3:0", path=((1.3, 2.5), (3.4, 2.5)), speed=speed, after="back",
        stops=(
            PersonStop(at=1.0, seconds=3.0, look=75.0), PersonStop(at=1.6, seconds=3.0, look=-70.0),
        ),
    )  # fmt: skip
    state, routes = empty_crowd(1, 1), build_routes([person])
    state.walls[:] = -1
    place_people(state, 0, routes, [0])
    walls, nobody = build_walls([build_example_scene().grid]), np.array([[0.0, 0.0, -1.0]])
    poses, shifts, frames, doing = [], [], [], []
    for _ in range(round(10 * seconds)):
        step_crowd(state, routes, walls, nobody)
        shown, frame = show_person(person, actor, state.real[0, 0], state.whole[0, 0], None)
        pose, shift = turn_shown(actor, shown)
        poses.append(pose)
        shifts.append(shift)
        frames.append(frame)
        if shown.other:
            doing.append("set off" if shown.clip == "walk" else "stop")
        else:
            doing.append("walk" if shown.clip == "walk" else "turn")
    walker = Walker.of(avatar.joints, avatar.points.astype(np.float64), avatar.weights)
    turned, placed = place_joints(walker.joints, np.array(poses), np.array(shifts))
    world = np.array(frames)
    found: dict[str, F64] = {}
    kinds = np.array(doing)
    for kind in DOING:
        slides = []
        for foot in walker.feet(turned, placed):
            there = np.einsum("tab,tpb->tpa", world[:, :3, :3], foot @ TO_WORLD.T)
            there += world[:, None, :3, 3]
            for k in np.flatnonzero(kinds[1:] == kind):
                slides.append(meet_floor([there[k : k + 2]], 10.0, up=2).slides)
        found[kind] = np.concatenate(slides)
    return found


def step_lengths(walkers: Sequence[Walker]) -> tuple[F64, F64]:
    """Step at 1 m/s in one style, ankle to ankle, and length of the legs, of each body [N] m."""
    steps, legs = [], []
    for walker in walkers:
        motion = ClipLibrary(walker.build, seed=3).motion("walk", 1.0)
        _, placed = place_joints(walker.joints, motion.poses, motion.shift)
        ankles = placed[:, [INDEX["left_ankle"], INDEX["right_ankle"]], 2]
        steps.append(float(np.abs(ankles[:, 0] - ankles[:, 1]).max()))
        hip, ankle = walker.joints[INDEX["left_hip"]], walker.joints[INDEX["left_ankle"]]
        legs.append(float(hip[1] - ankle[1]))
    return np.array(steps), np.array(legs)


def bone_error(rig: RigMotion, motion: Motion) -> float:
    """The largest angle [degrees] between limbs of a file and of what it became, over all frames.

    The file's axes are turned to ours by the one rotation that fits all limbs in all frames best.
    """
    known = map_joints(rig, "")
    placed = _place_rig(rig)
    _, ours = place_joints(STANDING_JOINTS, motion.poses, motion.shift)
    theirs, mine = [], []
    for side in _SIDES:
        for bone in _BONES:
            start, end = (f"{side}_{part}" for part in bone.split())
            theirs.append(_unit(placed[:, known[end]] - placed[:, known[start]]))
            mine.append(_unit(ours[:, INDEX[end]] - ours[:, INDEX[start]]))
    a, b = np.concatenate(theirs), np.concatenate(mine)
    u, _, v = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
    apart = np.arctan2(np.linalg.norm(np.cross(a @ turn, b), axis=1), ((a @ turn) * b).sum(axis=1))
    return float(np.degrees(apart.max()))


def _unit(ways: F64) -> F64:
    return ways / np.linalg.norm(ways, axis=-1, keepdims=True)


def _matrices(quats: F64) -> F64:
    """Rotations [..., 3, 3] of unit quaternions (w, x, y, z)."""
    w, x, y, z = np.moveaxis(quats, -1, 0)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(rows, axis=-1).reshape(*w.shape, 3, 3)


def _place_rig(rig: RigMotion) -> F64:
    """Places of the joints of a rig in all frames [T, J, 3], in its axes and units."""
    turned = _matrices(rig.quats)
    placed = rig.translations.copy()
    for k, parent in enumerate(rig.parents):
        if parent >= 0:
            step = np.einsum("tab,tb->ta", turned[:, parent], rig.translations[:, k])
            placed[:, k] = placed[:, parent] + step
            turned[:, k] = turned[:, parent] @ turned[:, k]
    return placed


def change_rig(rig: RigMotion) -> dict[str, RigMotion]:
    """A rig in other units, with another axis up, and of half the frames."""
    tilt = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])  # y becomes z
    turn = _matrices(tilt)
    roots = [k for k, parent in enumerate(rig.parents) if parent < 0]
    quats, steps = rig.quats.copy(), rig.translations.copy()
    for root in roots:
        steps[:, root] = steps[:, root] @ turn.T
        w, x, y, z = np.moveaxis(rig.quats[:, root], -1, 0)
        c, s = tilt[:2]
        quats[:, root] = np.stack([c * w - s * x, c * x + s * w, c * y - s * z, c * z + s * y], -1)
    return {
        "units": replace(
            rig, rest_positions=39.37 * rig.rest_positions, translations=39.37 * rig.translations,
            metres=None,
        ),
        "up axis": replace(
            rig, rest_rotations=turn @ rig.rest_rotations,
            rest_positions=rig.rest_positions @ turn.T, quats=quats, translations=steps, up="",
        ),
        "frame rate": replace(
            rig, quats=rig.quats[::2], translations=rig.translations[::2], fps=rig.fps / 2
        ),
    }  # fmt: skip


def invariance(rig: RigMotion) -> dict[str, float]:
    """How far joints come to be from where they were [m], about the pelvis, by what is changed."""
    plain = retarget(rig, STANDING_JOINTS)
    _, first = place_joints(STANDING_JOINTS, plain.poses, plain.shift)
    found = {}
    for name, changed in change_rig(rig).items():
        motion = retarget(changed, STANDING_JOINTS)
        _, second = place_joints(STANDING_JOINTS, motion.poses, motion.shift)
        same = first[::2] if len(motion) < len(plain) else first
        found[name] = float(np.abs((same - same[:, :1]) - (second - second[:, :1])).max())
    return found


def round_trip(avatar: Avatar, folder: Path) -> tuple[float, int]:
    """How far poses that were written are from those read back [rad, m], and splats that differ."""
    build = measure_build(avatar.joints, avatar.points, avatar.weights)
    motion = play_motion(ClipLibrary(build).motion("wave"), 10.0)
    save_lhm_document(folder / "smplx.json", motion, avatar.betas, "gn0", avatar.joints)
    read = load_motion(folder / "smplx.json", avatar.joints)
    apart = max(np.abs(read.poses - motion.poses).max(), np.abs(read.shift - motion.shift).max())
    differ = 0
    for frame in (0, len(motion) // 2):
        posed = avatar.pose(motion.poses[frame], motion.shift[frame])
        save_ply(posed, folder / "frame.ply")
        cloud = load_cloud(folder / "frame.ply").cloud
        differ += abs(len(cloud) - len(posed))
        for name in ("means", "scales", "opacities", "quats"):
            values, back = getattr(posed, name), getattr(cloud, name)
            away = np.abs(values - back).reshape(len(values), -1).max(axis=1)
            differ += int((away > (0.0 if name == "means" else 1e-5)).sum())
    return float(apart), differ


def measure_motion(ctx: FigureContext) -> list[FigureRow]:
    """Feet, knees, hands and loops of the library; feet in the simulator; files and their bones."""
    walkers = open_walkers()
    rows = clip_rows(walkers, STYLES, ctx)
    avatars = [build_person(who, name=f"p{k}") for k, who in enumerate(PEOPLE)]
    rows += tick_rows(avatars, (0.4, 0.8, 1.3, 1.6))
    steps, legs = step_lengths(open_walkers([*PEOPLE, *draw_people(5, 12)]))
    rows.append(
        row_at_least("step length follows leg length, correlation of 16 bodies",
                     float(np.corrcoef(steps, legs)[0, 1]), 0.9, "",
                     f"steps {steps.min():.2f} to {steps.max():.2f} m at 1 m/s, one style")
    )  # fmt: skip
    apart, differ = round_trip(avatars[0], ctx.work)
    rows += [
        row_at_most("poses written to smplx.json and read back", apart, 1e-9, "rad, m"),
        row_at_most("splats of a posed PLY that are others when read", differ, 0, "splats"),
    ]
    return [*rows, *(file_rows(ctx.data / "humans") if ctx.data is not None else [])]


def clip_rows(walkers: Sequence[Walker], styles: int, ctx: FigureContext) -> list[FigureRow]:
    """Rows of the clips of the library."""
    kinds: dict[str, list[tuple[str, float]]] = {
        **{f"walk at {speed:g} m/s": [("walk", speed)] for speed in SPEEDS},
        "run": [("run", 1.0)],
        **{name: [(name, speed) for speed in SPEEDS] for name in ("start", "stop", "carry")},
        "other clips": [(n, 1.0) for n in CLIPS if n not in BY_SPEED and n != "run"],
    }
    detail = f"skin of {len(walkers)} bodies, {styles} styles each; points within 4 mm of the floor"
    rows, seen = [], _Clips([], [], [], [], [])
    for turn, (name, wanted) in enumerate(kinds.items()):
        ctx.progress("clips", turn, len(kinds))
        found = watch_clips(walkers, styles, wanted)
        slides = 100.0 * np.concatenate(found.slides)
        rows.append(
            row_at_most(f"{name}: slide of feet that stand, p95",
                        float(np.percentile(slides, 95)), 2.0, "cm/s", detail)
        )  # fmt: skip
        for part in ("lowest", "knees", "hands", "loops"):
            getattr(seen, part).extend(getattr(found, part))
    return [
        *rows,
        row_at_most("soles in the floor, deepest", -100.0 * min(seen.lowest), 1.0, "cm", detail),
        row_at_least("least bend of a knee", min(seen.knees), 0.0, "degrees", detail),
        row_at_least("least gap between hands and thighs", 100.0 * min(seen.hands), 0.0, "cm",
                     detail + "; 1 m where hands are elsewhere"),
        row_at_most("loops of the library: how far joints end from where they began",
                    100.0 * max(seen.loops), 1.0, "cm", detail),
    ]  # fmt: skip


def tick_rows(avatars: Sequence[Avatar], speeds: Sequence[float]) -> list[FigureRow]:
    """Rows of people in the simulator."""
    found: dict[str, list[F64]] = {kind: [] for kind in DOING}
    for avatar in avatars:
        for speed in speeds:
            for kind, slides in watch_ticks(avatar, speed).items():
                found[kind].append(slides)
    rows = []
    for kind, words in DOING.items():
        slides = 100.0 * np.concatenate(found[kind])
        rows.append(
            row_at_most(
                f"in the simulator, {words}: slide of feet that stand, p95",
                float(np.percentile(slides, 95)), 2.0, "cm/s",
                f"{len(slides)} feet from tick to tick (0.1 s), {len(avatars)} dressed people at "
                f"{', '.join(f'{v:g}' for v in speeds)} m/s; worst {slides.max():.2f}",
            )
        )  # fmt: skip
    return rows


def file_rows(humans: Path) -> list[FigureRow]:
    """Rows of the files of a folder of test data."""
    errors: dict[str, float] = {}
    for name in (*SAME, *OTHER):
        path = humans / name
        rig = decode_rig(path.read_bytes(), path)
        assert rig is not None
        errors[name] = bone_error(rig, retarget(rig, STANDING_JOINTS, path))
    path = humans / SAME[0]
    rig = decode_rig(path.read_bytes(), path)
    assert rig is not None
    walk = load_motion(humans / OTHER[0], clip="Walking")
    cycle = find_cycles(walk, STANDING_JOINTS)[0]
    loop = cut_cycle(walk, cycle, STANDING_JOINTS)
    _, placed = place_joints(STANDING_JOINTS, loop.poses, loop.shift)
    return [
        row_at_most("limbs of files against ours, same topology",
                    max(errors[name] for name in SAME), 1e-4, "degrees", f"{len(SAME)} files"),
        row_at_most("limbs of files against ours, another rig",
                    max(errors[name] for name in OTHER), 3.0, "degrees", "RobotExpressive"),
        *(row_at_most(f"other {name}: joints come to be elsewhere", 100.0 * away, 1e-4, "cm",
                      SAME[0]) for name, away in invariance(rig).items()),
        row_at_most("cycle found in a file: how far joints end from where they began",
                    100.0 * float(np.abs(placed[0] - placed[-1]).max()), 1.0, "cm",
                    f"RobotExpressive, Walking; {100 * cycle.closure:.2f} cm before it is closed"),
    ]  # fmt: skip


FIGURES = [Figure("avatars.motion", "How people move", measure_motion, 6.0)]
