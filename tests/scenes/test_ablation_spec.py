"""The homes and missions of the ablation are what its issue and its page promise."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from gn0.missions.generate.settings import load_settings
from gn0.scenes.corpus import held_out_forms, load_spec, plan_corpus
from gn0.scenes.procedural.forms import list_forms

FOLDER = Path(__file__).parents[2] / "runs" / "ablation"


@pytest.mark.parametrize(("name", "train", "unseen"), [("corpus", 400, 100), ("corpus_tiny", 4, 2)])
def test_its_homes(name: str, train: int, unseen: int) -> None:
    spec = load_spec(FOLDER / f"{name}.yaml")
    plan = plan_corpus(spec)
    count = Counter(scene.split for scene, _, _ in plan)
    assert count["train"] >= train and count["val_unseen"] >= unseen
    assert all(scene.val_seen for scene, _, _ in plan if scene.split == "train")
    assert {part.kind for _, part, _ in plan} <= {"apartment", "residence"}
    styles = {
        split: {scene.style for scene, _, _ in plan if scene.split == split} for split in count
    }
    assert len(set(spec.held_out.styles if spec.held_out else ())) >= 2
    assert not styles["train"] & styles["val_unseen"]
    assert len(held_out_forms(spec)) >= 0.10 * len(list_forms())
    assert len({seed for _, _, seed in plan}) == len(plan)


def test_its_missions() -> None:
    settings = load_settings(FOLDER / "missions.yaml")
    assert settings.missions == ("goal", "instruction")
    assert settings.styles == ("detailed", "benchmark")
    assert settings.minimum_length >= 4.0
    assert settings.lights == 3
    assert settings.phrasings == "by_split"
    episodes = settings.per_scene * (1 + len(settings.styles))
    assert 20 <= episodes <= 40
    assert 100 * episodes >= 2000, "as many are paired in each table"
    assert 400 * episodes * settings.val_seen >= 2000
