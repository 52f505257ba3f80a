"""The default body, from MakeHuman's files: T-pose, ten directions of shape, and what traits mean.

hm08 is sculpted with its arms lowered. Every vertex is taken to the T-pose by the inverse of the
blended turn that leads back, so that the sculpted pose gives the sculpted surface again, exactly.
All of it is linear in the vertices, and so are the joints in the shape coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gn0.avatars.makehuman.hm08 import BODY_END, BaseMesh, MacroTargets, Traits
from gn0.avatars.skeleton import INDEX, JOINT_COUNT, JOINTS, PARENTS
from gn0.avatars.skinning import pack_weights, vectors_of
from gn0.errors import DataError
from gn0.geometry import F64
from gn0.progress import Progress, no_progress
from gn0.seeds import random_stream

DIRECTIONS = 10
HEIGHTS = (1.50, 1.95)  # of the adults that shapes are learned from [m]
_ADULTS = 400
_INFLUENCES = 6  # that is all that the rig has
TRAITS = ("male", "old", "muscle", "weight", "height", "proportions", "african", "asian")


@dataclass(frozen=True, eq=False)
class BakedBody:
    """What the package's body file holds, see `gn0.avatars.body_file`.

    Attributes:
        template, shape_dirs, joints, joint_dirs: as in `BodyModel`.
        joint_index, joint_weight: skin weights [V, K].
        sculpted: pose in which hm08 was modelled [55, 3] rad.
        traits_to_betas: coefficients [Q, B] of the quadratic terms of traits.
        residual: spread of the adults' coefficients about that [B].
    """

    template: F64
    shape_dirs: F64
    joints: F64
    joint_dirs: F64
    joint_index: np.ndarray
    joint_weight: F64
    sculpted: F64
    traits_to_betas: F64
    residual: F64


def bake_body(
    base: BaseMesh, targets: MacroTargets, seed: int = 0, progress: Progress = no_progress
) -> BakedBody:
    """The body of sampled adults of all builds, heights of 1.50 to 1.95 m, sexes and ages.

    Raises:
        DataError: the targets do not reach such heights.
    """
    weights = pack_weights(base.weights, _INFLUENCES)
    mean = targets.shape(base.mesh.vertices, Traits())
    turned = _turns_to_sculpted(base.joint_from @ mean)
    blended = np.linalg.inv(np.einsum("vj,jab->vab", weights.dense(), turned))
    soles = np.argsort(_rest(base, mean, turned, blended, weights.dense())[0][:BODY_END, 1])[:40]

    rows, traits = [], []
    stream = random_stream(seed, "adults")
    for _ in range(20 * _ADULTS):
        adult = draw_traits(stream)
        vertices, joints = _rest(
            base, targets.shape(base.mesh.vertices, adult), turned, blended, weights.dense()
        )
        skin = vertices[:BODY_END, 1]
        if not HEIGHTS[0] <= skin.max() - skin.min() <= HEIGHTS[1]:
            continue
        origin = np.array([0.0, vertices[soles, 1].mean(), joints[0, 2]])
        rows.append(np.concatenate([vertices - origin, joints - origin]).ravel())
        traits.append(trait_terms(adult))
        progress("sampling adults", len(rows), _ADULTS)
        if len(rows) == _ADULTS:
            break
    else:
        raise DataError(
            f"of {20 * _ADULTS} adults only {len(rows)} are {HEIGHTS[0]} to {HEIGHTS[1]} m tall",
            where="shape targets",
            remedy="name the macrodetails of MPFB2, heights included",
        )
    table = np.array(rows)
    middle = table.mean(axis=0)
    away = table - middle
    vertices_end = 3 * len(mean)
    # principal directions of the vertices alone, by the small side; joints follow
    values, vectors = np.linalg.eigh(away[:, :vertices_end] @ away[:, :vertices_end].T)
    order = np.argsort(-values)[:DIRECTIONS]
    dirs = (away.T @ vectors[:, order]) / np.sqrt(len(table))
    signs = np.sign(dirs[np.abs(dirs[:vertices_end]).argmax(axis=0), np.arange(DIRECTIONS)])
    dirs *= signs
    betas = vectors[:, order] * signs * np.sqrt(len(table))
    terms = np.array(traits)
    solved, *_ = np.linalg.lstsq(terms, betas, rcond=None)
    flat = dirs.reshape(-1, 3, DIRECTIONS)
    return BakedBody(
        template=middle[:vertices_end].reshape(-1, 3),
        shape_dirs=flat[: len(mean)],
        joints=middle[vertices_end:].reshape(-1, 3),
        joint_dirs=flat[len(mean) :],
        joint_index=weights.joint,
        joint_weight=weights.weight,
        sculpted=_local_vectors(turned),
        traits_to_betas=solved,
        residual=(betas - terms @ solved).std(axis=0),
    )


def draw_traits(stream: np.random.Generator) -> Traits:
    """An adult at random: mostly clearly a woman or a man, of any age, build and look."""
    looks = stream.dirichlet((0.4, 0.4, 0.4))
    return Traits(
        male=float(stream.beta(0.35, 0.35)),
        old=float(stream.uniform(0.0, 0.75)),
        muscle=float(np.clip(stream.normal(0.5, 0.2), 0.0, 1.0)),
        weight=float(np.clip(stream.normal(0.5, 0.22), 0.0, 1.0)),
        height=float(stream.uniform(0.0, 1.0)),
        proportions=float(stream.uniform(0.2, 0.9)),
        african=float(looks[0]),
        asian=float(looks[1]),
    )


def trait_terms(traits: Traits) -> F64:
    """1, traits and their products two by two: what shape coefficients are a sum of."""
    x = np.array([getattr(traits, name) for name in TRAITS])
    return np.concatenate([[1.0], x, np.outer(x, x)[np.triu_indices(len(x))]])


def _rest(
    base: BaseMesh, sculpted: F64, turned: F64, blended_inverse: F64, dense: F64
) -> tuple[F64, F64]:
    """Vertices and joints in T-pose of a sculpted body."""
    joints = base.joint_from @ sculpted
    rest = np.empty_like(joints)
    for k, parent in enumerate(PARENTS):
        if parent < 0:
            rest[k] = joints[k]
        else:
            rest[k] = rest[parent] + turned[parent].T @ (joints[k] - joints[parent])
    moved = joints - np.einsum("jab,jb->ja", turned, rest)
    return np.einsum("vab,vb->va", blended_inverse, sculpted - dense @ moved), rest


def _turns_to_sculpted(joints: F64) -> F64:
    """Global turns [55, 3, 3] that take each joint's axes from the T-pose to the sculpted one."""
    aims: dict[str, tuple[str, tuple[float, float, float]]] = {}
    for side, out in (("left", 1.0), ("right", -1.0)):
        aims[f"{side}_hip"] = (f"{side}_knee", (0.0, -1.0, 0.0))
        aims[f"{side}_knee"] = (f"{side}_ankle", (0.0, -1.0, 0.0))
        aims[f"{side}_shoulder"] = (f"{side}_elbow", (out, 0.0, 0.0))
        aims[f"{side}_elbow"] = (f"{side}_wrist", (out, 0.0, 0.0))
        aims[f"{side}_wrist"] = (f"{side}_middle1", (out, 0.0, 0.0))
    turned = np.empty((JOINT_COUNT, 3, 3))
    for k, name in enumerate(JOINTS):
        if name in aims:
            child, straight = aims[name]
            turned[k] = turn_between(np.array(straight), joints[INDEX[child]] - joints[k])
        elif name.endswith("_ankle") or PARENTS[k] < 0:
            turned[k] = np.eye(3)  # soles stay as they stand
        else:
            turned[k] = turned[PARENTS[k]]
    return turned


def turn_between(start: F64, end: F64) -> F64:
    """The least rotation [3, 3] that takes one direction to another, not its opposite."""
    a, b = start / np.linalg.norm(start), end / np.linalg.norm(end)
    v, c = np.cross(a, b), float(a @ b)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + c)


def _local_vectors(turned: F64) -> F64:
    local = np.array(
        [t if p < 0 else turned[p].T @ t for t, p in zip(turned, PARENTS, strict=True)]
    )
    return vectors_of(local)
