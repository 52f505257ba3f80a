"""Qwen's tokenizer without packages gives the ids of the package, and a policy acts by it alone."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import FormatError
from gn0.policies.bae.tokenizer_file import load_tokenizer
from gn0.policies.qwen.byte_pairs import BytePairs, read_byte_pairs
from gn0_trials.random_policy import write_random_policy, write_tokenizer

SAID = json.loads(Path(__file__).with_name("words.json").read_text("utf-8"))
PIECES = ["<0>", "<12>", "<|im_end|>", "<STOP>", "<|im", "_end|>", "go", " ", "  ", "\n", "\r",
          "\t", "'s", "'LL", "'ſ", "don't", "3", "é", "e\u0301", "\u0085", "\x1c", "\u00a0",
          "ﬁ", "the sofa", "👍🏽", "\u200d", "中文"]  # fmt: skip


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("words")
    write_tokenizer(folder)
    return folder / "tokenizer.json"


@pytest.fixture(scope="module")
def own(file: Path) -> BytePairs:
    return read_byte_pairs(file.read_bytes(), file)


def test_ids_are_those_that_the_package_gave(own: BytePairs) -> None:
    """words.json was written by `tokenizers` 0.23.3."""
    for text, ids, back in SAID:
        assert own.encode(text) == ids, text
        assert own.decode(ids) == back


@settings(max_examples=300, deadline=None)
@given(
    text=st.text(st.characters(exclude_categories=("Cs", "Cn")), max_size=60)
    | st.lists(st.sampled_from(PIECES)).map("".join)
)
def test_any_text_has_the_ids_of_the_package(own: BytePairs, file: Path, text: str) -> None:
    """Characters of a later Unicode than Python's may be cut elsewhere, so they are left out."""
    real = pytest.importorskip("tokenizers").Tokenizer.from_file(str(file))
    ids = own.encode(text)
    assert ids == real.encode(text, add_special_tokens=False).ids
    assert own.decode(ids) == real.decode(ids, skip_special_tokens=True)
    assert len(own) == real.get_vocab_size(with_added_tokens=True)


@settings(max_examples=100, deadline=None)
@given(text=st.text(max_size=80))
def test_any_text_is_written_in_bytes_and_comes_back(own: BytePairs, text: str) -> None:
    import unicodedata

    plain = text.replace("<", "")
    assert own.decode(own.encode(plain)) == unicodedata.normalize("NFC", plain)


def test_added_tokens_come_behind_all_others(file: Path) -> None:
    own = read_byte_pairs(file.read_bytes(), file)
    before = len(own)
    own.add_tokens(["<far>", "<STOP>"])
    assert len(own) == before + 1
    assert own.encode("go<far>") == [*own.encode("go"), before]
    assert own.decode([before]) == "<far>"


def _change(*keys: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(table: Any) -> None:
        for key in keys[:-1]:
            table = table[key]
        table[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_change("normalizer", value=None), "not a tokenizer"),
        (_change("normalizer", "type", value="NFKC"), "NFKC"),
        (_change("pre_tokenizer", "pretokenizers", 0, "pattern", "Regex", value=r"\w+"), "split"),
        (_change("added_tokens", 3, "lstrip", value=True), "lstrip is True"),
        (_change("model", "dropout", value=0.1), "dropout"),
        (_change("model", "merges", value=[["a"]]), "not a tokenizer"),
        (_change("model", "vocab", value=[3]), "not a tokenizer"),
    ],
)
def test_tokenizers_of_other_kinds_are_refused(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: Any, said: str
) -> None:
    monkeypatch.setitem(sys.modules, "tokenizers", None)
    table = json.loads(file.read_bytes())
    change(table)
    (tmp_path / "tokenizer.json").write_text(json.dumps(table), "utf-8")
    with pytest.raises(FormatError, match=said):
        load_tokenizer(tmp_path)


ALONE = """
from importlib.machinery import PathFinder
there = PathFinder.find_spec
absent = {"torch", "transformers", "tokenizers", "safetensors", "regex", "accelerate"}
PathFinder.find_spec = lambda name, *rest: None if name in absent else there(name, *rest)
"""


def test_a_policy_acts_with_the_core_install_alone(
    flats_suite: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the command and in its workers none of these packages can be imported."""
    (tmp_path / "sitecustomize.py").write_text(ALONE, "utf-8")
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    absent = subprocess.run([sys.executable, "-c", "import tokenizers"], capture_output=True)
    assert absent.returncode == 1
    policy = write_random_policy(tmp_path / "policy")
    command = [sys.executable, "-m", "gn0", "bench", "run", str(flats_suite.folder), "--policy",
               "bae", "--policy-option", f"checkpoint={policy}", "--episodes", "1", "--no-report",
               "--out", str(tmp_path / "run")]  # fmt: skip
    said = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert said.returncode == 0, said.stderr
    assert len((tmp_path / "run" / "results.jsonl").read_text().splitlines()) == 1
