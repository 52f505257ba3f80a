"""The command line: verbs, help, exit codes, and errors a newcomer can act on."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from gn0.cli.main import VERBS, find_verb, format_error, main, top_help
from gn0.errors import FormatError
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene


def test_help_names_every_verb(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(verb in out for verb in VERBS)
    assert main(["scene"]) == 0
    assert "bench" not in capsys.readouterr().out
    assert "gn0 demo" in top_help()


def test_what_verbs_do_is_written_in_one_column() -> None:
    lines = [line for line in top_help().splitlines() if line.startswith("  ")]
    texts = {verb: text for verb, (_, text) in VERBS.items()}
    columns = {
        line.index(texts[v])
        for v in texts
        for line in lines
        if line.split(texts[v])[0].strip() == v
    }
    assert len(columns) == 1


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_with_examples(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*verb.split(), "--help"])
    assert stop.value.code == 0
    out = capsys.readouterr().out
    assert "examples:" in out
    assert f"gn0 {verb}" in out
    module = import_module(f"gn0.cli.{VERBS[verb][0]}")
    assert module.__doc__ and callable(module.run)


def test_typos_get_a_hint(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docter"]) == 2
    assert "did you mean `gn0 doctor`" in capsys.readouterr().err
    assert main(["scene", "improt"]) == 2
    assert "scene import" in capsys.readouterr().err


def test_unknown_settings_end_with_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["doctor", "--no-such-setting"])
    assert stop.value.code == 2


def test_errors_name_the_place_and_the_remedy(
    tmp_path: object, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = f"{tmp_path}/absent.ply"
    assert main(["scene", "inspect", missing]) == 2
    err = capsys.readouterr().err
    assert "absent.ply" in err and "→" in err and "Traceback" not in err
    text = format_error(FormatError("cut short", file="a", offset=3, remedy="fetch it again"))
    assert text == "gn0: error [FORMAT] a, byte 3: cut short\n  → fetch it again"


def test_doctor_finds_everything(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert "renderer" in out and "cpu" in out and "all is well" in out


def test_verbs_are_found_longest_first() -> None:
    assert find_verb(["scene", "show", "x"]) == ("scene show", ["x"])
    assert find_verb(["demo", "--out", "x"]) == ("demo", ["--out", "x"])
    assert find_verb(["nothing"]) == ("", ["nothing"])


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from gn0.cli.main import main; main(['--help']);"
        "print([m for m in ('numpy','numba','tyro','rich') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")


def test_a_setting_out_of_range_is_named_as_it_was_typed(
    tmp_path: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["scene", "generate", "--density", "3", "--out", f"{tmp_path}/flat"]) == 2
    err = capsys.readouterr().err
    assert "--density" in err and "5000" in err


def test_unwritable_places_are_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def work(*args: object, **more: object) -> None:
        raise AssertionError("began to work")

    monkeypatch.setattr("gn0.scenes.procedural.generate.build_generated", work)
    monkeypatch.setattr("gn0.scenes.scene_sources.find_source", work)
    monkeypatch.setattr("gn0.viewer.scene_sheet.render_sheet", work)
    save_scene(build_example_scene(spacing=0.2), tmp_path / "flat")
    (tmp_path / "file").write_text("mine")
    for place in (f"{tmp_path}/file", f"{tmp_path}/file/below"):
        assert main(["scene", "generate", "--overwrite", "--out", place]) == 2
        assert main(["scene", "import", f"{tmp_path}/flat", "--overwrite", "--out", place]) == 2
    assert main(["scene", "show", f"{tmp_path}/flat", "--out", f"{tmp_path}/file/a.png"]) == 2
    err = capsys.readouterr().err
    assert err.count("a file, not a folder") == 5
    assert (tmp_path / "file").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "flat"]
