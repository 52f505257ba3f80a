"""`gn0 scene corpus` and `gn0 scene light` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gn0.cli.main import main
from gn0.scenes.folder import load_scene, save_scene
from gn0.testing.scenes import build_room_scene


@pytest.fixture(scope="module")
def flat(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("verbs") / "flat"
    save_scene(build_room_scene(), folder)
    return folder


def test_a_corpus_is_made_listed_and_drawn(
    flat: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GN0_DATA", str(flat.parent))
    (tmp_path / "spec.yaml").write_text(
        "name: pair\nparts:\n"
        "  - {path: $GN0_DATA/flat, name: one}\n"
        "  - {path: $GN0_DATA/flat, name: two, split: test}\n"
    )
    out = tmp_path / "corpus"
    assert main(["scene", "corpus", "--spec", str(tmp_path / "spec.yaml"), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "one" in said and "two" in said and "gn0 missions generate" in said
    about = json.loads((out / "corpus.json").read_text())
    assert {s["id"]: s["split"] for s in about["scenes"]} == {"one": "train", "two": "test"}
    with Image.open(out / "corpus.jpg") as sheet:
        assert sheet.width == 1920


def test_a_scene_is_drawn_in_many_lights_and_written_in_one(
    flat: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheet = tmp_path / "lights.jpg"
    assert main(["scene", "light", str(flat), "--count", "2", "--out", str(sheet)]) == 0
    assert sheet.is_file()
    dusk = tmp_path / "flat-dusk"
    words = ["scene", "light", str(flat), "--mood", "dusk", "--out", str(sheet)]
    assert main([*words, "--write", str(dusk)]) == 0
    assert "flat-dusk" in capsys.readouterr().out
    before, after = load_scene(flat), load_scene(dusk)
    assert after.id == "flat-dusk" and after.content_hash != before.content_hash
    assert after.grid.content_hash == before.grid.content_hash
    assert np.array_equal(after.gaussians.means, before.gaussians.means)
    assert after.gaussians.rgb().mean() < before.gaussians.rgb().mean()
    assert main([*words, "--write", str(dusk)]) == 2  # it is there, and --overwrite was not said
    assert "--overwrite" in capsys.readouterr().err


def test_one_mood_is_drawn_as_often_as_asked(
    flat: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sheet, drawn = tmp_path / "dusk.png", []
    for count in ([], ["--count", "4"]):
        words = ["scene", "light", str(flat), "--mood", "dusk", *count, "--out", str(sheet)]
        assert main(words) == 0
        with Image.open(sheet) as image:
            drawn.append(np.asarray(image.convert("L"), np.float64))
    one, four = drawn  # under the scene as it was made
    assert one.shape[1] == four.shape[1] and 2 * one.shape[0] < four.shape[0]
    bands = np.array_split(four, 5)
    tones = [band[:, band.shape[1] // 2 :].mean() for band in bands]
    assert max(tones[1:]) < tones[0] and len(set(np.round(tones[1:], 1))) == 4, "each anew"
    custom = ["scene", "light", str(flat), "--mood", "custom", "--count", "3"]
    assert main(custom) == 2 and "--count" in capsys.readouterr().err


def test_a_light_out_of_range_is_refused(flat: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", "light", str(flat), "--mood", "custom", "--exposure", "40"]) == 2
    assert "exposure" in capsys.readouterr().err
