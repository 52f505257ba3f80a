"""The default library of motion, measured on the skin of bodies that it moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gn0.avatars.identity import Identity
from gn0.avatars.motion import stepping
from gn0.avatars.motion.cycles import loop_closure
from gn0.avatars.motion.feet import find_contacts, measure_soles, move_joints
from gn0.avatars.motion.gait import (
    PHASES,
    SPEEDS,
    draw_style,
    plan_gait,
    shape_gait,
    walk_motion,
)
from gn0.avatars.motion.hands import box_held, plan_busy
from gn0.avatars.motion.legs import Build, measure_build
from gn0.avatars.motion.library import (
    BLEND_SECONDS,
    CLIPS,
    LOOKS,
    LOOPS,
    ClipLibrary,
    look_class,
    speed_class,
    turn_head,
)
from gn0.avatars.motion.motion import Motion
from gn0.avatars.motion.play import play_motion
from gn0.avatars.motion.standing import ease
from gn0.avatars.motion.standing_joints import STANDING_JOINTS
from gn0.avatars.person import shape_identity
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import SkinWeights, pose_joints, skin_points
from gn0.errors import DataError

NEAR = 0.004  # m above the floor that skin which rests is
PEOPLE = {
    "small woman": Identity(seed=1, stature="short", build="slim"),
    "tall woman": Identity(seed=2, stature="tall", build="average"),
    "heavy man": Identity(seed=3, sex="man", stature="tall", build="heavy"),
    "short man": Identity(seed=4, sex="man", stature="short", build="muscular"),
}
HANDS = [INDEX[f"{s}_{n}"] for s in ("left", "right") for n in ("wrist", "middle1", "index3")]


@dataclass
class Skin:
    """The skin of a body, and which joint carries each point most."""

    joints: np.ndarray
    points: np.ndarray
    weights: SkinWeights
    main: np.ndarray
    build: Build

    def posed(self, joints: tuple[str, ...], pose: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """Posed points that hang on joints."""
        there = np.isin(self.main, [INDEX[name] for name in joints])
        few = SkinWeights(self.weights.joint[there], self.weights.weight[there])
        return skin_points(self.points[there], few, pose_joints(self.joints, pose, shift)[0])


def skin_of(who: Identity) -> Skin:
    shape = shape_identity(who)
    skin = np.unique(shape.model.triangles)
    weights = SkinWeights(shape.model.weights.joint[skin], shape.model.weights.weight[skin])
    points = shape.vertices[skin]
    main = weights.joint[np.arange(len(skin)), np.argmax(weights.weight, axis=1)]
    return Skin(shape.joints, points, weights, main, measure_build(shape.joints, points, weights))


@pytest.fixture(scope="module")
def skins() -> dict[str, Skin]:
    return {name: skin_of(who) for name, who in PEOPLE.items()}


@dataclass
class Steps:
    """How feet meet the floor.

    A foot rolls from heel to tip: a point of it rests, and others turn about it. `slowest` is the
    pace of the point that rests, `middle` the median of all that are near the floor [N] m/s;
    `lowest` is the lowest point of both feet at each frame [T] m.
    """

    slowest: np.ndarray
    middle: np.ndarray
    lowest: np.ndarray


def watch_feet(skin: Skin, motion: Motion) -> Steps:
    """How the skin of feet meets the floor."""
    carried = [np.isin(skin.main, [INDEX[f"{s}_{p}"] for p in ("ankle", "foot")])
               for s in ("left", "right")]  # fmt: skip
    both = carried[0] | carried[1]
    few = SkinWeights(skin.weights.joint[both], skin.weights.weight[both])
    points = skin.points[both]
    places = np.empty((len(motion), len(points), 3))
    for k in range(len(motion)):
        transforms, _ = pose_joints(skin.joints, motion.poses[k], motion.shift[k])
        places[k] = skin_points(points, few, transforms)
    if motion.displacement is not None:
        places[..., 2] += motion.displacement[:, None]
    slowest, middle = [], []
    for one in carried:
        foot = places[:, one[both]]
        pace = np.linalg.norm(np.diff(foot[..., [0, 2]], axis=0), axis=-1) * motion.fps
        rests = (foot[1:, :, 1] < NEAR) & (foot[:-1, :, 1] < NEAR)
        for k in np.flatnonzero(rests.sum(axis=1) >= 3):
            slowest.append(pace[k][rests[k]].min())
            middle.append(np.median(pace[k][rests[k]]))
    return Steps(np.array(slowest), np.array(middle), places[..., 1].min(axis=1))


def knee_bends(skin: Skin, motion: Motion) -> np.ndarray:
    """Bend of both knees [T, 2] rad, to the back positive, from where joints are."""
    turned, placed = move_joints(motion, skin.joints)
    bends = []
    for side in ("left", "right"):
        hip, knee, ankle = (INDEX[f"{side}_{part}"] for part in ("hip", "knee", "ankle"))
        thigh, shank = placed[:, knee] - placed[:, hip], placed[:, ankle] - placed[:, knee]
        across = turned[:, hip, :, 0]
        bends.append(np.arctan2((np.cross(thigh, shank) * across).sum(1), (thigh * shank).sum(1)))
    return np.array(bends).T


def hands_clear(skin: Skin, motion: Motion) -> float:
    """The least distance of hands from thighs [m], below 0 inside, over all frames."""
    _, placed = move_joints(motion, skin.joints)
    least = 1.0
    for side in ("left", "right"):
        hip, knee = INDEX[f"{side}_hip"], INDEX[f"{side}_knee"]
        bone = skin.joints[knee] - skin.joints[hip]
        length = np.linalg.norm(bone)
        rest = skin.points[skin.main == hip] - skin.joints[hip]
        part = rest @ bone / length**2
        radius = np.linalg.norm(rest - part[:, None] * bone, axis=1)
        # inner thighs bulge; hands come from outside and before
        thick = [
            float(np.quantile(radius[np.abs(part - p) < 0.06], 0.9)) for p in (0.3, 0.5, 0.7, 0.9)
        ]
        axis = placed[:, knee] - placed[:, hip]
        gap = placed[:, HANDS] - placed[:, None, hip]
        along = np.einsum("tkc,tc->tk", gap, axis) / length**2
        away = np.linalg.norm(gap - along[..., None] * axis[:, None], axis=-1)
        beside = (along > 0.25) & (along < 1.0)
        if beside.any():
            clear = away - np.interp(along, (0.3, 0.5, 0.7, 0.9), thick)
            least = min(least, float(clear[beside].min()))
    return least


@pytest.mark.parametrize("speed", SPEEDS)
def test_walks_stand_on_their_feet(skins: dict[str, Skin], speed: float) -> None:
    for number, (who, skin) in enumerate(skins.items()):
        motion = walk_motion(skin.build, speed, number)
        steps = watch_feet(skin, motion)
        assert np.percentile(steps.slowest, 95) < 0.02, who
        assert np.median(steps.middle) < 0.02, who
        assert steps.lowest.min() > -0.01 and steps.lowest.max() < 0.01, who
        house = measure_soles(find_contacts(motion, skin.joints), skin.joints)
        assert house.skate < 0.02 and house.lowest > -0.01, who
        bends = knee_bends(skin, motion)
        assert bends.min() > np.radians(3) and bends.max() < np.radians(85), who
        assert hands_clear(skin, motion) > 0.0, who
        # nobody walks crouched: the leg that carries all comes to be nearly straight
        assert bends[round(0.2 * PHASES) : round(0.36 * PHASES), 0].min() < np.radians(14), who
        assert motion.loop and len(motion) == PHASES + 1
        assert loop_closure(motion, skin.joints) == 0.0
        assert np.array_equal(motion.poses[0], motion.poses[-1])


def test_feet_that_leave_or_land_do_not_jump(skins: dict[str, Skin]) -> None:
    """Rolling on its tip, a foot that points outwards has gone aside: there its swing begins."""
    phases = np.arange(0.0, 1.0, 1.0 / 1024)
    for number, skin in enumerate(skins.values()):
        style = draw_style(number)
        for speed in (0.4, 1.6):
            plan = plan_gait(skin.build, shape_gait(skin.build, speed, style), style, phases)
            # 1.5 m in a cycle, and a foot in the air about three times as fast
            steps = np.abs(np.diff(plan.ankles, axis=0, append=plan.ankles[:1]))
            assert steps[..., 0].max() < 0.001, speed
            assert steps.max() < 0.006, speed


def test_steps_follow_legs_and_speed(skins: dict[str, Skin]) -> None:
    def step(skin: Skin, speed: float) -> float:
        # from where both heels are when feet stand, not from what was meant
        motion = walk_motion(skin.build, speed)
        _, placed = move_joints(motion, skin.joints)
        left, right = (placed[:, INDEX[f"{s}_ankle"], 2] for s in ("left", "right"))
        return float(np.abs(left - right).max())

    legs = {w: s.joints[INDEX["left_hip"], 1] - s.joints[INDEX["left_ankle"], 1]
            for w, s in skins.items()}  # fmt: skip
    order = sorted(skins, key=lambda who: legs[who])
    for speed in (0.5, 1.3):
        steps = [step(skins[who], speed) for who in order]
        assert np.all(np.diff(steps) > 0)
        assert steps[-1] / steps[0] > 1.1
    assert np.all(np.diff([step(skins["tall woman"], v) for v in SPEEDS]) > 0.02)


def test_a_run_flies_and_lands(skins: dict[str, Skin]) -> None:
    for who, skin in skins.items():
        motion = walk_motion(skin.build, 2.6, 3)
        lows = watch_feet(skin, motion).lowest
        assert lows.min() > -0.01 and (lows > 0.01).mean() > 0.05, who
        assert knee_bends(skin, motion).min() > 0 and hands_clear(skin, motion) > 0, who


@pytest.mark.parametrize("who", PEOPLE)
def test_clips_keep_their_feet(skins: dict[str, Skin], who: str) -> None:
    skin = skins[who]
    library = ClipLibrary(skin.build, seed=7)
    for name in CLIPS:
        if name in ("walk", "run", "carry"):
            continue
        for speed in (0.5, 1.0, 1.6) if name in ("start", "stop") else (1.0,):
            motion = library.motion(name, speed)
            steps = watch_feet(skin, motion)
            assert np.percentile(steps.slowest, 95) < 0.02, name
            assert steps.lowest.min() > -0.01, name
            assert knee_bends(skin, motion).min() > np.radians(1.0), name
            assert hands_clear(skin, motion) > -0.005, name
            # nothing jumps: joints turn by some degrees in a thirtieth of a second
            assert motion.fps == 30.0
            quats = Rotation.from_rotvec(motion.poses.reshape(-1, 3)).as_matrix()
            frames = quats.reshape(len(motion), 55, 3, 3)
            turns = np.einsum("tkba,tkbc->tkac", frames[:-1], frames[1:])
            angles = np.arccos(np.clip((np.trace(turns, axis1=2, axis2=3) - 1) / 2, -1, 1))
            assert angles.max() < np.radians(22), (name, speed)


@pytest.mark.parametrize("who", PEOPLE)
def test_busy_hands_are_where_they_belong(skins: dict[str, Skin], who: str) -> None:
    skin = skins[who]
    library = ClipLibrary(skin.build, seed=7)

    def hands(name: str) -> tuple[np.ndarray, np.ndarray]:
        _, placed = move_joints(library.motion(name, 1.0), skin.joints)
        return placed, placed[:, [INDEX["left_middle1"], INDEX["right_middle1"]]]

    placed, at = hands("phone")
    ear = placed[:, INDEX["head"]] + (0.0, 0.03, 0.0)
    assert np.linalg.norm(at[:, 1] - ear, axis=1).max() < 0.17
    assert np.linalg.norm(at[:, 1] - ear, axis=1).min() > 0.07  # beside the head, not in it
    for name in ("hold", "carry"):
        placed, at = hands(name)
        apart = at[:, 0] - at[:, 1]
        assert np.abs(np.linalg.norm(apart, axis=1) - 0.45).max() < 0.04, name
        middle = at.mean(axis=1) - placed[:, INDEX["spine1"]]
        assert middle[:, 2].min() > 0.25 and np.abs(middle[:, 1]).max() < 0.3, name
    centre, size = box_held(skin.build)
    assert centre[2] - size[2] / 2 > skin.build.joints[INDEX["spine1"], 2] + 0.1  # before the belly
    motion = library.motion("carry", 1.0)
    steps = watch_feet(skin, motion)
    assert np.percentile(steps.slowest, 95) < 0.02 and steps.lowest.min() > -0.01
    assert hands_clear(skin, motion) > 0.0
    assert np.array_equal(motion.poses[0], motion.poses[-1])
    _, at = hands("talk")
    assert np.ptp(at[:, :, 1], axis=0).min() > 0.04  # both hands speak
    assert (at[:, 0, 0] - at[:, 1, 0]).min() > 0.1  # and do not meet
    with pytest.raises(DataError, match="juggle"):
        plan_busy(skin.build, library.style, "juggle")


@pytest.mark.parametrize("pair", [(0.3, 0.5), (0.8, 1.0), (1.0, 1.3), (1.6, 1.3), (1.3, 0.8)])
def test_walks_blend_over_the_foot_that_stands(
    skins: dict[str, Skin], pair: tuple[float, float]
) -> None:
    for who in ("small woman", "heavy man"):
        skin = skins[who]
        library = ClipLibrary(skin.build, seed=2)
        motion = blend_walks(library, *pair)
        steps = watch_feet(skin, motion)
        assert np.percentile(steps.slowest, 95) < 0.02 and steps.lowest.min() > -0.01, who


def blend_walks(library: ClipLibrary, speed: float, other: float) -> Motion:
    """A blend from one walk to another as a person walks through it."""
    fps, seconds = 60.0, library.blend_seconds(speed, other)
    assert BLEND_SECONDS[0] <= seconds <= BLEND_SECONDS[1]
    phase, _ = library.alone(speed)
    poses, shifts, way = [], [], [0.0]
    count = round(seconds * fps)
    for k in range(count + 1):
        share = float(ease(np.array(k / count)))
        there = library.aligned_phase(phase, speed, other)
        pose, shift = library.blend_at(("walk", phase, speed), ("walk", there, other), share)
        poses.append(pose)
        shifts.append(shift)
        step = (speed * (1 - share) + other * share) / fps
        way.append(way[-1] + step)
        phase += step / library.clip("walk", speed).stride
    return Motion(
        np.array(poses), np.array(shifts), fps, library.build.hip_height,
        displacement=np.array(way[:-1]),
    )  # fmt: skip


def test_standing_clips_blend_with_feet_planted(skins: dict[str, Skin]) -> None:
    skin = skins["short man"]
    library = ClipLibrary(skin.build)
    rows = [
        library.blend_at(("idle_2", 3.0 + k / 30, 0.0), ("wave", 1.0 + k / 30, 0.0), k / 9)
        for k in range(10)
    ]
    poses, shifts = (np.array([row[j] for row in rows]) for j in (0, 1))
    steps = watch_feet(skin, Motion(poses, shifts, 30.0, 0.9))
    assert steps.middle.max() < 0.01 and len(steps.slowest) == 18
    # the ends of what follows one another are one pose
    for first, second in (("sit_down", "sit"), ("sit", "stand_up")):
        end, begin = library.table(first)[0][-1], library.table(second)[0][0]
        assert np.abs(end - begin).max() < 0.05, (first, second)
    start, walk = library.clip("start", 1.0), library.table("walk", 1.0)
    end = library.blend_at(("walk", start.meets, 1.0), ("walk", start.meets, 1.0), 0.0)
    assert np.abs(library.table("start", 1.0)[0][-1] - end[0]).max() < 0.05
    assert len(walk[0]) == PHASES


def test_seats_have_the_height_that_is_asked_for(skins: dict[str, Skin]) -> None:
    for who, skin in skins.items():
        for seat in (0.42, 0.5):
            pose, shift = ClipLibrary(skin.build, seat=seat).pose_at("sit", 1.0)
            bottom = skin.posed(("pelvis", "left_hip", "right_hip"), pose, shift)
            pelvis = pose_joints(skin.joints, pose, shift)[1][0]
            below = bottom[np.abs(bottom[:, 2] - pelvis[2]) < 0.12, 1].min()
            assert abs(below - seat) < 0.03, (who, below)
    with pytest.raises(DataError, match="seat"):
        ClipLibrary(skins["short man"].build, seat=0.9).clip("sit")


def test_the_same_seed_walks_alike_and_others_do_not() -> None:
    build = measure_build(STANDING_JOINTS)
    first, again, other = (walk_motion(build, 1.0, seed) for seed in (5, 5, 6))
    assert first.poses.tobytes() == again.poses.tobytes()
    assert first.shift.tobytes() == again.shift.tobytes()
    assert np.abs(first.poses - other.poses).max() > 0.02
    one, two = (ClipLibrary(build, seed=4) for _ in range(2))
    for name in CLIPS:
        assert one.table(name)[0].tobytes() == two.table(name)[0].tobytes()


def test_a_library_is_read_by_phase_or_time() -> None:
    library = ClipLibrary(measure_build(STANDING_JOINTS))
    poses, _ = library.table("walk", 1.3)
    assert np.array_equal(library.pose_at("walk", 0.5, 1.3)[0], poses[32])
    assert np.array_equal(library.pose_at("walk", 1.0, 1.3)[0], poses[0])
    assert np.array_equal(library.pose_at("wave", 99.0)[0], library.table("wave")[0][-1])
    assert library.table("walk", 1.3)[0] is library.table("walk", 1.25)[0]  # one class
    assert set(LOOPS) < set(library.names)
    assert library.clip("walk", 0.5).stride < library.clip("walk", 1.6).stride
    # planted feet are drawn at most 1.2 cm off: half a phase of way
    assert library.clip("walk", 1.6).stride / PHASES / 2 < 0.0125
    assert [speed_class(v) for v in (0.0, 0.45, 1.02, 9.0)] == [0, 1, 3, 5]
    with pytest.raises(DataError, match="moonwalk"):
        library.pose_at("moonwalk", 0.0)
    with pytest.raises(DataError, match="nobody walks"):
        walk_motion(library.build, 9.0)


def test_heads_look_aside() -> None:
    library = ClipLibrary(measure_build(STANDING_JOINTS))
    pose, shift = library.pose_at("walk", 0.2)

    def heading(at: np.ndarray) -> float:
        front = pose_joints(STANDING_JOINTS, at, shift)[0][INDEX["head"], :, 2]
        return float(np.degrees(np.arctan2(front[0], front[2])))

    for k, yaw in enumerate(LOOKS):
        looked = turn_head(pose, np.radians(yaw))
        assert abs(heading(looked) - heading(pose) - yaw) < 6.0
        changed = np.flatnonzero(np.abs(looked - pose).max(axis=1) > 0)
        assert set(changed) <= {INDEX["neck"], INDEX["head"]}
        assert look_class(np.radians(yaw)) == k
    assert np.allclose(turn_head(pose, 3.0), turn_head(pose, np.pi / 3))
    poses, yaws = library.table("walk")[0], np.radians(np.resize(LOOKS, PHASES))
    alone = [turn_head(one, yaw) for one, yaw in zip(poses, yaws, strict=True)]
    assert np.array_equal(turn_head(poses, yaws), alone), "to the bit"


def test_motions_are_played_at_a_rate() -> None:
    library = ClipLibrary(measure_build(STANDING_JOINTS))
    walk = play_motion(library.motion("walk", 1.0), 25.0, 4.0)
    assert len(walk) == 101 and walk.fps == 25.0
    assert walk.shift[-1, 2] - walk.shift[0, 2] == pytest.approx(4.0, abs=0.02)
    start = play_motion(library.motion("start", 1.0), 30.0)
    way = library.clip("start", 1.0).way
    assert way is not None
    assert start.shift[-1, 2] - start.shift[0, 2] == pytest.approx(way[-1], abs=0.03)
    assert len(play_motion(library.motion("idle_1"), 10.0, 30.0)) == 301
    assert len(play_motion(library.motion("wave"), 30.0, 1.0)) == 31
    with pytest.raises(DataError, match="one frame"):
        play_motion(library.motion("wave"), 5.0, 0.1)


STEPS = (
    stepping.Steps(1, True, 0.0, 0.0),
    stepping.Steps(0, False, -0.04, 0.0),
    stepping.Steps(0, True, 0.012, 0.3),
)


@pytest.mark.parametrize("steps", [(), STEPS])
def test_blends_are_the_same_bits_together_and_alone(steps: tuple[stepping.Steps, ...]) -> None:
    library = ClipLibrary(measure_build(STANDING_JOINTS))
    blends = [
        (("walk", 0.3, 1.0), ("idle_1", 0.0, 0.0), 0.25),
        (("pivot_left", 0.4, 0.0), ("walk", 0.7, 1.3), 0.6),
        (("idle_2", 1.1, 0.0), ("wave", 0.4, 0.0), 0.9),
    ]
    poses, shifts = library.blend_all(blends, steps=steps or None)
    for n, (pose, shift, blend) in enumerate(zip(poses, shifts, blends, strict=True)):
        alone = library.blend_at(*blend, steps=steps[n] if steps else None)
        assert np.array_equal(pose, alone[0]) and np.array_equal(shift, alone[1])
