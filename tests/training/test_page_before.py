"""Rows of a page are found by where they stand, and what is no such page is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.errors import FormatError
from gn0.training.study.page_before import PageBefore, load_page

PAGE = """# A study

| a table | of a preface |
| --- | --- |
| SFT | 1 |

## Maps

### Held-out scenes

| policy | seeds | SR |
| --- | --- | --- |
| SFT (`sft`) | 2 of 3 | 40.0 [30.0, 50.0] |
| RL (`rl`) | 0 of 2 | *not run yet: `gn0 train rl a\\|b`* |
| *the paper* |  | *29.4* |

SR by missions, Held-out scenes:

| policy | all |
| --- | --- |
| SFT | 40.0 |

## Stages

| run | entropy |
| --- | --- |
| SFT (`sft`) | 0.1 |
"""
COLUMNS = ("policy", "seeds", "SR")


def _load(folder: Path, text: str) -> PageBefore:
    (folder / "page.md").write_text(text)
    return load_page(folder / "page.md")


def test_a_row_is_found_where_it_stands_and_only_there(tmp_path: Path) -> None:
    page = _load(tmp_path, PAGE)
    found = page.find("Maps", "Held-out scenes", COLUMNS, "SFT (`sft`)")
    assert found == ("SFT (`sft`)", "2 of 3", "40.0 [30.0, 50.0]")
    assert page.find("Maps", "SR by missions, Held-out scenes", ("policy", "all"), "SFT")
    assert page.find("Stages", "", ("run", "entropy"), "SFT (`sft`)") == ("SFT (`sft`)", "0.1")
    assert len(page.used) == 3
    assert page.find("Maps", "", COLUMNS, "SFT (`sft`)") is None
    assert page.find("Views", "Held-out scenes", COLUMNS, "SFT (`sft`)") is None
    assert PageBefore().find("Maps", "Held-out scenes", COLUMNS, "SFT (`sft`)") is None


def test_a_row_of_no_more_seeds_than_are_here_says_nothing_new(tmp_path: Path) -> None:
    page = _load(tmp_path, PAGE)
    assert page.find("Maps", "Held-out scenes", COLUMNS, "SFT (`sft`)", more=1)
    assert page.find("Maps", "Held-out scenes", COLUMNS, "SFT (`sft`)", more=2) is None
    assert page.find("Maps", "Held-out scenes", COLUMNS, "RL (`rl`)") is None  # not run
    assert len(page.used) == 1


@pytest.mark.parametrize(
    ("was", "made", "told"),
    [
        ("| 2 of 3 | 40.0", "| 40.0", "line 13: a row of 2 cells in a table of 3 columns"),
        ("| SR |", "| SPL |", "line 13: a table of other columns"),
        ("| RL (`rl`) |", "| SFT (`sft`) |", "line 14: a second row of 'SFT (`sft`)'"),
    ],
)
def test_a_page_that_fits_no_study_is_refused(
    tmp_path: Path, was: str, made: str, told: str
) -> None:
    with pytest.raises(FormatError) as caught:
        page = _load(tmp_path, PAGE.replace(was, made, 1))
        page.find("Maps", "Held-out scenes", COLUMNS, "SFT (`sft`)")
    assert told in str(caught.value) and str(tmp_path / "page.md") in str(caught.value)


def test_a_page_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_bytes(b"# A study\n\xff\n")
    with pytest.raises(FormatError, match="byte 10: this is not UTF-8 text"):
        load_page(tmp_path / "page.md")


@given(st.text(alphabet="|#-\\ \n\tSa`*", max_size=200))
def test_any_text_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    try:
        _load(tmp_path_factory.mktemp("page"), text)
    except FormatError as error:
        assert "line" in str(error)
