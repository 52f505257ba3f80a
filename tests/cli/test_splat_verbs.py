"""`gn0 scene inspect` and `gn0 scene convert` on files of every format."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from gn0.cli.main import main
from gn0.gaussians.splat_files import load_cloud
from gn0.testing.splat_writers import build_sog, build_sog_streamed, build_splat, build_spz
from gn0_trials.splat_corpus import small_cloud


def test_inspect_says_something_of_every_file(
    shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Read or refused: a newcomer gets an answer, never a traceback."""
    for path in sorted((shared_data / "splats").rglob("*")):
        if not path.is_file():
            continue
        code = main(["scene", "inspect", str(path)])
        said = capsys.readouterr()
        if code == 0:
            for word in ("format", "Gaussians", "colour", "axes", "size"):
                assert f"\n{word}" in said.out, path
        else:
            assert code == 2 and path.name in said.err and "→" in said.err, path


def test_inspect_names_levels_and_oddities(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = build_sog_streamed([small_cloud(20, 1), small_cloud(8, 1)])
    for name, data in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
    assert main(["scene", "inspect", str(tmp_path), "--level", "1"]) == 0
    out = capsys.readouterr().out
    size = next(line for line in out.splitlines() if line.startswith("size"))
    assert all(float(v) >= 0 for v in re.findall(r"-?[0-9.]+(?:e[-+]?[0-9]+)?(?= x| in)", size))
    assert "level 1 of 0 (finest) to 1" in out and "degree 1: it changes with the view" in out
    assert main(["scene", "inspect", str(tmp_path), "--level", "2"]) == 2
    assert "choose a level from 0 to 1" in capsys.readouterr().err
    assert main(["scene", "inspect", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["gaussians"] == 20


def test_no_number_is_minus_nothing(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = shared_data / "splats" / "fixtures" / "minimal-v2.spz"
    assert main(["scene", "inspect", str(path)]) == 0
    assert not re.search(r"-0(?![.0-9e])", capsys.readouterr().out.partition("size")[2])


def test_comments_cannot_command_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from gn0.gaussians.ply import save_ply

    save_ply(small_cloud(3, 0), tmp_path / "a.ply", comments=["\x1b[2Jgone"])
    assert main(["scene", "inspect", str(tmp_path / "a.ply")]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out and "gone" in out


@pytest.mark.parametrize("suffix", [".ply", ".compressed.ply"])
def test_convert_keeps_the_gaussians(suffix: str, tmp_path: Path) -> None:
    for name, data in (
        ("a.splat", build_splat(small_cloud(300, 0))),
        ("a.spz", build_spz(small_cloud(300, 2), 4)),
        ("a.sog", build_sog(small_cloud(300, 1))),
    ):
        (tmp_path / name).write_bytes(data)
        out = tmp_path / f"{name}{suffix}"
        assert main(["scene", "convert", str(tmp_path / name), str(out)]) == 0
        source, made = load_cloud(tmp_path / name).cloud, load_cloud(out)
        assert made.cloud.sh_degree == source.sh_degree
        assert made.format == ("ply-packed" if "compressed" in suffix else "ply")
        assert any("converted by GN0 from" in comment for comment in made.comments)
        low, high = source.bounds()
        np.testing.assert_allclose(made.cloud.bounds(), [low, high], atol=1e-5)


def test_convert_overwrites_only_when_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.splat").write_bytes(build_splat(small_cloud(5, 0)))
    (tmp_path / "b.ply").write_text("mine")
    convert = ["scene", "convert", str(tmp_path / "a.splat")]
    assert main([*convert, str(tmp_path / "b.ply")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "b.ply").read_text() == "mine"
    assert main([*convert, str(tmp_path / "b.ply"), "--overwrite"]) == 0
    assert load_cloud(tmp_path / "b.ply").stored == 5
    assert main([*convert, str(tmp_path / "b.obj")]) == 2
    assert "only .ply and .compressed.ply are written" in capsys.readouterr().err
