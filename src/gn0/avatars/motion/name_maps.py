"""Which joint of a rig is which of ours, by its name and by what hangs on it.

Three ways of naming limbs are known. They use the same words for different joints (LeftShoulder is
the collar bone of Mixamo and the upper arm of the older BVH), so one way is taken for a whole rig:
the one that matches most. The spine needs no names: it is what lies between hips and neck.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gn0.avatars.motion.rig import RigMotion
from gn0.avatars.skeleton import INDEX
from gn0.errors import FormatError
from gn0.geometry import F64

REQUIRED = tuple(
    f"{side}_{part}"
    for side in ("left", "right")
    for part in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
)
_FINGERS = {"index": "index", "middle": "middle", "pinky": "pinky", "little": "pinky",
            "ring": "ring", "thumb": "thumb"}  # fmt: skip
_LIMBS: dict[str, dict[str, str]] = {
    # Mixamo, HumanIK, CMU and MakeHuman's copies of them
    "limbs": {
        "upleg": "hip", "leg": "knee", "foot": "ankle", "toebase": "foot", "toes": "foot",
        "toe": "foot", "shoulder": "collar", "arm": "shoulder", "forearm": "elbow",
        "hand": "wrist",
    },
    # SMPL, SMPL-X and BVH of the nineties
    "joints": {
        "hip": "hip", "knee": "knee", "ankle": "ankle", "toe": "foot", "foot": "foot",
        "collar": "collar", "shoulder": "shoulder", "elbow": "elbow", "wrist": "wrist",
    },
    # Blender, Unity, VRM, 3ds Max, MakeHuman
    "segments": {
        "upperleg": "hip", "thigh": "hip", "upperleg01": "hip", "lowerleg": "knee",
        "calf": "knee", "shin": "knee", "lowerleg01": "knee", "foot": "ankle", "toe": "foot",
        "toes": "foot", "toebase": "foot", "toe0": "foot", "toe11": "foot", "ball": "foot",
        "shoulder": "collar", "clavicle": "collar", "collar": "collar", "upperarm": "shoulder",
        "upperarm01": "shoulder", "lowerarm": "elbow", "forearm": "elbow", "lowerarm01": "elbow",
        "hand": "wrist", "wrist": "wrist", "palm2": "wrist",
    },
}  # fmt: skip
_HIPS = ("hips", "pelvis", "hip")
_NECKS, _HEADS = ("neck", "neck01", "neck1"), ("head",)
_TRACK = re.compile(r"^(?:mixamorig\d*[:_]?|bip0?\d+[ _]?|def[-_]|j_bip_[clr]_)", re.I)
_SIDE = (
    (re.compile(r"^(left|right)(.+)$", re.I), 1, 2),
    (re.compile(r"^(.+?)[ ._-]*(left|right)$", re.I), 2, 1),
    (re.compile(r"^([lr])[ ._-](.+)$", re.I), 1, 2),
    (re.compile(r"^(.+?)[ ._-]([lr])$", re.I), 2, 1),
    (re.compile(r"^([LR])([A-Z].*)$"), 1, 2),
    (re.compile(r"^([lr])((?:hand|foot|thumb|fingers?)\d*)$"), 1, 2),
)


@dataclass(frozen=True)
class JointMap:
    """Which joint of a rig each of ours is.

    Attributes:
        joint: number in the rig by number of ours.
        notes: what was not found by name.
    """

    joint: dict[int, int]
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> int:
        return self.joint[INDEX[name]]

    def __contains__(self, name: str) -> bool:
        return INDEX[name] in self.joint


def _plain_names(names: tuple[str, ...]) -> list[str]:
    """Names without what all of a rig carry before them."""
    plain = [_TRACK.sub("", name.rsplit(":", 1)[-1].rsplit("|", 1)[-1]) for name in names]
    for hips in _HIPS:
        for name in plain:
            at = name.lower().rfind(hips)
            if at > 0 and at + len(hips) == len(name) and not name[at - 1].isspace():
                before = name[:at]
                others = sum(other.startswith(before) for other in plain)
                if before.endswith(("_", "-", ".")) and 2 * others > len(plain):
                    return [other.removeprefix(before) for other in plain]
    return plain


def _parts(name: str) -> tuple[str, str]:
    """("left", "right" or "", the rest in small letters and digits)."""
    side, stem = "", name
    for pattern, where, rest in _SIDE:
        found = pattern.match(name)
        if found:
            side = "left" if found[where].lower().startswith("l") else "right"
            stem = found[rest]
            break
    return side, re.sub(r"[^a-z0-9]", "", stem.lower())


def _finger(stem: str) -> str:
    """Our name of a finger's joint without its side; "" for what is none."""
    found = re.fullmatch(
        r"(?:hand|f)?(index|middle|pinky|little|ring|thumb)(?:finger)?0?([1-3]?)"
        r"(proximal|intermediate|distal)?0?([1-3]?)",
        stem,
    )
    if found is None:
        return ""
    words = {"proximal": "1", "intermediate": "2", "distal": "3"}
    number = found[2] or words.get(found[3] or "", "") or found[4] or "1"
    return _FINGERS[found[1]] + number


def _ancestors(rig: RigMotion, joint: int) -> list[int]:
    """A joint and all that it hangs on, up to the root."""
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = rig.parents[joint]
    return chain


def map_joints(rig: RigMotion, file: Path | str) -> JointMap:
    """Which joint of a rig each of ours is.

    Raises:
        FormatError: limbs, hips or head could not be matched; names them.
    """
    parts = [_parts(name) for name in _plain_names(rig.names)]
    found: dict[str, int] = {}
    for style in _LIMBS.values():
        tried: dict[str, int] = {}
        for number, (side, stem) in enumerate(parts):
            ours = style.get(stem) or _finger(stem)
            if side and ours:
                tried.setdefault(f"{side}_{ours}", number)
        if sum(name in tried for name in REQUIRED) > sum(name in found for name in REQUIRED):
            found = tried
    axial = {stem: k for k, (side, stem) in reversed(list(enumerate(parts))) if not side}
    head = next((axial[name] for name in _HEADS if name in axial), None)
    neck = next((axial[name] for name in _NECKS if name in axial), None)
    missing = [name for name in REQUIRED if name not in found]
    if head is None and neck is None:
        missing.append("head")
    if missing:
        raise _unknown(rig, missing, file)
    notes: list[str] = []
    pelvis = next((axial[name] for name in _HIPS if name in axial), None)
    if pelvis is None:
        pelvis = _hips_by_place(rig, found, file)
        notes.append(f"no joint is called hips; {rig.names[pelvis]!r} is, where both legs hang")
    top = neck if head is None else head
    assert top is not None
    joint = {INDEX[name]: number for name, number in found.items()}
    joint[INDEX["pelvis"]] = pelvis
    if head is not None:
        joint[INDEX["head"]] = head
    joint |= _spine(rig, found, pelvis, top, neck, file)
    return JointMap(joint, tuple(notes))


def _hips_by_place(rig: RigMotion, found: dict[str, int], file: Path | str) -> int:
    """The joint on which both legs hang, where it lies between them."""
    sides = [_ancestors(rig, found[f"{side}_hip"])[1:] for side in ("left", "right")]
    common = [k for k in sides[0] if k in sides[1]]
    place = rig.rest_positions
    legs = (place[found["left_hip"]] + place[found["right_hip"]]) / 2
    thigh = float(np.linalg.norm(place[found["left_hip"]] - place[found["left_knee"]]))
    if not common or np.linalg.norm(place[common[0]] - legs) > 0.6 * thigh:
        raise _unknown(rig, ["pelvis (hips)"], file)
    return common[0]


def _spine(
    rig: RigMotion,
    found: dict[str, int],
    pelvis: int,
    top: int,
    neck: int | None,
    file: Path | str,
) -> dict[int, int]:
    """Spine and neck: what lies between hips and head, split where the arms hang."""
    up = _ancestors(rig, top)
    if pelvis in up:
        column = up[: up.index(pelvis)][::-1]
    else:  # legs and spine hang side by side
        beside = set(_ancestors(rig, pelvis))
        column = [k for k in up if k not in beside][::-1]
    arms = set(_ancestors(rig, found["left_shoulder"])) & set(
        _ancestors(rig, found["right_shoulder"])
    )
    spine = [k for k in column if k in arms]
    if not spine:
        raise _unknown(rig, ["spine (between hips and arms)"], file)
    above = [k for k in column if k not in arms]
    mapped: dict[int, int] = {}
    if neck is not None and neck in above:
        mapped[INDEX["neck"]] = neck
    elif len(above) > 1:
        mapped[INDEX["neck"]] = above[0]
    last = len(spine) - 1
    mapped[INDEX["spine1"]] = spine[0]
    if last >= 2:
        mapped[INDEX["spine2"]] = spine[(last + 1) // 2]
    if last >= 1:
        mapped[INDEX["spine3"]] = spine[last]
    return mapped


def _unknown(rig: RigMotion, missing: list[str], file: Path | str) -> FormatError:
    shown = ", ".join(repr(name[:40]) for name in rig.names[:12])
    return FormatError(
        f"the rig has no joint for {', '.join(missing)}; its joints are {shown}"
        f"{' …' if len(rig.names) > 12 else ''}",
        file=file,
        field="joints",
        remedy="name the joints as Mixamo, SMPL-X, CMU, Unity or Blender does",
    )


def rest_axes(rig: RigMotion, joints: JointMap, file: Path | str) -> tuple[F64, str]:
    """Rotation [3, 3] from the file's axes at rest to those of bodies, and the axis that is up.

    Raises:
        FormatError: the rest pose does not stand, or its feet point backwards.
    """
    place = rig.rest_positions

    def at(*names: str) -> F64:
        held = [place[joints[name]] for name in names if name in joints]
        middle: F64 = np.mean(held, axis=0)
        return middle

    ankles, hips = at("left_ankle", "right_ankle"), at("left_hip", "right_hip")
    up = snap_axis(at("left_shoulder", "right_shoulder") - ankles, 25.0)
    legs = np.linalg.norm(place[joints["left_hip"]] - place[joints["left_ankle"]])
    if not float((hips - ankles) @ up) > 0.3 * legs:
        raise FormatError(
            "the rest pose is not a standing person",
            file=file,
            field="rest",
            remedy="export the bind pose, or a BVH whose offsets make a standing body",
        )
    left = (at("left_hip") - at("right_hip")) / 2 + at("left_shoulder") - at("right_shoulder")
    left = left - (left @ up) * up
    size = float(np.linalg.norm(left))
    if not size > 1e-3 * legs:
        raise FormatError(
            "left and right lie on one spot at rest",
            file=file,
            field="rest",
            remedy="check the skeleton",
        )
    left = snap_axis(left / size, 15.0)
    left = left - (left @ up) * up
    left = left / np.linalg.norm(left)
    forward = np.cross(left, up)
    toes = [
        (place[joints[f"{side}_foot"]] - place[joints[f"{side}_ankle"]]) @ forward
        for side in ("left", "right")
        if f"{side}_foot" in joints
    ]
    if toes and np.mean(toes) < -0.05 * legs:
        raise FormatError(
            "the feet point backwards at rest: left and right are swapped, or the file is mirrored",
            file=file,
            field="rest",
            remedy="export with a right-handed frame, or swap the names",
        )
    return np.stack([left, up, forward]), axis_name(up)


def snap_axis(direction: F64, degrees: float) -> F64:
    """The axis nearest to a direction [3], where it is within `degrees`; else its unit vector."""
    unit = direction / max(float(np.linalg.norm(direction)), 1e-300)
    k = int(np.argmax(np.abs(unit)))
    if abs(unit[k]) >= np.cos(np.deg2rad(degrees)):
        axis = np.zeros(3)
        axis[k] = np.sign(unit[k])
        return axis
    return unit


def axis_name(direction: F64) -> str:
    """The name of an axis, "x" or "-z"; "" for a direction along none."""
    k = int(np.argmax(np.abs(direction)))
    if abs(direction[k]) < 0.999999:
        return ""
    return ("-" if direction[k] < 0 else "") + "xyz"[k]
