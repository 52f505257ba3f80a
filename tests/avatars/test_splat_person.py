"""People that others made: splats and a binding become an avatar, and come out as they went in."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gn0.avatars.avatar import Avatar
from gn0.avatars.bank import AvatarBank, load_avatar, open_avatars, save_avatar
from gn0.avatars.npz_arrays import ArrayFile, write_arrays
from gn0.avatars.poses import trial_poses
from gn0.avatars.skinning import pose_joints, skin_points
from gn0.avatars.splat_person import load_splat_person, save_splat_person
from gn0.cli.main import main
from gn0.errors import DataError, FormatError
from gn0_trials.people_small import small_person


@pytest.fixture(scope="module")
def person() -> Avatar:
    return small_person(density=0.05)


@pytest.fixture
def folder(person: Avatar, tmp_path: Path) -> Path:
    save_splat_person(tmp_path, person)
    return tmp_path


def change(folder: Path, **arrays: np.ndarray | None) -> None:
    file = ArrayFile(folder / "binding.npz")
    kept = {name: file.read(name) for name in file.names if name not in arrays}
    kept |= {name: value for name, value in arrays.items() if value is not None}
    with open(folder / "binding.npz", "wb") as stream:
        write_arrays(stream, kept)


def test_a_person_comes_back_as_it_was_written(person: Avatar, folder: Path) -> None:
    again = load_splat_person(folder / f"{person.name}.ply")
    assert np.array_equal(again.points, person.points)
    assert np.array_equal(again.part, person.part)
    assert np.abs(again.albedo - person.albedo).max() < 1e-5
    stride = trial_poses()[1]
    assert np.abs(again.pose(stride).means - person.pose(stride).means).max() < 1e-6
    assert open_avatars(folder / f"{person.name}.ply")[0].name == person.name


def test_axes_scale_and_pose_of_others_are_taken_back(person: Avatar, folder: Path) -> None:
    from gn0.gaussians.ply import save_ply
    from gn0.gaussians.splat_files import load_cloud
    from gn0.gaussians.transform import transform_cloud

    path = folder / f"{person.name}.ply"
    pose = np.zeros((55, 3))
    pose[16, 2], pose[17, 2] = -0.8, 0.8  # arms lowered, as a fitted A-pose
    transforms, _ = pose_joints(person.joints, pose)
    cloud = load_cloud(path).cloud
    posed = skin_points(person.points, person.weights, transforms).astype(np.float32)
    from dataclasses import replace

    # z up, in centimetres, a metre aside
    up = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    theirs = transform_cloud(
        replace(cloud, means=posed), rotation=up, scale=100.0, shift=(100.0, 0.0, 0.0)
    )
    save_ply(theirs, path)
    align = np.eye(4)
    align[:3, :3] = up.T
    align[:3, 3] = up.T @ (-1.0, 0.0, 0.0)
    change(folder, T_align=align, scale=np.array(0.01), canonical_pose=pose)
    again = load_splat_person(path)
    assert np.abs(again.points - person.points).max() < 2e-5


def test_a_person_without_parts_or_joints_hangs_on_our_body(person: Avatar, folder: Path) -> None:
    change(folder, part=None, normals=None, joints=None, licence=None)
    again = load_splat_person(folder / f"{person.name}.ply")
    assert np.abs(again.joints - person.joints).max() < 1e-3  # joints follow from betas
    assert again.licence == "unknown" and len(set(again.part.tolist())) == 1
    agree = np.einsum("na,na->n", again.normals, person.normals)
    assert np.median(agree) > 0.99 and (agree > 0).mean() > 0.85  # outward, limbs too


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"weights": None}, "weights missing"),
        ({"weights_idx": np.zeros((3, 4), np.uint8)}, "expected numbers"),
        ({"T_align": np.diag([2.0, 1, 1, 1])}, "not a rotation"),
        ({"scale": np.array(100.0)}, "m tall"),
        ({"shape_space": np.array("flame")}, "no body has shapes of 'flame'"),
        ({"shape_space": np.array("smplx"), "joints": None}, "no joints"),
        ({"part": np.array([200], np.uint8)}, "expected numbers"),
        ({"licence": np.zeros(3)}, "not a word"),
        ({"scale": np.zeros(0)}, "'scale': this is not a number"),
        ({"scale": np.array("one")}, "'scale': this is not a number"),
        ({"joints": np.full((55, 3), 1e20)}, "the pelvis lies 1e.20 m off the splats"),
        ({"joints": None, "betas": np.full(10, 1e6)}, "'betas': the .* m off the splats"),
    ],
)
def test_bad_bindings_say_what_is_wrong(
    person: Avatar, folder: Path, arrays: dict[str, np.ndarray], said: str
) -> None:
    change(folder, **arrays)
    with pytest.raises(FormatError, match=said):
        load_splat_person(folder / f"{person.name}.ply")


def test_a_room_or_a_lone_ply_is_refused(person: Avatar, folder: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone"
    alone.mkdir()
    shutil.copy(folder / f"{person.name}.ply", alone / "x.ply")
    with pytest.raises(FormatError, match="no binding says which joints"):
        load_splat_person(alone / "x.ply")


@pytest.mark.parametrize(("name", "data"), [("a.fbx", b"Kaydara FBX Binary"), ("a.png", b"PNG")])
def test_a_file_of_something_else_is_told_what_a_person_is(
    tmp_path: Path, name: str, data: bytes
) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FormatError, match="is not a person that can be read") as caught:
        load_splat_person(tmp_path / name)
    assert "binding.npz" in caught.value.remedy and "skin" in caught.value.remedy
    assert name in str(caught.value)
    assert ("--motion FILE" in caught.value.remedy) == name.endswith(".fbx")


@pytest.mark.parametrize(
    ("change_of", "said"),
    [
        ({"means": (9.0, 1.0, 0.0)}, "splat 7 lies 9.1 m off the middle of the body"),
        ({"scales": (30.0, 0.01, 0.01)}, "splat 7 is 30.0 m large"),
    ],
)
def test_what_an_avatar_s_file_cannot_hold_is_refused(
    person: Avatar, folder: Path, change_of: dict[str, tuple[float, ...]], said: str
) -> None:
    """A splat 9 m off came back at 2.4 m, and one 30 m large as one of 1 m."""
    from gn0.gaussians.ply import save_ply
    from gn0.gaussians.splat_files import load_cloud

    path = folder / f"{person.name}.ply"
    cloud = load_cloud(path).cloud
    for name, value in change_of.items():
        changed = getattr(cloud, name).copy()
        changed[7] = value
        cloud = replace(cloud, **{name: changed})
    save_ply(cloud, path)
    with pytest.raises(FormatError, match=said) as caught:
        load_splat_person(path)
    assert "not of the person" in caught.value.remedy
    far = person.points.copy()
    far[3, 1] = 4.0
    with pytest.raises(DataError, match=r"splat 3 lies farther off than 3\.28 m"):
        save_avatar(folder / "far.npz", replace(person, points=far))
    assert not (folder / "far.npz").exists()


def test_mirrored_joints_lost_normals_and_heavy_weights_are_named(
    person: Avatar, folder: Path
) -> None:
    path = folder / f"{person.name}.ply"
    heavy = np.ones((len(person), 4))
    heavy[5, 1] = 1e300
    flat = person.normals.copy()
    flat[6] = 0.0
    for arrays, said in (
        ({"joints": person.joints * [-1, 1, 1]}, "'joints': .*person's left"),
        ({"weights": heavy}, "'weights': row 5 has a weight of 1e.300"),
        ({"normals": flat}, "'normals': row 6 points nowhere"),
    ):
        kept = {name: ArrayFile(folder / "binding.npz").read(name) for name in arrays}
        change(folder, **arrays)
        with pytest.raises(FormatError, match=said):
            load_splat_person(path)
        change(folder, **kept)


def test_an_avatar_of_ours_needs_no_import(
    person: Avatar, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_avatar(tmp_path / "own.npz", person)
    command = ["avatar", "import", str(tmp_path / "own.npz"), "--out", str(tmp_path / "o.npz")]
    assert main(command) == 2
    assert "an avatar of GN0 needs no import" in capsys.readouterr().err


def test_the_command_line_brings_a_person(
    person: Avatar, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = folder / "p.npz"
    assert main(["avatar", "import", str(folder / f"{person.name}.ply"), "--out", str(out)]) == 0
    assert "CC0-1.0" in capsys.readouterr().out
    assert len(load_avatar(out)) == len(person)
    mine = ["--in-bank", "--out", str(folder / "mine" / "anna.npz")]
    assert main(["avatar", "import", str(folder / f"{person.name}.ply"), *mine]) == 0
    assert "anna; hash " in capsys.readouterr().out
    assert AvatarBank(folder / "mine").names == ("anna",)
    other = [str(folder / f"{person.name}.ply"), "--out", str(folder / "p.txt")]
    assert main(["avatar", "import", *other]) == 2  # `avatar show` would not know it
    assert "end it with .npz" in capsys.readouterr().err and not (folder / "p.txt").exists()


def test_a_room_and_a_statue_without_legs_are_no_people(person: Avatar, folder: Path) -> None:
    from gn0.gaussians.ply import save_ply
    from gn0.gaussians.splat_files import load_cloud

    path = folder / f"{person.name}.ply"
    cloud, file = load_cloud(path).cloud, ArrayFile(folder / "binding.npz")
    rows = {n: file.read(n) for n in file.names if file.read(n).shape[:1] == (len(cloud),)}
    spread = np.random.default_rng(0).uniform((-2.5, 0, -2), (2.5, 2.4, 2), cloud.means.shape)
    save_ply(replace(cloud, means=spread.astype(np.float32)), path)
    with pytest.raises(FormatError, match="m deep: rather a room than a person") as caught:
        load_splat_person(path)
    assert caught.value.file == str(path) and "cut the person out" in caught.value.remedy
    for sides, kept in (
        ("left and right", cloud.means[:, 1] > 0.45),
        ("left", (cloud.means[:, 1] > 0.45) | (cloud.means[:, 0] < 0)),
    ):
        save_ply(cloud.select(kept), path)
        change(folder, **{name: values[kept] for name, values in rows.items()})
        with pytest.raises(FormatError, match=f"on its {sides} leg below the knee") as caught:
            load_splat_person(path)
        assert caught.value.field == "weights_idx" and "shoes included" in caught.value.remedy
        change(folder, **rows)
