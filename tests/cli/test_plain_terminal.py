"""What a terminal is told: names from data are shown, never obeyed."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.bench.results import EpisodeResult, load_summary
from gn0.bench.runner import run_suite
from gn0.cli.console import PlainStream, plain_text
from gn0.cli.main import main
from gn0.cli.result_tables import print_summaries
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.suites.suite import build_suite

pytestmark = pytest.mark.usefixtures("workers_here")

ATTACKS = [
    "\x1b]0;owned\x07", "\x1b[2J\x1b[H", "\x1b]52;c;cm0gLXJm\x07", "\x9b31m", "\x1bP+q\x1b\\",
    "line\rhidden", "a\x08\x08b", "\u202etxt.exe", "zero\u200bwidth", "\x1b[8mhidden", "[red]x[/]",
    "two\nlines", "\x00", "\ufeff", "\x1b[31m red \x1b[0m",
]  # fmt: skip
COMMANDS = [chr(c) for c in (*range(9), *range(11, 32), 127, *range(128, 160), 0x202E, 0x200B)]


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@given(st.text())
def test_plain_text_holds_no_command_and_stays_readable(text: str) -> None:
    plain = plain_text(text)
    assert not any(c in plain for c in COMMANDS) and "\n" not in plain
    if text.isprintable() and text.isascii():
        assert plain == text


@pytest.mark.parametrize("attack", ATTACKS)
def test_streams_let_drawing_pass_on_a_terminal_and_nothing_else(attack: str) -> None:
    pipe, terminal = io.StringIO(), Terminal()
    PlainStream(pipe).write(attack)
    assert not any(c in pipe.getvalue() for c in COMMANDS)
    PlainStream(terminal).write(f"\x1b[1mbold\x1b[0m {attack}")
    shown = terminal.getvalue()
    assert shown.startswith("\x1b[1mbold\x1b[0m ")
    for harmful in ("\x1b]", "\x1bP", "\x07", "\x9b", "\x08", "\u202e", "\x1b[H", "\x1b[2J"):
        assert harmful not in shown


def test_names_of_runs_and_reasons_reach_no_terminal_raw(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_scene(build_example_scene(), tmp_path / "flat")
    for name, count in (("a", 2), ("b", 3)):
        suite = build_suite([tmp_path / "flat"], tmp_path / f"suite-{name}", count, 0)
        run_suite(suite, "straight", tmp_path / name)
        path = tmp_path / name / "summary.json"
        summary = json.loads(path.read_text())
        failed = EpisodeResult(episode="\x1b[2Je", scene="s", status="failed", reason=ATTACKS[0])
        summary.update(policy=ATTACKS[2], name=ATTACKS[2], suite=ATTACKS[0], valid=0)
        summary["failed"] = [json.loads(json.dumps({f: getattr(failed, f) for f in
                             ("episode", "scene", "status", "reason")}))]  # fmt: skip
        path.write_text(json.dumps(summary))
    assert main(["bench", "compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 2
    assert main(["bench", "replay", str(tmp_path / "a")]) == 1
    print_summaries([load_summary(tmp_path / "a")])
    said = capsys.readouterr()
    for text in (said.out, said.err):
        assert not any(c in text for c in COMMANDS)
    assert r"\x1b]0;owned\x07" in said.err and r"\x1b]52" in said.out
    assert sys.stdout.isatty() is False, "the streams are given back"
