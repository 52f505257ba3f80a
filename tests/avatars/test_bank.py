"""A bank of avatars: made again to the byte, gone on with, and never quietly another."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from gn0.avatars.bank import AvatarBank, load_avatar, open_avatars
from gn0.avatars.bank_build import generate_bank, join_bank
from gn0.cli.main import main
from gn0.errors import ConfigError, EpisodeError, FormatError, StorageError
from gn0.people.cast import Cast
from gn0.people.person import EpisodePerson


def files(folder: Path) -> dict[str, bytes]:
    return {
        p.name: p.read_bytes() for p in sorted(folder.iterdir()) if p.suffix in (".npz", ".json")
    }


@pytest.fixture(scope="module")
def bank(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bank") / "people"
    generate_bank(folder, count=2, seed=1, density=0.05)
    return folder


def test_a_bank_is_the_same_however_it_was_made(bank: Path, tmp_path: Path) -> None:
    generate_bank(tmp_path / "two", count=2, seed=1, density=0.05, workers=2)
    assert files(tmp_path / "two") == files(bank)


def test_a_bank_that_was_cut_goes_on(bank: Path, tmp_path: Path) -> None:
    shutil.copytree(bank, tmp_path / "b")
    (tmp_path / "b" / "p0001.npz").write_bytes(b"half")
    (tmp_path / "b" / "bank.json").unlink()
    kept = (tmp_path / "b" / "p0000.npz").stat().st_mtime_ns
    generate_bank(tmp_path / "b", count=2, seed=1, density=0.05)
    assert files(tmp_path / "b") == files(bank)
    assert (tmp_path / "b" / "p0000.npz").stat().st_mtime_ns == kept


def test_another_bank_is_not_mixed_in(bank: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="another bank"):
        generate_bank(bank, count=4, seed=1, density=0.05)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(StorageError, match="something else"):
        generate_bank(tmp_path, count=1, density=0.05)
    with pytest.raises(ConfigError, match="1 to 100,000 people"):
        generate_bank(tmp_path / "x", count=0)


def test_avatars_are_read_as_they_were_written(bank: Path) -> None:
    opened = AvatarBank(bank)
    avatar = opened.load("p0001")
    assert avatar.name == "p0001" and avatar.record == opened.entry("p0001").record
    assert avatar.shape_space == "gn0" and len(avatar.betas) == 10
    assert len(open_avatars(bank)) == 2 and open_avatars(bank / "p0001.npz")[0].name == "p0001"
    with pytest.raises(FormatError, match="no avatar is named 'p9'"):
        opened.load("p9")


def test_a_changed_avatar_is_not_taken_for_the_bank_s(bank: Path, tmp_path: Path) -> None:
    for path in bank.iterdir():
        if path.suffix in (".npz", ".json"):
            (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "p0000.npz").write_bytes((bank / "p0001.npz").read_bytes())
    with pytest.raises(FormatError, match="another than the bank's list says"):
        AvatarBank(tmp_path).load("p0000")
    listed = json.loads((bank / "bank.json").read_text())
    (tmp_path / "bank.json").write_text(json.dumps({**listed, "layout": 9}))
    with pytest.raises(FormatError, match="layout 9") as caught:
        AvatarBank(tmp_path)
    assert caught.value.remedy == "update GN0"
    (tmp_path / "bank.json").write_text("{}")
    with pytest.raises(FormatError, match="not a bank"):
        AvatarBank(tmp_path)
    (tmp_path / "bank.json").unlink()
    with pytest.raises(
        StorageError, match=r"is not a bank of people: it has no bank\.json"
    ) as lost:
        AvatarBank(tmp_path)
    assert "gn0 avatar generate" in lost.value.remedy


@pytest.mark.parametrize("cut", [0, 30, 2000])
def test_a_damaged_avatar_gives_our_error(bank: Path, tmp_path: Path, cut: int) -> None:
    data = bytearray((bank / "p0000.npz").read_bytes())
    if cut == 2000:
        data[cut : cut + 400] = np.random.default_rng(0).bytes(400)
    else:
        data = data[:cut]
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(FormatError):
        load_avatar(tmp_path / "a.npz")


@pytest.mark.parametrize("field", ["points", "scales", "albedo"])
def test_numbers_that_no_avatar_has_are_named(bank: Path, tmp_path: Path, field: str) -> None:
    with np.load(bank / "p0000.npz", allow_pickle=False) as found:
        arrays = dict(found)
    arrays[field] = arrays[field].astype(np.float64)
    arrays[field][0, 0] = 1e30
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(FormatError, match="not within") as caught:
        load_avatar(tmp_path / "a.npz")
    assert caught.value.field == field and caught.value.remedy


def test_the_command_line_makes_shows_and_checks(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "bank")
    assert main(["avatar", "generate", "--count", "2", "--density", "0.15", "--out", out]) == 0
    assert (tmp_path / "bank" / "people.jpg").stat().st_size > 5_000
    assert "people.jpg" in capsys.readouterr().out
    picture = tmp_path / "p.png"
    assert main(["avatar", "show", out, "--name", "p0001", "--out", str(picture)]) == 0
    assert picture.read_bytes()[:4] == b"\x89PNG" and "hair_colour" in capsys.readouterr().out
    assert main(["avatar", "check", out, "--name", "p0001"]) in (0, 1)
    assert "1 avatar:" in capsys.readouterr().out
    assert main(["avatar", "show", str(tmp_path / "none"), "--out", str(picture)]) == 2


def test_what_is_no_bank_is_told_apart(
    bank: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    note = tmp_path / "note.txt"
    note.write_text("mine")
    (tmp_path / "empty").mkdir()
    nobody = tmp_path / "nobody"
    nobody.mkdir()
    listed = json.loads((bank / "bank.json").read_text())
    (nobody / "bank.json").write_text(json.dumps(listed | {"avatars": []}))
    for argv, said in (
        (["show", tmp_path / "none"], "there is no such bank"),
        (["show", tmp_path / "empty"], "it has no bank.json"),
        (["animate", nobody, "--motion", "walk", "--out", tmp_path / "w"], "lists nobody"),
        (["show", bank / "p0000.npz", "--name", "p0000"], "is the file of one avatar"),
        (["show", bank, "--out", tmp_path / "a.gif"], "end it with .png or .jpg"),
        (["generate", "--count", 1, "--out", note], "is a file, not a folder"),
    ):
        assert main(["avatar", *map(str, argv)]) == 2
        assert said in capsys.readouterr().err
    assert note.read_text() == "mine"
    assert main(["avatar", "show", str(bank), "--out", str(tmp_path / "a.jpg")]) == 0
    assert (tmp_path / "a.jpg").read_bytes()[:2] == b"\xff\xd8"


def test_people_of_ones_own_become_a_bank(bank: Path, tmp_path: Path) -> None:
    """In whatever order they come; the bank is what episodes name people of."""
    one, two = (load_avatar(bank / f"p000{k}.npz") for k in (0, 1))
    mine, other = tmp_path / "mine", tmp_path / "other"
    for folder, order in ((mine, (("zoë", one), ("anna", two))),
                          (other, (("anna", two), ("zoë", one), ("anna", two)))):  # fmt: skip
        for name, avatar in order:
            listed = join_bank(folder / f"{name}.npz", avatar)
    assert [entry.name for entry in listed.avatars] == ["anna", "zoë"]
    for name in ("anna.npz", "zoë.npz", "bank.json"):
        assert (mine / name).read_bytes() == (other / name).read_bytes()
    opened = AvatarBank(mine)
    assert opened.content_hash == listed.hash and opened.load("zoë").name == "zoë"
    assert np.array_equal(opened.load("anna").points, two.points)
    before = {path.name: path.read_bytes() for path in mine.iterdir()}
    for path, said in (
        (mine / "anna.npz", "has another person called 'anna'"),
        (bank / "anna.npz", "generated people"),
        (mine / "a b.npz", "names no person"),
        (mine / "anna.txt", "names no person"),
    ):
        with pytest.raises(ConfigError, match=said):
            join_bank(path, one)
    assert {path.name: path.read_bytes() for path in mine.iterdir()} == before
    cast = Cast(mine)
    walker = EpisodePerson(number=1, identity="anna", path=((0.0, 0.0), (1.0, 0.0)))
    cast.check((msgspec.structs.replace(walker, bank=listed.hash),))
    with pytest.raises(EpisodeError, match="is of bank 0"):
        cast.check((msgspec.structs.replace(walker, bank="0"),))


def test_a_long_name_stands_apart_from_what_is_found(monkeypatch, tmp_path, capsys) -> None:
    """A mesh has the name of its file, `RobotExpressive`, which ran into the finding."""
    avatar = SimpleNamespace(name="RobotExpressive")
    monkeypatch.setattr("gn0.avatars.bank.open_avatars", lambda *_: [avatar])
    found = [SimpleNamespace(code="stray", text="a splat lies 0.7 m off all joints")]
    monkeypatch.setattr("gn0.viewer.avatar_check.check_avatar", lambda *_: found)
    assert main(["avatar", "check", str(tmp_path)]) == 1
    assert "RobotExpressive stray: a splat" in capsys.readouterr().out
