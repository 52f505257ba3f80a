"""Names at the command line: lists, completion, suggestions, plug-ins by path, one vocabulary."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import gn0.errors
from gn0.cli.completion import list_words
from gn0.cli.list_names import list_kinds
from gn0.cli.main import VERBS, main, suggest_verb
from gn0.errors import ConfigError, StorageError, error_table
from gn0.locked_folder import LOCK, forget_folder
from gn0.plugins import import_plugins
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.suites.suite import open_suite

ROOT = Path(__file__).resolve().parent.parent.parent


@pytest.mark.parametrize("kind", list_kinds())
def test_every_kind_of_name_is_listed(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", kind]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines and all(line.strip() for line in lines)


def test_the_lists_hold_what_other_commands_take(capsys: pytest.CaptureFixture[str]) -> None:
    main(["list", "policies"])
    assert re.search(r"^oracle .*an oracle", capsys.readouterr().out, re.M)
    main(["list", "exports"])
    assert "lerobot-v3" in capsys.readouterr().out


def test_policies_that_say_late_what_they_read_are_listed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Late:
        """Says when it is built."""

        @property
        def sensors(self) -> frozenset[str]:
            return frozenset({"rgb"})

    monkeypatch.setattr("gn0.plugins.plugin_names", lambda kind: ("late",))
    monkeypatch.setattr("gn0.plugins.get_plugin", lambda kind, name: Late)
    assert main(["list", "policies"]) == 0
    assert "late" in (out := capsys.readouterr().out) and "what its options say" in out


def test_completion_knows_every_verb_and_every_flag_of_its_help(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = list_words()
    for verb in ("bench run", "scene import", "data build", "export"):
        with pytest.raises(SystemExit):
            main([*verb.split(), "--help"])
        shown = set(re.findall(r"(--[a-z][a-z-]+)", capsys.readouterr().out.split("options")[-1]))
        known = set(words[verb])
        if verb == "scene import":
            shown = {flag for flag in shown if flag in known}  # the text names flags of others
        assert shown <= known, shown - known
    assert set(VERBS) <= set(words)
    assert words["bench run"]["--profile"][:2] == ("default", "paper")


@pytest.mark.skipif(not shutil.which("bash"), reason="no bash here")
def test_bash_completes_verbs_flags_and_values(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out

    def complete(*words: str) -> list[str]:
        typed = " ".join(f"'{word}'" for word in words)
        code = f"{script}\nCOMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}; _gn0\n"
        code += 'printf "%s\\n" "${COMPREPLY[@]}"'
        done = subprocess.run(
            ["bash", "-c", code], capture_output=True, text=True, check=True, cwd="/"
        )
        return done.stdout.split()

    assert complete("gn0", "ben") == ["bench"]
    assert complete("gn0", "bench", "rep") == ["report", "replay"]
    assert "--map-mode" in complete("gn0", "bench", "run", "--m")
    assert complete("gn0", "bench", "run", "--map-mode", "") == ["prior", "explored", "none"]
    assert "lerobot-v3" in complete("gn0", "export", "lero")


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_parse_their_script(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "bench" in script
    if not shutil.which(shell):
        pytest.skip(f"no {shell} here: its script was made, not parsed")
    subprocess.run([shell, "-n"], input=script, text=True, check=True)


@pytest.mark.parametrize(
    ("typed", "verb"),
    [
        ("bench runn", "bench run"),
        ("bencrun", "bench run"),
        ("replay x", "bench replay"),
        ("generate scene", "scene generate"),
        ("missions gen", "missions generate"),
        ("scene-import", "scene import"),
        ("docter", "doctor"),
        ("xyzzy", ""),
    ],
)
def test_a_misspelt_verb_is_guessed_whole(typed: str, verb: str) -> None:
    assert suggest_verb(typed.split()) == verb


def test_positionals_are_called_by_what_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    for verb in VERBS:
        with pytest.raises(SystemExit):
            main([*verb.split(), "--help"])
        help_text = capsys.readouterr().out
        assert not re.search(r"^│ +[\[(]*STR\b", help_text, re.M), verb
        assert not re.search(r"^usage: gn0 [a-z ]+(\[\S+\] )*[\[(]*STR\b", help_text), verb


def test_export_lerobot_names_the_formats_that_it_may_mean(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["export", "lerobot", "somewhere", "--out", "elsewhere"]) == 2
    err = capsys.readouterr().err
    assert "lerobot-v3" in err and "interndata-n1" in err and "navila" not in err


def test_error_codes_in_the_documents_are_those_of_the_code() -> None:
    assert error_table() in (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
    assert error_table().count("\n") >= len(vars(gn0.errors)) / 4


def test_what_we_tell_people_to_install_works_from_a_checkout() -> None:
    """Not on an index yet: `pip install gn0` would find nothing, or somebody else's."""
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("src/**/*.py")]
    shipped = [*ROOT.glob("examples/**/*"), *ROOT.glob("runs/*"), ROOT / "constraints.txt"]
    for path in [*pages, *(path for path in shipped if path.is_file())]:
        for line in path.read_text("utf-8").splitlines():
            if "--no-index" not in line:
                assert not re.search(r"pip (install|download) '?gn0\b", line), (path, line)


def test_a_plug_in_is_found_by_its_path_and_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "by_path_71.py").write_text("import beside_71\n")
    (tmp_path / "sub" / "beside_71.py").write_text("")
    (tmp_path / "in_folder_71.py").write_text("")
    (tmp_path / "json.py").write_text("")
    (tmp_path / "broken_71.py").write_text("import nowhere_71")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    names = import_plugins(["sub/by_path_71.py", "in_folder_71"])
    assert names == ("by_path_71", "in_folder_71")
    for wrong, why in (
        ("gone_71.py", "no such file"),
        ("json.py", "rename it"),
        ("broken_71.py", "nowhere_71"),
        ("no such name", "package.module"),
    ):
        with pytest.raises(ConfigError) as caught:
            import_plugins([wrong])
        assert why in caught.value.what and caught.value.where == "--plugin"
    assert import_module("json").__file__ != str(tmp_path / "json.py")


def test_a_scene_folder_serves_where_a_suite_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    scene = str(tmp_path / "flat")
    save_scene(build_example_scene(spacing=0.2), scene)
    assert len(open_suite(scene).episodes) == len(open_suite(scene).episodes) == 50
    assert (
        main(
            ["missions", "export", scene, "--format", "vlnce", "--out", str(tmp_path / "e.json.gz")]
        )
        == 0
    )
    assert "50 episodes" in capsys.readouterr().out
    out = str(tmp_path / "data")
    build = ["data", "build", scene, "--layout", "none", "--out", out]
    assert main([*build, "--backend", "cuda"]) == 0
    said = capsys.readouterr()
    assert "50 episodes" in said.out
    assert "no card draws here" in said.err
    assert main([*build, "--tokens", "ego"]) == 2  # another dataset lies there
    assert main([*build, "--tokens", "ego", "--fresh"]) == 0


def test_only_a_folder_of_its_own_kind_is_forgotten(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("x")
    with pytest.raises(StorageError, match="something else"):
        forget_folder(tmp_path, "dataset.json")
    (tmp_path / "dataset.json").write_text("{}")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "file").write_text("x")
    forget_folder(tmp_path, "dataset.json")
    assert {path.name for path in tmp_path.iterdir()} <= {LOCK}
