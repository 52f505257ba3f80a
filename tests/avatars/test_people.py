"""Dressed people: told apart by eye, clothed as their records say, the same to the byte."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import combinations

import msgspec
import numpy as np
import pytest

from gn0.avatars.avatar import TO_WORLD, Avatar, contact_shadow
from gn0.avatars.colour_names import NAMES, draw_colour, lab_of, name_colour
from gn0.avatars.identity import Identity, draw_people
from gn0.avatars.layer import PARTS
from gn0.avatars.motion.legs import measure_build
from gn0.avatars.motion.library import ClipLibrary
from gn0.avatars.motion.standing import SEAT
from gn0.avatars.person import build_person, shape_identity
from gn0.avatars.poses import trial_poses
from gn0.avatars.skeleton import INDEX
from gn0.avatars.skinning import pose_joints
from gn0.avatars.wardrobe import BOTTOMS, TOPS
from gn0.errors import DataError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance
from gn0.seeds import random_stream
from gn0.viewer.avatar_check import (
    BOTTOM,
    TOP,
    check_avatar,
    measure_gaps,
    measure_skin,
    read_colour,
    score_colour,
)
from gn0.viewer.avatar_film import film_motion
from gn0.viewer.avatar_seat import find_height, place_seat, seat_person
from gn0.viewer.avatar_sheet import describe_avatar, draw_avatars, draw_portrait, list_record
from gn0_trials.people_small import small_person

WOMAN = Identity(seed=11, top="sweater", top_colour="red", top_pattern="knitted", bottom="slim")
MAN = Identity(
    seed=12, sex="man", build="heavy", hair="short01", top="shirt", top_colour="green",
    bottom="straight_trousers", bottom_colour="grey", shoes="boots", shoes_colour="brown",
)  # fmt: skip


@pytest.fixture(scope="module")
def woman() -> Avatar:
    return build_person(WOMAN, name="w")


def test_two_hundred_people_are_told_apart() -> None:
    people = draw_people(0, 200)
    assert min(a.differences(b) for a, b in combinations(people, 2)) >= 2
    assert max(Counter(person.silhouette() for person in people).values()) <= 8
    assert {person.sex for person in people} == {"woman", "man"}
    assert len({person.top for person in people}) == len(TOPS)
    assert len({person.bottom for person in people}) >= len(BOTTOMS)
    assert people == draw_people(0, 200)
    assert draw_people(1, 20) != people[:20]  # another seed, other people


def test_bodies_have_the_height_that_is_said() -> None:
    for person in draw_people(4, 12):
        height = shape_identity(person).height()
        assert 1.49 <= height <= 1.96
        short, tall = (1.61, 1.70) if person.sex == "woman" else (1.70, 1.82)
        assert (height < short) == (person.stature == "short") or person.stature == "medium"
        assert (height > tall) == (person.stature == "tall") or person.stature == "medium"


def test_a_person_is_made_the_same_again(woman: Avatar) -> None:
    first = small_person()
    again = build_person(draw_people(3, 4)[0], name=first.name, density=0.25)
    for name in ("points", "normals", "quats", "scales", "opacities", "albedo", "part"):
        assert getattr(again, name).tobytes() == getattr(first, name).tobytes(), name
    assert again.record == first.record and woman.record["top"] == "sweater"


def test_a_person_has_all_parts_and_stands_on_the_floor(woman: Avatar) -> None:
    assert 20_000 <= len(woman) <= 42_000
    worn = {PARTS[k] for k in np.unique(woman.part)}
    assert {"skin", "eyes", "brows", "hair", "top", "bottom", "shoes"} <= worn
    cloud = woman.pose(shadow=False)
    assert -0.06 < cloud.means[:, 2].min() < 0.03  # shoes have soles
    assert cloud.means[:, 0].max() > 0.1  # toes point along +x
    hand = woman.weights.joint[:, 0] == INDEX["left_middle1"]
    assert (cloud.means[hand, 1] > 0.4).all()  # the left is at +y
    head = cloud.means[woman.part == PARTS.index("eyes")]
    assert (head[:, 0] > 0.03).all()  # eyes look forward
    assert np.allclose(np.linalg.norm(cloud.normal, axis=1), 1.0, atol=1e-4)


def test_a_turn_of_the_root_turns_all_splats_rigidly(woman: Avatar) -> None:
    turn = np.zeros((55, 3))
    turn[0] = (0.0, 0.7, 0.0)
    still, turned = woman.pose(shadow=False), woman.pose(turn, shadow=False)
    c, s = np.cos(0.7), np.sin(0.7)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    pelvis = np.array([woman.joints[0, 2], woman.joints[0, 0], woman.joints[0, 1]])
    want = (still.means - pelvis) @ about_z.T + pelvis
    assert np.abs(turned.means - want).max() < 2e-6
    assert np.abs(turned.normal - still.normal @ about_z.T).max() < 2e-6


def test_poses_of_another_skeleton_are_refused(woman: Avatar) -> None:
    with pytest.raises(DataError, match=r"expected \[55, 3\]"):
        woman.pose(np.zeros((24, 3)))


def test_a_shadow_fades_as_feet_are_lifted(woman: Avatar) -> None:
    on_floor = contact_shadow(woman.joints)
    lifted = contact_shadow(woman.joints + np.array([0.0, 0.3, 0.0]))
    assert (lifted.opacities < on_floor.opacities).all()
    # over the middles of a floor's splats, and below the top of a shoe
    assert (on_floor.means[:, 2] > 0.01).all() and (on_floor.means[:, 2] < 0.03).all()


@pytest.mark.parametrize("size", [0.02, 0.06])
def test_a_shadow_shows_on_a_floor_of_small_and_of_large_splats(size: float) -> None:
    """A renderer draws splats by the depth of their middles: the floor must not hide the shadow."""
    places = np.arange(-1.2, 1.2, 1.4 * size)
    x, y = (a.ravel() for a in np.meshgrid(places, places))
    n = len(x)
    floor = RendererCpu(
        GaussianCloud(
            means=np.column_stack([x, y, 0 * x]).astype(np.float32),
            quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
            scales=np.tile(np.array([size, size, 0.001], np.float32), (n, 1)),
            opacities=np.full(n, 0.97, np.float32),
            sh=np.zeros((n, 1, 3), np.float32),  # mid-grey
        )
    )
    joints = small_person().joints  # at rest, standing
    floor.name_cloud("shadow", contact_shadow(joints))
    camera, view = Camera.from_vfov(240, 180, 50.0), view_from_pose(-2.5, 0.0, 1.3, 0.0)
    pictures = [
        floor.render(camera, view[None], parts=parts, outputs=("rgb",)).rgb
        for parts in ([], [Instance("shadow", np.eye(4))])
    ]
    bare, dark = (
        picture[0].astype(float).mean(axis=-1) for picture in pictures if picture is not None
    )
    seen = bare > 100
    shade = np.where(seen, dark / np.maximum(bare, 1.0), 1.0)
    # three large splats gave 0.89 there, and 15 px
    assert shade.min() < 0.82  # by the feet
    assert (shade < 0.9).sum() > 40  # px
    assert (np.abs(shade[:, :40] - 1.0) < 0.02).all()  # and nothing beside


@pytest.mark.parametrize("who", [WOMAN, MAN], ids=["woman", "man"])
def test_no_skin_shows_through_clothes(who: Identity, woman: Avatar) -> None:
    skin, cloth = measure_skin(woman if who is WOMAN else build_person(who), trial_poses())
    assert cloth > 10_000 and skin < 1e-3 * cloth


def test_clothes_meet_at_neck_wrist_and_waist() -> None:
    # a shirt in a skirt whose rim is lower in front than behind
    who = Identity(seed=9, top="long_sleeve", bottom="long_skirt", build="heavy", hair="long01")
    person = build_person(who, density=0.25)
    found = measure_gaps(person, trial_poses())
    assert {name: gaps for name, (gaps, _) in found.items()} == dict.fromkeys(found, 0)
    assert min(lines for _, lines in found.values()) > 100
    from dataclasses import replace

    hole = person.part == PARTS.index("top")
    hole &= np.abs(person.points[:, 1] - person.joints[INDEX["spine1"], 1]) < 0.06
    torn = replace(person, opacities=np.where(hole, 0, person.opacities).astype(np.float32))
    gaps, lines = measure_gaps(torn, trial_poses())["waist"]
    assert gaps > 0.05 * lines


@pytest.mark.slow
def test_skirts_and_coats_hold_in_a_stride() -> None:
    shown = {}
    for top, bottom in (
        ("dress", "none"), ("long_dress", "none"), ("coat", "slim"), ("tee_slim", "skirt"),
        ("vest", "short_skirt"), ("turtleneck", "long_skirt"),
    ):  # fmt: skip
        who = Identity(seed=5, top=top, bottom=bottom, top_colour="blue", bottom_colour="red")
        skin, cloth = measure_skin(build_person(who), trial_poses())
        shown[top, bottom] = skin / cloth
    assert sum(share < 1e-3 for share in shown.values()) >= 4, shown
    assert max(shown.values()) < 4e-3, shown


@pytest.mark.slow
def test_colours_are_read_from_pictures() -> None:
    scores = []
    for person in draw_people(2, 24):
        avatar = build_person(person, density=0.5)
        for part, name in ((TOP, "top"), (BOTTOM, "bottom")):
            read = read_colour(avatar, part) if (avatar.part == part).any() else ""
            if read:  # a coat hides what is under it
                scores.append(score_colour(getattr(person, f"{name}_colour"), read))
    assert len(scores) > 30 and np.mean(scores) >= 0.95


def test_names_of_colours_are_drawn_and_read_back() -> None:
    stream = random_stream(0, "colours")
    for name in NAMES:
        for _ in range(20):
            assert name_colour(draw_colour(name, stream)) == name
    # the white point and the primaries of sRGB in CIE L*a*b* (D65), as tables have them
    assert np.allclose(lab_of(np.ones(3)), (100, 0, 0), atol=0.02)
    assert np.allclose(lab_of(np.array([1.0, 0, 0])), (53.24, 80.09, 67.20), atol=0.05)
    assert np.allclose(lab_of(np.array([0, 0, 1.0])), (32.30, 79.19, -107.86), atol=0.05)
    assert score_colour("grey", "black") == 0.5 and score_colour("red", "blue") == 0.0


def test_a_check_finds_what_is_wrong(woman: Avatar) -> None:
    assert check_avatar(woman, trial_poses()[:1]) == []
    bare = replace(woman, part=np.where(woman.part == PARTS.index("shoes"), 0, woman.part))
    high = replace(woman, points=woman.points + np.float32([0, 0.5, 0]))
    wrong = replace(woman, record={**woman.record, "top_colour": "blue"})
    found = [{f.code for f in check_avatar(a, trial_poses()[:1])} for a in (bare, high, wrong)]
    assert "barefoot" in found[0] and "off-floor" in found[1] and "colour" in found[2]


def test_pages_show_everybody(woman: Avatar) -> None:
    sheet = draw_avatars([woman, woman])
    half = np.asarray(sheet)[:, : sheet.width // 2]
    assert np.array_equal(half, np.asarray(sheet)[:, sheet.width // 2 :])
    assert half.std() > 20  # somebody is there
    assert describe_avatar(woman)[1] == "red knitted sweater"
    assert np.asarray(draw_portrait(woman)).std() > 10
    mesh = replace(woman, record={"scaled": "0.386"})  # as `avatar import` makes of a .glb
    assert describe_avatar(mesh)[1] == f"{len(woman):,} splats"


@pytest.mark.parametrize("top", TOPS)
def test_garments_are_called_by_their_nouns(woman: Avatar, top: str) -> None:
    for bottom in BOTTOMS:
        worn = {"top": top, "bottom": bottom, "bottom_colour": "red", "bottom_pattern": "dotted"}
        _, above, below = describe_avatar(replace(woman, record={**woman.record, **worn}))
        assert above.split(" ")[-1] == TOPS[top].word.split(" ")[-1]
        assert below.split(" ")[-1] == BOTTOMS[bottom].word.split(" ")[-1]
        assert "red polka-dot" in below and "_" not in above + below


def test_a_record_is_listed_with_words_for_its_cuts() -> None:
    record = {"sex": "man", "top": "tee_slim", "top_pattern": "patched", "bottom": "slim",
              "shoes": "laced", "hair": "bob02", "hat": "none", "extra": "scarf"}  # fmt: skip
    assert list_record(record) == [
        ("sex", "man"), ("top", "tee_slim (T-shirt)"), ("top_pattern", "patched (camouflage)"),
        ("bottom", "slim (jeans)"), ("shoes", "laced (shoes)"),
        ("hair", "bob02 (chin-length hair)"), ("hat", "none"), ("extra", "scarf"),
    ]  # fmt: skip


@pytest.mark.parametrize("height", [0.35, 0.45])
def test_who_is_shown_seated_sits_on_a_seat_with_the_feet_on_the_floor(
    woman: Avatar, height: float
) -> None:
    build = measure_build(woman.joints, woman.points, woman.weights)
    motion = ClipLibrary(build, 0, height).motion("sit")
    _, joints = pose_joints(woman.joints, motion.poses[0], motion.shift[0])
    pelvis = joints[0] @ TO_WORLD.T
    assert find_height(woman, pelvis[2]) == pytest.approx(height, abs=1e-3)
    body = woman.pose(motion.poses[0], motion.shift[0], shadow=False)
    block = place_seat(pelvis, height)
    assert abs(float(body.means[:, 2].min())) < 0.02 and block.means[:, 2].min() == 0.0
    over = np.abs(body.means[:, :2] - np.float32(pelvis[:2])).max(axis=1) < 0.12
    assert abs(float(body.means[over, 2].min()) - height) < 0.06  # lies on it
    calves = body.means[(body.means[:, 2] < height - 0.1) & (body.means[:, 2] > 0.05)]
    assert calves[:, 0].min() > block.means[:, 0].max()  # and not within it
    if height == SEAT:
        assert len(seat_person(woman)) > len(body) + len(block)  # and a shadow
    with_seat, without = (
        film_motion(woman, replace(motion, category=kind), [0])[0] for kind in ("sit", "")
    )
    assert (with_seat != without).any(axis=-1).sum() > 500


@pytest.mark.parametrize("shoes", ["boots", "laced", "trainers"])
def test_soles_do_not_lean_with_shanks(shoes: str) -> None:
    """Shoes hang on three vertices a side, one behind the shank: they have the skin's weights."""
    avatar = build_person(msgspec.structs.replace(WOMAN, shoes=shoes), name="w", density=0.3)
    dense = avatar.weights.dense()
    worn = avatar.part == PARTS.index("shoes")
    low = worn & (avatar.points[:, 1] < avatar.points[worn, 1].min() + 0.03)
    assert low.sum() > 50
    shanks = dense[low][:, [INDEX["left_knee"], INDEX["right_knee"]]].sum(axis=1)
    feet = [INDEX[f"{side}_{part}"] for side in ("left", "right") for part in ("ankle", "foot")]
    assert shanks.max() < 0.06 and dense[low][:, feet].sum(axis=1).min() > 0.9
