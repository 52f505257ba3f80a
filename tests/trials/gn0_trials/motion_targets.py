"""Fuzz targets of the readers of human motion."""

from __future__ import annotations

import io

import numpy as np

from gn0.avatars.motion.motion import Motion
from gn0.avatars.motion.motion_file import encode_motion
from gn0.avatars.motion.open_motion import load_motion
from gn0_trials.fuzz import FuzzTarget
from gn0_trials.motion_writers import build_bvh, build_fbx, build_glb, make_puppet
from gn0_trials.splat_targets import repair_zip

_BVH = (
    b"HIERARCHY", b"ROOT", b"JOINT", b"End", b"Site", b"{", b"}", b"OFFSET", b"CHANNELS", b"MOTION",
    b"Frames:", b"Frame", b"Time:", b"Xposition", b"Zrotation",
)  # fmt: skip
_GLTF = (
    b'"children":', b'"joints":', b'"count":', b'"byteOffset":', b'"byteLength":', b'"sampler":',
    b'"input":', b'"output":', b'"STEP"', b'"CUBICSPLINE"', b'"rotation":', b'"matrix":', b"null",
    b"[]", b"{}", b"-1", b"1e300", b"1000000000", b'"MAT4"', b'"VEC3"', b'"node":', b"5121",
)  # fmt: skip


def check_motion(motion: Motion) -> None:
    """Raise unless a motion is sound."""
    assert np.isfinite(motion.poses).all() and np.isfinite(motion.shift).all()
    assert len(motion) >= 2 and 1 <= motion.fps <= 1000


def bvh_target() -> FuzzTarget:
    """Fuzz target: BVH."""
    corpus = {
        order: build_bvh(make_puppet(3, frames, core=True, twisted=False), order)
        for order, frames in (("ZXY", 2), ("XYZ", 5))
    }
    return FuzzTarget("bvh", load_motion, corpus, check_motion, _BVH, ".bvh")


def fbx_target() -> FuzzTarget:
    """Fuzz target: binary FBX with records of 32 and of 64 bits."""
    corpus = {
        str(version): build_fbx(make_puppet(4, frames, core=True), version)
        for version, frames in ((7400, 3), (7700, 20))
    }
    return FuzzTarget("fbx", load_motion, corpus, check_motion, suffix=".fbx")


def glb_skin_target() -> FuzzTarget:
    """Fuzz target: skins and clips of glTF."""
    corpus = {
        kind: build_glb(make_puppet(5, 3, core=True), kind)
        for kind in ("LINEAR", "STEP", "CUBICSPLINE")
    }
    return FuzzTarget("glb-skin", load_motion, corpus, check_motion, _GLTF, ".glb")


def motion_npz_target() -> FuzzTarget:
    """Fuzz target: motion.npz, AMASS, and plain arrays."""
    rng = np.random.default_rng(6)
    poses = rng.normal(0, 0.3, (3, 55, 3))
    amass, plain = io.BytesIO(), io.BytesIO()
    np.savez(
        amass, poses=poses[:, :52].reshape(3, 156), trans=np.zeros((3, 3)), mocap_framerate=120.0,
        gender=np.array("neutral"),
    )  # fmt: skip
    np.save(plain, poses.reshape(3, 165).astype(np.float32))
    corpus = {
        "gn0": encode_motion(Motion(poses, np.zeros((3, 3)), 30.0, 0.9, name="clip")),
        "amass": amass.getvalue(),
        "plain": plain.getvalue(),
    }

    def finish(data: bytes, rng: np.random.Generator) -> bytes:
        zipped = data.startswith(b"PK")
        return repair_zip(data) if zipped and rng.random() < 0.8 else data

    return FuzzTarget(
        "motion-npz", load_motion, corpus, check_motion, (b"'|O'", b"'<f8'", b"(3, 165)"),
        ".npz", finish=finish,
    )  # fmt: skip
