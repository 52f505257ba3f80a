"""`gn0 train tokenizer` writes what stock transformers reads, and says how long texts become."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gn0.cli.main import main
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.suites.suite import load_suite, save_suite

pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")


@pytest.fixture(scope="module")
def suite(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("suite")
    save_scene(build_example_scene(), root / "flat")
    scene = load_scene(root / "flat")
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 6, 0)
    return save_suite(root / "suite", [scene], episodes, name="words").folder


def test_it_is_loaded_by_stock_transformers(suite: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "words"
    assert main(["train", "tokenizer", str(suite), "--out", str(out), "--merges", "200"]) == 0
    said = capsys.readouterr().out
    stock = transformers.AutoTokenizer.from_pretrained(out)
    texts = [e.instruction for e in load_suite(suite).episodes]
    counts = [len(stock(text).input_ids) for text in texts]
    mean, most = re.search(r"different: ([\d.]+) tokens.* the longest (\d+);", said).groups()  # type: ignore[union-attr]
    assert float(mean) == pytest.approx(sum(counts) / len(counts), abs=0.05)
    assert int(most) == max(counts)
    assert stock.decode(stock(texts[0]).input_ids) == texts[0]
    first = stock.convert_tokens_to_ids("<0>")
    assert f"from {first:,} on" in said
    assert stock("<12><999><STOP>").input_ids[:2] == [first + 12, first + 999]
    chat = [{"role": "user", "content": [{"type": "image"}, {"type": "text", "text": "go"}]}]
    assert stock.apply_chat_template(chat, tokenize=False).endswith("go<|im_end|>\n")
    assert "short" in said and "paper_planning" in said


def test_the_same_texts_give_the_same_files(suite: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        told = [str(suite)] * (2 if name == "two" else 1)
        assert main(["train", "tokenizer", *told, "--out", str(tmp_path / name)]) == 0
    one, two = ({p.name: p.read_bytes() for p in (tmp_path / n).iterdir()} for n in ("one", "two"))
    assert one == two and "tokenizer.json" in one


def test_faults_are_named(suite: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "words"
    for told, text in (
        ([str(tmp_path), "--out", str(out)], "suite.json"),
        (["--out", str(out)], "no source|required"),
        ([str(suite), "--out", str(suite)], "not empty"),
        ([str(suite), "--out", str(suite), "--overwrite"], "no tokenizer.json"),
        ([str(suite), "--out", str(out), "--merges", "-1"], "--merges"),
    ):
        try:
            code = main(["train", "tokenizer", *told])
        except SystemExit as error:
            code = int(error.code or 0)
        assert code == 2
        assert re.search(text, capsys.readouterr().err), text
    assert not out.exists()


def test_missing_packages_are_named_with_the_extra(
    suite: Path, tmp_path: Path, capsys, monkeypatch
) -> None:
    from gn0.cli import train_packages

    monkeypatch.setattr(train_packages, "NEEDED", ("torch", "no_such_package"))
    assert main(["train", "tokenizer", str(suite), "--out", str(tmp_path / "words")]) == 2
    said = capsys.readouterr().err
    assert "not here: no_such_package" in said and "pip install -e '.[train]'" in said
