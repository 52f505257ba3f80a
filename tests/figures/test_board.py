"""The command that fills the board: what is skipped, what breaks off, what is kept."""

from __future__ import annotations

import importlib
from pathlib import Path

import msgspec
import pytest

from gn0.cli import figures as verb
from gn0.errors import ConfigError
from gn0_figures import catalogue
from gn0_figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    FigureSkipped,
    load_board,
    write_board,
)


def _row(name: str, passed: bool | None = True) -> FigureRow:
    return FigureRow(name=name, value=1.0, unit="s", passed=passed)


def _breaks(ctx: FigureContext) -> list[FigureRow]:
    ctx.report(_row("first"))
    ctx.report(_row("second", None))
    raise RuntimeError("the card fell out")


def _fails(ctx: FigureContext) -> list[FigureRow]:
    raise AssertionError("at once")


def _lacks(ctx: FigureContext) -> list[FigureRow]:
    raise FigureSkipped("needs a GPU: none seen")


def _absent(ctx: FigureContext) -> list[FigureRow]:
    ctx.need_data("worlds/nowhere")
    return []


def _reports(ctx: FigureContext) -> list[FigureRow]:
    rows = [_row("early"), _row("late", passed=False)]
    ctx.report(rows[0])
    return rows


FIGURES = {
    name: Figure(id=f"room.{name}", title=name.title(), measure=measure)
    for name, measure in {
        "breaks": _breaks, "fails": _fails, "lacks": _lacks, "absent": _absent, "reports": _reports
    }.items()
}  # fmt: skip


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    known = {figure.id: figure for figure in FIGURES.values()}
    monkeypatch.setattr(catalogue, "all_figures", lambda: known)
    return tmp_path


def test_one_figure_s_failure_leaves_the_others(
    out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert verb.run(verb.Args(all=True, out=str(out), data=str(out))) == 1
    said = capsys.readouterr()
    assert "the card fell out" in said.err
    assert "room.lacks: skipped, needs a GPU: none seen" in said.out
    assert "room.absent: skipped, needs worlds/nowhere" in said.out
    assert said.out.count("room.reports: early") == 1
    assert "room.reports: late: 1 s  MISSED" in said.out
    board = load_board(out / "figures.json")
    assert {i: [row.name for row in e.rows] for i, e in board.items()} == {
        "room.breaks": ["first", "second"],
        "room.fails": [],
        "room.lacks": [],
        "room.reports": ["early", "late"],
    }
    assert board["room.breaks"].note == "broke off: RuntimeError: the card fell out"
    page = (out / "figures.md").read_text()
    assert "`gn0 figures room.lacks` · not measured: needs a GPU: none seen" in page
    assert "**Unfinished:** broke off: RuntimeError: the card fell out" in page


def test_a_skip_leaves_what_was_measured(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    args = verb.Args(ids=("room.lacks",), out=str(out))
    object.__setattr__(FIGURES["lacks"], "measure", lambda ctx: [_row("once")])
    try:
        assert verb.run(args) == 0
        object.__setattr__(FIGURES["lacks"], "measure", _lacks)
        assert verb.run(args) == 0
    finally:
        object.__setattr__(FIGURES["lacks"], "measure", _lacks)
    assert [row.name for row in load_board(out / "figures.json")["room.lacks"].rows] == ["once"]


def test_a_backend_chooses_its_figures(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ConfigError, match="no figure of those chosen"):
        verb.run(verb.Args(all=True, backend="cuda", out=str(out)))
    with pytest.raises(ConfigError, match="no such folder"):
        verb.run(verb.Args(ids=("room",), scenes=str(out / "absent"), out=str(out)))
    with pytest.raises(ConfigError, match="no figure"):
        verb.run(verb.Args(ids=("cellar",), out=str(out)))
    assert verb.run(verb.Args(list=True)) == 0
    assert "room.breaks" in capsys.readouterr().out


def test_rows_of_another_machine_are_taken_over(
    out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("here", "there"):
        (out / name).mkdir()
    verb.run(verb.Args(ids=("room.reports",), out=str(out / "here")))
    verb.run(verb.Args(ids=("room.breaks", "room.lacks"), out=str(out / "there")))
    there = out / "there" / "figures.json"
    assert verb.run(verb.Args(merge=str(there), out=str(out / "here"))) == 0
    board = load_board(out / "here" / "figures.json")
    assert set(board) == {"room.reports", "room.breaks"}, "what has no rows stays where it is"
    assert "room.breaks: 2 rows" in capsys.readouterr().out
    board["room.breaks"] = msgspec.structs.replace(
        board["room.breaks"], hardware="host emulation · a CPU", note="pretended"
    )
    write_board(out / "there", board.values())
    assert verb.run(verb.Args(merge=str(there), ids=("room",), out=str(out / "here"))) == 0
    assert "room.breaks: left where it is" in capsys.readouterr().out
    assert load_board(out / "here" / "figures.json")["room.breaks"].note != "pretended"
    with pytest.raises(ConfigError, match="no board there"):
        verb.run(verb.Args(merge=str(out / "absent.json"), out=str(out / "here")))


def test_a_room_without_its_package_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogue, "_MODULES", ("board_absent_room", "install"))
    monkeypatch.setattr(catalogue, "import_module", _import_without)
    assert catalogue.left_out() == {"board_absent_room": "av"}
    assert all(name.startswith("install") for name in catalogue.all_figures())
    with pytest.raises(ConfigError, match="board_absent_room needs av"):
        catalogue.find_figures(["export"])


def _import_without(name: str) -> object:
    if name.endswith("board_absent_room"):
        raise ModuleNotFoundError("No module named 'av'", name="av")
    return importlib.import_module(name)


def test_an_installed_package_says_where_the_board_s_code_lies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verb, "find_spec", lambda name: None)
    with pytest.raises(ConfigError) as caught:
        verb._find_board(tmp_path)
    assert "benchmarks/gn0_figures" in str(caught.value.remedy)
    assert "pip install -e '.[dev]'" in str(caught.value.remedy)
