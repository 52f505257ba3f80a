"""TRACKING samples are trained on and answered like all others: seven points, six actions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gn0.cli.main import main
from gn0.data.build import build_dataset
from gn0.data.dataset import Dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0_trials.people_samples import follow_episode, save_bank, save_some

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Dataset:
    root = tmp_path_factory.mktemp("tracking")
    bank = save_bank(root / "bank")
    suite = save_some(root / "suite", follow_episode())
    settings = BuildSettings(pictures=PictureSettings(format="png"))
    return build_dataset(suite, root / "data", settings, bank=bank)


@pytest.mark.slow
@pytest.mark.parametrize("prompt", ["paper_following", "paper_following_views"])
def test_a_few_steps_on_the_cpu(prompt: str, data: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(
        ["train", "sft", str(data.folder), "--source", "dataset", "--split", "all",
         "--held-out", "", "--size", "nano", "--batch", "4", "--prompt", prompt, "--samples", "8",
         "--map-size", "32,32", "--report", "1", "--save", "1", "--device", "host",
         "--out", str(out)]
    ) == 0  # fmt: skip
    losses = [json.loads(line)["loss"] for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert len(losses) == 2 and np.isfinite(losses).all()
    policy = json.loads((out / "policy" / "policy.json").read_text())
    assert policy["form"].get("points", 13) == (7 if prompt == "paper_following" else 0)


def test_the_reader_gives_what_the_rows_say_and_a_black_history(data: Dataset) -> None:
    from gn0.training.streams.sample_order import Rows
    from gn0.training.streams.sample_reader import PictureWish, SampleReader

    reader = SampleReader(data, PictureWish(("rgb", "history")))
    out = {name: np.zeros((3, *shape), kind) for name, (shape, kind) in reader.layout.items()}
    where = np.array([0, 4, 11])
    reader.read(Rows(where, np.zeros(3, np.int64), np.arange(3)), out)
    rows = data.rows("c-follow")
    assert np.array_equal(out["actions"], rows.actions[where])
    assert np.array_equal(out["waypoints"], rows.waypoints[where])
    assert out["rgb"].std() > 10 and not out["history"].any()
