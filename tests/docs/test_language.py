"""What a user reads is English as a native speaker writes it: phrases that are not stay out.

Searched are the texts of errors in the source, the help of every verb, the documents, and the
reference that is drawn from docstrings.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "gn0"
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "api").glob("*.md")),
    *sorted((ROOT / "examples").glob("*.md")),
]
PAGES = [page for page in PAGES if page.name not in ("figures.md", "CHANGELOG.md")]  # numbers, past

# what is wrong, and what to write
TRANSLATED = {
    r"(?<![Tt]here )\b(?:is|are|was|were) none\b": '"a view that is none": say what it is not',
    r"(?<![Tt]here )\b(?:is|are) no (?!(?:longer|more|worse|less|slower|better|larger)\b)"
    r"(?!(?:part|error|wall)\b)": '"X is no Y": write "X is not a Y"',
    r"\bwould else\b|\belse would\b": 'write "would otherwise"',
    r"\bby turns\b": 'write "alternately"',
    r"\bthat very\b": 'write "this" or "the same"',
    r"\botherwise than\b": 'write "differently from"',
    r"\bthe looks\b|\blooks of\b|\bmoving tails?\b|\bwith tails\b": "name the thing itself",
    r"\bparcels?\b": "name the thing itself",
    r"\b[Mm]end(?:s|ed)?\b": 'write "fix" or "correct"',
    r"\btold off\b|\bis told of\b|\btells of it\b": 'write "refused", "reported"',
    r"\b[Ww]ho wants to\b|\bfor who\b": 'write "anyone who"',
    r"\bin the mean\b": 'write "on average"',
    r"\bthe very (?!end\b)": 'write "the same"',
    r"\bheld against\b": 'write "compared with", "checked against"',
    r"\btold by (?:its|their) (?:content|name)\b|\bfound by looking\b": 'write "detected from"',
    r"\b(?:a|one) (?:line|row|file|picture|sample|worker|process|pixel) an? "
    r"(?:step|scene|episode|core|cell|map cell|trajectory)\b": 'write "one … per …"',
    r"\bby itself alone\b|\bnot so much\b|\bfor ever\b": "write plainly",
}


def source_texts() -> Iterator[tuple[str, str]]:
    """(place, text) of what the source can say: strings of two words or more, but docstrings."""
    for file in sorted(SOURCE.rglob("*.py")):
        if file.parent.name == "testing" and not file.name.endswith("_check.py"):
            continue  # trials, not texts for users
        tree = ast.parse(file.read_text("utf-8"))
        nodes = list(ast.walk(tree))
        documents = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        for node in nodes:
            if not isinstance(node, ast.Constant) or not isinstance(node.value, str):
                continue
            if " " in node.value and id(node) not in documents:
                yield f"{file.relative_to(ROOT)}:{node.lineno}", node.value


def help_texts() -> Iterator[tuple[str, str]]:
    """(place, text) of the lines of each verb's help, as tests/snapshots keeps it."""
    for file in sorted((ROOT / "tests/snapshots/texts/help").glob("*.txt")):
        yield file.stem, file.read_text("utf-8")


def page_texts() -> Iterator[tuple[str, str]]:
    for page in PAGES:
        for number, line in enumerate(page.read_text("utf-8").splitlines(), 1):
            yield f"{page.relative_to(ROOT)}:{number}", line


@pytest.mark.parametrize("texts", [source_texts, help_texts, page_texts])
def test_no_translated_phrase_is_left(texts: object) -> None:
    found, wrong = [], re.compile("|".join(TRANSLATED))
    for place, text in texts():  # type: ignore[operator]
        if not wrong.search(text):
            continue
        for phrase, instead in TRANSLATED.items():
            for hit in re.finditer(phrase, text):
                around = text[max(0, hit.start() - 40) : hit.end() + 40].replace("\n", " ")
                found.append(f"{place}: …{around}…  ({instead})")
    assert not found, "\n".join(found)
