"""Bodies from files: the one in the package, and a user's own `SMPLX_*.npz`.

The package's body is baked from CC0 data by `runs/bake_people.py`; SMPL-X is not free for every
purpose, so a user brings it, and nothing here needs it.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from gn0.avatars.body import BodyModel
from gn0.avatars.makehuman.bake_body import BakedBody
from gn0.avatars.makehuman.hm08 import BaseMesh
from gn0.avatars.npz_arrays import ArrayFile, write_arrays
from gn0.avatars.skeleton import JOINT_COUNT, PARENTS
from gn0.avatars.skinning import SkinWeights, pack_weights
from gn0.errors import FormatError
from gn0.geometry import F64
from gn0.storage import write_atomic

DATA = Path(__file__).parent / "data"
BODY_FILE = DATA / "body.npz"
_SMPLX = ("v_template", "f", "shapedirs", "J_regressor", "weights", "kintree_table")
_SMPLX_REMEDY = "take SMPLX_NEUTRAL.npz (or _MALE, _FEMALE) of smpl-x.is.tue.mpg.de"
_STEP = 2e-5  # of stored directions [m]: a person is off by less than 0.1 mm
_WEIGHT_STEPS = 255  # skin weights are stored in one byte each


def save_body(path: Path | str, baked: BakedBody, base: BaseMesh) -> None:
    """Write the body of the package.

    Raises:
        StorageError: the file cannot be written.
    """
    shown = ~np.char.startswith(np.array(base.mesh.groups), "joint")
    keep = shown[base.mesh.group]
    arrays: dict[str, np.ndarray] = {
        "template": _rounded(baked.template).astype(np.float32),
        # one direction after the other, and one axis: they pack better
        "shape_dirs": np.round(baked.shape_dirs / _STEP).astype(np.int16).transpose(2, 1, 0),
        "joints": _rounded(baked.joints),
        "joint_dirs": _rounded(baked.joint_dirs),
        "joint_index": baked.joint_index,
        "joint_weight": np.round(baked.joint_weight * _WEIGHT_STEPS).astype(np.uint8),
        "faces": base.mesh.faces[keep].astype(np.uint16),
        "group": base.mesh.group[keep].astype(np.uint8),
        "groups": np.array(base.mesh.groups),
        "sculpted": _rounded(baked.sculpted),
        "traits_to_betas": _rounded(baked.traits_to_betas),
        "residual": _rounded(baked.residual),
    }
    write_atomic(path, lambda stream: write_arrays(stream, arrays))


def _rounded(values: F64) -> F64:
    """To a micrometre: what the last bits are hangs on how many threads added them up."""
    return np.round(values, 6)


@lru_cache(maxsize=1)
def load_body() -> BodyModel:
    """The body of the package: hm08 in T-pose, ten directions of shape, helpers for clothes.

    Raises:
        StorageError, FormatError: the package is damaged.
    """
    arrays = ArrayFile(BODY_FILE)
    dirs = arrays.read("shape_dirs").transpose(2, 1, 0) * _STEP
    weight = arrays.read("joint_weight").astype(np.float64)
    return BodyModel(
        template=arrays.read("template").astype(np.float64),
        shape_dirs=np.ascontiguousarray(dirs),
        joints=arrays.read("joints"),
        joint_dirs=arrays.read("joint_dirs"),
        weights=SkinWeights(arrays.read("joint_index"), weight / weight.sum(axis=1, keepdims=True)),
        faces=arrays.read("faces").astype(np.int32),
        group=arrays.read("group").astype(np.int32),
        groups=tuple(str(name) for name in arrays.read("groups")),
        shape_space="gn0",
        sculpted=arrays.read("sculpted"),
    )


@lru_cache(maxsize=1)
def load_trait_map() -> tuple[F64, F64]:
    """What traits mean in shape coefficients, and how far people spread about that.

    Returns:
        coefficients of the terms of traits [Q, 10], spread [10].
    """
    arrays = ArrayFile(BODY_FILE)
    return arrays.read("traits_to_betas"), arrays.read("residual")


def load_smplx_body(path: Path | str) -> BodyModel:
    """A user's SMPL-X body; hands are flat at rest, and its pose correctives are left out.

    Its name tables (`joint2num`, `part2num`) are pickled and never opened.

    Raises:
        StorageError: the file cannot be read.
        FormatError: it is not SMPL-X, or one of another skeleton.
    """
    arrays = ArrayFile(path)
    arrays.require(_SMPLX, "a SMPL-X body", _SMPLX_REMEDY)
    template = arrays.read_floats("v_template", (None, 3))
    count = len(template)
    dirs = arrays.read_floats("shapedirs", (count, 3, None))
    regressor = arrays.read_floats("J_regressor", (JOINT_COUNT, count))
    weights = arrays.read_floats("weights", (count, JOINT_COUNT))
    tree = arrays.read_floats("kintree_table", (2, JOINT_COUNT))
    if tuple(tree[0, 1:].astype(np.int64)) != PARENTS[1:]:
        raise FormatError(
            "the joints hang on other parents than SMPL-X's",
            file=path,
            field="kintree_table",
            remedy=_SMPLX_REMEDY,
        )
    faces = arrays.read_floats("f", (None, 3)).astype(np.int64)
    if len(faces) and (faces.min() < 0 or faces.max() >= count):
        raise FormatError(f"a face names a vertex beyond {count}", file=path, field="f")
    # old files have 10 directions of shape and 10 of expression, newer ones 300 and 100
    shapes = {20: 10, 400: 300}.get(dirs.shape[2], dirs.shape[2])
    dirs = dirs[:, :, :shapes]
    return BodyModel(
        template=template,
        shape_dirs=dirs,
        joints=regressor @ template,
        joint_dirs=np.einsum("jv,vab->jab", regressor, dirs),
        weights=pack_weights(weights, 8),
        faces=np.concatenate([faces, faces[:, 2:]], axis=1).astype(np.int32),
        group=np.zeros(len(faces), np.int32),
        groups=("body",),
        shape_space="smplx",
        sculpted=np.zeros((JOINT_COUNT, 3)),
    )
