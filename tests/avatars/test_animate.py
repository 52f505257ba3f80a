"""`gn0 avatar animate`: poses are read back, splats load, a film; bad input is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gn0.avatars.bank import load_avatar, save_avatar
from gn0.avatars.bank_build import generate_bank
from gn0.avatars.motion.legs import measure_build
from gn0.avatars.motion.lhm import save_lhm_document
from gn0.avatars.motion.library import ClipLibrary
from gn0.avatars.motion.motion_file import save_motion
from gn0.avatars.motion.open_motion import load_motion
from gn0.avatars.motion.play import play_motion
from gn0.avatars.motion.standing_joints import STANDING_JOINTS
from gn0.cli.main import main
from gn0.errors import FormatError
from gn0.gaussians.splat_files import load_cloud
from gn0.viewer.avatar_film import SIZE, draw_strip, film_motion


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bank") / "people"
    generate_bank(folder, count=2, seed=1, density=0.05)
    return folder


def animate(*argv: object) -> int:
    return main(["avatar", "animate", *map(str, argv)])


def test_a_walk_is_written_and_read_back(bank: Path, tmp_path: Path) -> None:
    out = tmp_path / "walk"
    assert animate(bank, "--name", "p0001", "--motion", "walk", "--out", out, "--seconds", 0.5,
                   "--fps", 10, "--ply") == 0  # fmt: skip
    avatar = load_avatar(bank / "p0001.npz")
    meant = play_motion(
        ClipLibrary(measure_build(avatar.joints, avatar.points, avatar.weights)).motion("walk"),
        10.0, 0.5,
    )  # fmt: skip
    read = load_motion(out / "smplx.json", avatar.joints)
    assert len(read) == 6 and read.fps == 10.0
    assert np.abs(read.poses - meant.poses).max() < 1e-9
    assert np.abs(read.shift - meant.shift).max() < 1e-9
    document = json.loads((out / "smplx.json").read_text())
    assert document["shape_space"] == "gn0"
    frame = document["frames"][0]
    assert np.shape(frame["body_pose"]) == (21, 3) and np.shape(frame["lhand_pose"]) == (15, 3)
    assert len(frame["root_pose"]) == len(frame["jaw_pose"]) == len(frame["trans"]) == 3
    assert frame["betas"] == [float(b) for b in avatar.betas]
    cloud = load_cloud(out / "frame00006.ply").cloud
    posed = avatar.pose(meant.poses[5], meant.shift[5])
    assert np.array_equal(cloud.means, posed.means)
    assert (out / "walk.mp4").stat().st_size > 1000
    assert len(list(out.glob("*.ply"))) == 6


def test_files_of_motion_are_played(bank: Path, tmp_path: Path) -> None:
    motion = ClipLibrary(measure_build(STANDING_JOINTS)).motion("wave")
    save_motion(motion, tmp_path / "mine.npz")
    out = tmp_path / "file"
    assert animate(bank / "p0000.npz", "--motion", tmp_path / "mine.npz", "--out", out,
                   "--seconds", 0.4, "--fps", 10) == 0  # fmt: skip
    assert {p.name for p in out.iterdir()} == {"smplx.json", "mine.mp4"}
    # and what was written is itself a motion
    again = tmp_path / "again"
    assert animate(bank, "--motion", out / "smplx.json", "--out", again, "--fps", 10) == 0
    assert len(load_motion(again / "smplx.json")) == 5


def test_frames_of_a_longer_animation_are_not_mixed_in(
    bank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "walk"
    walk = [bank, "--motion", "walk", "--fps", 10, "--out", out]
    assert animate(*walk, "--seconds", 0.5, "--ply") == 0
    before = (out / "smplx.json").read_bytes()
    for more in (["--seconds", 0.3, "--ply"], ["--seconds", 0.5]):
        assert animate(*walk, *more) == 2
        assert "frame00006.ply" in capsys.readouterr().err
    assert (out / "smplx.json").read_bytes() == before
    assert animate(*walk, "--seconds", 0.7, "--ply") == 0 and len(list(out.glob("*.ply"))) == 8


def test_what_a_camera_saw_stands_on_the_floor(
    bank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The frames of LHM know no floor: people sank by 1.74 m."""
    frames = tmp_path / "lhm"
    frames.mkdir()
    upright = {"root_pose": [np.pi, 0, 0], "body_pose": [0.0] * 63, "trans": [0, 0, 3]}
    for k in range(1, 5):
        (frames / f"{k:05d}.json").write_text(json.dumps(upright))
    seen = [bank, "--motion", frames, "--fps", 10, "--ply", "--out", tmp_path / "out"]
    assert animate(*seen) == 0
    assert "m under the floor: its lowest foot is put on it" in capsys.readouterr().out
    cloud = load_cloud(tmp_path / "out" / "frame00001.ply").cloud
    rest = load_avatar(bank / "p0000.npz").pose(shadow=False)
    assert abs(np.quantile(cloud.means[:, 2], 0.001) - np.quantile(rest.means[:, 2], 0.001)) < 0.03


def test_the_same_command_writes_the_same_bytes(bank: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert animate(bank, "--motion", "start", "--seconds", 0.3, "--seed", 3, "--out",
                       tmp_path / name) == 0  # fmt: skip
    for file in ("smplx.json", "start.mp4"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--motion", "moonwalk"], "neither a clip of the library nor a file"),
        (["--motion", ""], "neither a clip of the library nor a file"),
        (["--motion", "walk", "--name", "p9999"], "no avatar is named"),
        (["--motion", "walk", "--speed", "9"], "speed"),
        (["--motion", "sit", "--seat", "2"], "seat"),
        (["--motion", "wave", "--seconds", "0.01"], "one frame"),
        (["--motion", "wave", "--speed", "1.4"], "--speed is of carry, start, stop, walk"),
        (["--motion", "walk", "--seat", "0.3"], "--seat is of sit, sit_down, stand_up"),
    ],
)
def test_bad_input_is_refused(
    bank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], argv: list[str], words: str
) -> None:
    try:
        code = animate(bank, *argv, "--out", tmp_path / "o")
    except SystemExit as stop:
        code = int(stop.code or 0)
    assert code != 0
    shown = capsys.readouterr()
    assert words in shown.out + shown.err
    assert not (tmp_path / "o").exists()


def test_a_folder_of_something_else_is_left_as_it_was(
    bank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.json").write_text("{}")
    assert animate(bank, "--motion", "wave", "--seconds", 0.2, "--out", tmp_path) == 2
    assert "holds something else" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["scene.json"]


def test_documents_of_frames_are_checked(tmp_path: Path) -> None:
    motion = play_motion(ClipLibrary(measure_build(STANDING_JOINTS)).motion("point"), 5.0)
    path = tmp_path / "m.json"
    save_lhm_document(path, motion, np.zeros(10), "gn0", STANDING_JOINTS)
    whole = json.loads(path.read_text())
    read = load_motion(path)
    assert np.abs(read.poses - motion.poses).max() < 1e-9
    for spoil, words in (
        (lambda d: d["frames"][1].pop("trans"), "trans"),
        (lambda d: d["frames"][0]["body_pose"].pop(), "body_pose"),
        (lambda d: d.update(frames=d["frames"][:1]), "does not move"),
        (lambda d: d.update(fps=0), "frames a second"),
        (lambda d: d["frames"][0].update(trans=[1e9, 0, 0]), "trans"),
    ):
        broken = json.loads(json.dumps(whole))
        spoil(broken)
        path.write_text(json.dumps(broken))
        with pytest.raises(FormatError, match=words):
            load_motion(path)


def test_films_follow_the_person(bank: Path, tmp_path: Path) -> None:
    avatar = save_avatar(tmp_path / "a.npz", load_avatar(bank / "p0000.npz"))
    walk = play_motion(ClipLibrary(measure_build(avatar.joints)).motion("walk", 1.3), 10.0, 3.0)
    pictures = film_motion(avatar, walk, [0, 15, 30])
    assert all(picture.shape == (SIZE[1], SIZE[0], 3) for picture in pictures)
    paper = pictures[0][0, 0].astype(int)
    for picture in pictures:  # four metres on, still in the middle
        seen = np.abs(picture.astype(int) - paper).max(axis=2) > 60
        columns = np.flatnonzero(seen[80:200].any(axis=0))
        assert abs(columns.mean() - SIZE[0] / 2) < 40
    assert draw_strip(pictures).size == (3 * SIZE[0], SIZE[1])
