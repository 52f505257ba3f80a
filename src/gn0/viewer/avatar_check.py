"""What can be wrong with an avatar: skin through clothes, feet off the floor, wrong colours.

Pictures are drawn with each splat's part for its object, so that what a pixel shows can be counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gn0.avatars.avatar import TO_WORLD, Avatar
from gn0.avatars.colour_names import NEIGHBOURS, name_colour
from gn0.avatars.layer import PARTS
from gn0.avatars.poses import standing_pose
from gn0.avatars.skeleton import INDEX, JOINTS
from gn0.avatars.skinning import pose_joints
from gn0.config import Config
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.film import decode_srgb
from gn0.geometry import F64
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.viewer.avatar_sheet import view_person

SKIN, TOP, BOTTOM = (PARTS.index(name) for name in ("skin", "top", "bottom"))
_CAMERA = Camera.from_vfov(480, 360, 70.0)
_BARE = ("wrist", "index", "middle", "pinky", "ring", "thumb", "head", "jaw", "eye", "neck")
_NEAR = 0.03  # of cloth before or behind the skin that shows through it [m]
_SHOWS = 3e-3  # of cloth from which on skin is told of: an arm below a hem gives up to 2e-3
_INSIDE = 2  # px from the outline of cloth
_TRUNK = ("pelvis", "spine1", "spine2", "left_hip", "right_hip")
_CROPPED = ("sports_top",)  # tops that end above the waist


class AvatarFinding(Config, frozen=True):
    """One thing worth knowing about an avatar: a stable code, and what is so."""

    code: str
    text: str


def measure_skin(
    avatar: Avatar, poses: Sequence[F64 | None], turns: Sequence[float] = (0.0, 1.57, 3.14, 4.71)
) -> tuple[int, int]:
    """Pixels of skin that show within the outline of cloth that should hide them, and of cloth.

    Hands, neck and head are not counted: they may lie before cloth. Of the rest a pixel counts
    where it shows skin well within the outline of top or bottom, and the outside of cloth lies
    close to it: through a sleeve's opening one sees its inside.

    Args:
        avatar: who.
        poses: poses tried [55, 3] rad.
        turns: angles from which each is seen [rad].
    """
    shown = cloth_pixels = 0
    heaviest = avatar.weights.joint[:, 0]
    bare = np.array([any(word in name for word in _BARE) for name in JOINTS])[heaviest]
    cloth = np.isin(avatar.part, (TOP, BOTTOM))
    skin = (avatar.part == SKIN) & ~bare
    for pose in poses:
        cloud = avatar.pose(pose, shadow=False)
        views = np.array([view_person(turn, 2.0) for turn in turns])
        whole = RendererCpu(replace(cloud, label=np.where(skin, 1, 0).astype(np.int32)))
        seen = whole.render(_CAMERA, views, outputs=("instance", "depth"))
        assert seen.instance is not None and seen.depth is not None
        dressed = cloud.select(cloth)
        for k, view in enumerate(views):
            eye = -view[:3, :3].T @ view[:3, 3]
            assert dressed.normal is not None
            faced = np.einsum("na,na->n", dressed.normal, eye - dressed.means) > 0
            alone = RendererCpu(replace(dressed, label=faced.astype(np.int32))).render(
                _CAMERA, view[None], outputs=("depth", "alpha", "instance")
            )
            assert alone.alpha is not None and alone.depth is not None
            assert alone.instance is not None
            inside = ndimage.binary_erosion(alone.alpha[0] > 0.9, iterations=_INSIDE)
            inside &= alone.instance[0] == 2
            with np.errstate(invalid="ignore"):
                close = np.abs(alone.depth[0] - seen.depth[k]) < _NEAR
            shown += int((inside & close & (seen.instance[k] == 2)).sum())
            cloth_pixels += int(inside.sum())
    return shown, cloth_pixels


def measure_gaps(
    avatar: Avatar, poses: Sequence[F64 | None], turns: Sequence[float] = (0.0, 1.57, 3.14, 4.71)
) -> dict[str, tuple[int, int]]:
    """Sight lines to the bones at neck, wrists and waist, and how many of them meet a gap.

    A line ends at a point inside the body: of the neck, of a forearm's end and a wrist, of the
    trunk where top and bottom meet. Something has to lie before it, and at the waist it must be no
    skin where top and bottom are worn.

    Args:
        avatar: who.
        poses: poses tried [55, 3] rad.
        turns: angles from which each is seen [rad].

    Returns:
        (gaps, lines) of "neck", "wrist" and "waist".
    """
    inside = _points_inside(avatar)
    worn = bool((avatar.part == TOP).any() and (avatar.part == BOTTOM).any())
    trunk = np.isin(avatar.weights.joint[:, 0], [INDEX[name] for name in _TRUNK])
    bare = ((avatar.part == SKIN) & trunk).astype(np.int32)  # not an arm that hangs before it
    counts = {name: [0, 0] for name in inside}
    for pose in poses:
        cloud = avatar.pose(pose, shadow=False)
        transforms, _ = pose_joints(avatar.joints, np.zeros((55, 3)) if pose is None else pose)
        views = np.array([view_person(turn, 2.0) for turn in turns])
        drawn = RendererCpu(replace(cloud, label=bare))
        seen = drawn.render(_CAMERA, views, outputs=("instance", "depth"))
        assert seen.instance is not None and seen.depth is not None
        for name, points in inside.items():
            at = np.array([transforms[j, :, :3] @ p + transforms[j, :, 3] for j, p in points])
            for k, view in enumerate(views):
                x, y, z = (at @ TO_WORLD.T @ view[:3, :3].T + view[:3, 3]).T
                column = np.floor(_CAMERA.fx * x / z + _CAMERA.cx).astype(int)
                row = np.floor(_CAMERA.fy * y / z + _CAMERA.cy).astype(int)
                within = (column >= 0) & (column < _CAMERA.width)
                within &= (row >= 0) & (row < _CAMERA.height)
                row, column, z = row[within], column[within], z[within]
                depth, part = seen.depth[k][row, column], seen.instance[k][row, column]
                gap = ~(depth < z)
                if name == "waist" and worn and avatar.record.get("top") not in _CROPPED:
                    gap |= part == 2
                counts[name][0] += int(gap.sum())
                counts[name][1] += len(gap)
    return {name: (gaps, lines) for name, (gaps, lines) in counts.items()}


def _points_inside(avatar: Avatar) -> dict[str, list[tuple[int, F64]]]:
    """Points inside a body at rest where its clothes meet, and the joint that carries each."""
    at = {name: avatar.joints[k] for name, k in INDEX.items()}
    found: dict[str, list[tuple[int, F64]]] = {"neck": [], "wrist": [], "waist": []}
    for share in np.linspace(0.0, 0.8, 5):
        for aside in (-0.02, 0.0, 0.02):
            point = at["neck"] + share * (at["head"] - at["neck"]) + (aside, 0.0, 0.0)
            found["neck"].append((INDEX["neck"], point))
    for side in ("left", "right"):
        elbow, wrist, hand = (at[f"{side}_{name}"] for name in ("elbow", "wrist", "middle1"))
        for share in np.linspace(0.6, 1.0, 5):
            found["wrist"].append((INDEX[f"{side}_elbow"], elbow + share * (wrist - elbow)))
        for share in (0.15, 0.3, 0.45):
            found["wrist"].append((INDEX[f"{side}_wrist"], wrist + share * (hand - wrist)))
    low, high = at["pelvis"], at["spine2"]
    for share in np.linspace(0.0, 1.0, 9):
        for aside in (-0.06, 0.0, 0.06):
            joint = INDEX["pelvis" if share < 0.35 else "spine1" if share < 0.7 else "spine2"]
            found["waist"].append((joint, low + share * (high - low) + (aside, 0.0, 0.0)))
    return found


def read_colour(avatar: Avatar, part: int, distance: float = 3.0, light: F64 | None = None) -> str:
    """The name of a part's colour, read from a picture 480 x 360 of its front; "" if it is unseen.

    The median of its pixels, divided by what a grey card shows in the same light [3] (white light
    without one).
    """
    cloud = avatar.pose(standing_pose(), shadow=False)
    views = view_person(0.25, distance)[None]
    result = RendererCpu(cloud).render(_CAMERA, views, outputs=("rgb", "instance"))
    assert result.rgb is not None and result.instance is not None
    here = result.instance[0] == part + 1
    if here.sum() < 12:
        return ""
    colour = np.median(decode_srgb(result.rgb[0][here] / 255.0).astype(np.float64), axis=0)
    return name_colour(colour if light is None else colour / light)


def score_colour(said: str, read: str) -> float:
    """1 for the right name of a colour, 0.5 for one a step off, 0 else."""
    if said == read:
        return 1.0
    return 0.5 if {said, read} in [set(pair) for pair in NEIGHBOURS] else 0.0


def check_avatar(avatar: Avatar, poses: Sequence[F64 | None]) -> list[AvatarFinding]:
    """What is wrong with an avatar, in plain words; nothing if all is well."""
    found = []
    cloud = avatar.pose(shadow=False)
    low, high = float(cloud.means[:, 2].min()), float(cloud.means[:, 2].max())
    if not -0.06 < low < 0.04:
        found.append(
            AvatarFinding(code="off-floor", text=f"its soles are {low:+.2f} m off the floor")
        )
    if not 1.2 < high - low < 2.3:
        found.append(AvatarFinding(code="height", text=f"it is {high - low:.2f} m tall"))
    away = _away_from_joints(avatar, cloud)
    if away > 0.6:
        found.append(AvatarFinding(code="stray", text=f"a splat lies {away:.1f} m off all joints"))
    if {TOP, BOTTOM} & set(np.unique(avatar.part).tolist()):
        skin, cloth = measure_skin(avatar, poses)
        if cloth and skin > _SHOWS * cloth:
            found.append(
                AvatarFinding(
                    code="skin", text=f"skin shows through {skin / cloth:.2%} of its clothes"
                )
            )
        if not (avatar.part == PARTS.index("shoes")).any():
            found.append(AvatarFinding(code="barefoot", text="it wears no shoes"))
        if not np.isin(avatar.part, [PARTS.index("hair"), PARTS.index("hat")]).any():
            found.append(AvatarFinding(code="bald", text="it has no hair"))
    for part, name in ((TOP, "top"), (BOTTOM, "bottom")):
        said = avatar.record.get(f"{name}_colour", "")
        pattern = avatar.record.get(f"{name}_pattern", "plain")
        if said and (avatar.part == part).any() and pattern in ("plain", "knitted", "printed"):
            read = read_colour(avatar, part)
            if read and score_colour(said, read) == 0.0:
                text = f"its {name} is said to be {said}, but looks {read}"
                found.append(AvatarFinding(code="colour", text=text))
    return found


def _away_from_joints(avatar: Avatar, cloud: GaussianCloud) -> float:
    from scipy.spatial import cKDTree

    joints = avatar.joints @ np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    distance: NDArray[np.float64] = cKDTree(joints).query(cloud.means)[0]
    return float(distance.max())
