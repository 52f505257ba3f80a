"""The 55 joints of a body, by the names and in the order of SMPL-X.

Source: the joint list of SMPL-X (`vchoutas/smplx`, `smplx/joint_names.py`) and its kinematic tree.
The Mixamo rig has the same tree without jaw and eyes.
"""

from __future__ import annotations

_FINGERS = ("index", "middle", "pinky", "ring", "thumb")

JOINTS: tuple[str, ...] = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2",
    "left_ankle", "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar",
    "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist", "jaw", "left_eye_smplhf", "right_eye_smplhf",
    *(f"{side}_{f}{k}" for side in ("left", "right") for f in _FINGERS for k in (1, 2, 3)),
)  # fmt: skip
PARENTS: tuple[int, ...] = (
    -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15,
    20, 25, 26, 20, 28, 29, 20, 31, 32, 20, 34, 35, 20, 37, 38,
    21, 40, 41, 21, 43, 44, 21, 46, 47, 21, 49, 50, 21, 52, 53,
)  # fmt: skip
JOINT_COUNT = len(JOINTS)
INDEX: dict[str, int] = {name: k for k, name in enumerate(JOINTS)}
WITHOUT_BONE = ("jaw", "left_eye_smplhf", "right_eye_smplhf")  # in rigs of Mixamo

_PAIRS = {
    "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase",
    "collar": "Shoulder", "shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand",
}  # fmt: skip
MIXAMO: dict[str, str] = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2",
    "neck": "Neck", "head": "Head",
    **{f"{s}_{ours}": s.capitalize() + theirs
       for s in ("left", "right") for ours, theirs in _PAIRS.items()},
    **{f"{s}_{f}{k}": f"{s.capitalize()}Hand{f.capitalize()}{k}"
       for s in ("left", "right") for f in _FINGERS for k in (1, 2, 3)},
}  # fmt: skip
