"""MakeHuman's base mesh hm08: its shape targets, the Mixamo rig, and adults by their traits.

Units of the files are decimetres, y up, z to the front, +x the person's left; ours are metres.
Sources: `3dobjs/base.obj`, `targets/macrodetails` and `rigs/standard` of MPFB2 (CC0); the rules of
the macro targets are those of `macrodetails/macro.json` there.
"""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.avatars.makehuman.mesh_obj import QuadMesh, load_obj
from gn0.avatars.skeleton import INDEX, JOINT_COUNT, JOINTS, MIXAMO
from gn0.errors import FormatError
from gn0.geometry import F64
from gn0.storage import plain_path, read_bytes

VERTEX_COUNT = 19_158
METRES = 0.1  # of a decimetre
BODY_END = 13_380  # vertices before this are skin
EYES = (14_598, 14_742)
_BYTES_MOST = 64 * 2**20
_CUBES = {"jaw": "joint-jaw", "left_eye_smplhf": "joint-l-eye", "right_eye_smplhf": "joint-r-eye"}
_AGES, _SEXES = ("young", "old"), ("female", "male")


@dataclass(frozen=True, eq=False)
class BaseMesh:
    """hm08 with its rig.

    Attributes:
        mesh: vertices in metres, all groups.
        joint_from: which vertices' mean each joint is [55, V], rows sum to 1.
        weights: skin weights of all joints [V, 55], rows sum to 1.
    """

    mesh: QuadMesh
    joint_from: F64
    weights: F64


@dataclass(frozen=True)
class Traits:
    """An adult by sliders of MakeHuman, each 0..1.

    Attributes:
        male: 0 a woman, 1 a man.
        old: 0 young (25), 1 old (90).
        muscle, weight, height, proportions: 0 least, 0.5 middle, 1 most.
        african, asian: shares of these looks; the rest is european.
    """

    male: float = 0.5
    old: float = 0.3
    muscle: float = 0.5
    weight: float = 0.5
    height: float = 0.5
    proportions: float = 0.5
    african: float = 0.0
    asian: float = 0.0


def load_base(folder: Path | str) -> BaseMesh:
    """The base mesh and its rig, from a folder with `3dobjs` and `rigs/standard` below it.

    Raises:
        StorageError: a file cannot be read.
        FormatError: a file is not what hm08 is.
    """
    root = plain_path(folder)
    raw = load_obj(root / "3dobjs" / "base.obj")
    if len(raw.vertices) != VERTEX_COUNT:
        raise FormatError(
            f"{len(raw.vertices)} vertices, hm08 has {VERTEX_COUNT}",
            file=root / "3dobjs" / "base.obj",
            remedy="take base.obj of MakeHuman 1.1 or newer, helpers included",
        )
    mesh = QuadMesh(raw.vertices * METRES, raw.faces, raw.uv, raw.group, raw.groups)
    rig_path = root / "rigs" / "standard" / "rig.mixamo.json"
    bones = _read_json(rig_path).get("bones", {})
    weight_path = root / "rigs" / "standard" / "weights.mixamo.json"
    table = _read_json(weight_path).get("weights", {})
    joint_from = np.zeros((JOINT_COUNT, VERTEX_COUNT))
    weights = np.zeros((VERTEX_COUNT, JOINT_COUNT))
    try:
        for number, joint in enumerate(JOINTS):
            if joint in MIXAMO:
                head = bones["mixamorig:" + MIXAMO[joint]]["head"]
                rows = head.get("vertex_indices") or _cube(mesh, head["cube_name"])
                for vertex, weight in table["mixamorig:" + MIXAMO[joint]]:
                    weights[vertex, number] += weight
            else:
                rows = _cube(mesh, _CUBES[joint])
            joint_from[number, rows] = 1.0 / len(rows)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise FormatError(
            f"the Mixamo rig is incomplete: {type(error).__name__} {error}",
            file=rig_path,
            remedy="take rig.mixamo.json and weights.mixamo.json of the same version",
        ) from None
    for side, (first, last) in zip(("left", "right"), _eye_ranges(), strict=True):
        weights[first:last] = 0.0
        weights[first:last, INDEX[f"{side}_eye_smplhf"]] = 1.0
    return BaseMesh(mesh, joint_from, weights / weights.sum(axis=1, keepdims=True))


def _eye_ranges() -> tuple[tuple[int, int], tuple[int, int]]:
    middle = (EYES[0] + EYES[1]) // 2
    return (EYES[0], middle), (middle, EYES[1])


def _cube(mesh: QuadMesh, name: str) -> list[int]:
    return np.unique(mesh.group_faces(name)).tolist()


def _read_json(path: Path) -> dict[str, Any]:
    try:
        found = msgspec.json.decode(read_bytes(path, _BYTES_MOST))
    except (msgspec.DecodeError, RecursionError) as error:
        raise FormatError(f"this is not JSON: {error}", file=path) from None
    if not isinstance(found, dict):
        raise FormatError("this is not a JSON object", file=path)
    return found


def load_target(path: Path | str) -> tuple[NDArray[np.int64], F64]:
    """Vertices [N] that a shape target moves, and how far [N, 3] m.

    Raises:
        StorageError: the file cannot be read.
        FormatError: it is not a (gzipped) list of rows `vertex dx dy dz`.
    """
    data = read_bytes(path, _BYTES_MOST)
    try:
        if data[:2] == b"\x1f\x8b":
            with gzip.open(path) as stream:
                data = stream.read(_BYTES_MOST)
        rows = np.array(
            [line.split() for line in data.splitlines() if line and line[:1] != b"#"], np.float64
        ).reshape(-1, 4)
    except (ValueError, EOFError, OSError, zlib.error) as error:
        raise FormatError(
            f"this is not a shape target: {error}", file=path, remedy="rows are vertex dx dy dz"
        ) from None
    vertex = rows[:, 0].astype(np.int64)
    if len(rows) and (
        vertex.min() < 0 or vertex.max() >= VERTEX_COUNT or not np.isfinite(rows).all()
    ):
        raise FormatError("a row names a vertex that hm08 has not", file=path)
    return vertex, rows[:, 1:] * METRES


@dataclass(frozen=True, eq=False)
class MacroTargets:
    """Shape targets of adults by their name parts, dense [V, 3] m."""

    shifts: Mapping[str, F64]

    def shape(self, base: F64, traits: Traits) -> F64:
        """Vertices [V, 3] m of an adult."""
        vertices = base.copy()
        for name, weight in macro_weights(traits).items():
            if weight > 0 and name in self.shifts:
                vertices += weight * self.shifts[name]
        return vertices


def load_macro_targets(folder: Path | str) -> MacroTargets:
    """All adult targets below `macrodetails`, by file name without its ending.

    Raises:
        StorageError, FormatError: as `load_target`.
    """
    shifts: dict[str, F64] = {}
    for path in sorted(Path(folder).rglob("*.target*")):
        vertex, shift = load_target(path)
        dense = np.zeros((VERTEX_COUNT, 3))
        dense[vertex] = shift
        shifts[path.name.split(".")[0]] = dense
    if not shifts:
        raise FormatError(
            "there is no shape target here", file=folder, remedy="name `macrodetails`"
        )
    return MacroTargets(shifts)


def macro_weights(traits: Traits) -> dict[str, float]:
    """How much each macro target counts: products of the weights of its name's parts."""
    sex = {"female": 1.0 - traits.male, "male": traits.male}
    age = {"young": 1.0 - traits.old, "old": traits.old}
    muscle = _three(traits.muscle, "muscle")
    weight = _three(traits.weight, "weight")
    height = {
        "minheight": max(1 - 2 * traits.height, 0.0),
        "maxheight": max(2 * traits.height - 1, 0.0),
    }
    proportions = {
        "uncommonproportions": max(1 - 2 * traits.proportions, 0.0),
        "idealproportions": max(2 * traits.proportions - 1, 0.0),
    }
    looks = {
        "african": traits.african,
        "asian": traits.asian,
        "caucasian": 1.0 - traits.african - traits.asian,
    }
    found = {f"{r}-{s}-{a}": looks[r] * sex[s] * age[a] for r, s, a in product(looks, sex, age)}
    for s, a, m, w in product(sex, age, muscle, weight):
        share = sex[s] * age[a] * muscle[m] * weight[w]
        found[f"universal-{s}-{a}-{m}-{w}"] = share
        for end, more in (*height.items(), *proportions.items()):
            found[f"{s}-{a}-{m}-{w}-{end}"] = share * more
    return found


def _three(value: float, name: str) -> dict[str, float]:
    return {
        f"min{name}": max(1.0 - 2.0 * value, 0.0),
        f"average{name}": 1.0 - abs(2.0 * value - 1.0),
        f"max{name}": max(2.0 * value - 1.0, 0.0),
    }
