"""Checkpoints of random weights, small enough for a CPU."""

from __future__ import annotations

from pathlib import Path

import pytest

from gn0.data.answer_form import AnswerForm
from gn0.policies.bae.policy_settings import PolicySettings, save_policy_settings
from gn0.sim.ego_map import EgoSquare, MapView

VIEW = MapView(squares=(EgoSquare(32, 0.24), EgoSquare(32, 0.6)))
SETTINGS = PolicySettings(
    prompt="short",
    pictures=("near", "far"),
    form=AnswerForm(layout="compact"),
    view=VIEW,
    text_length=64,
)


def _write(folder: Path, settings: PolicySettings, size: str, seed: int, spread: float) -> Path:
    torch = pytest.importorskip("torch", reason="the policy's model needs gn0[train]")
    pytest.importorskip("transformers", reason="the policy's model needs gn0[train]")
    from gn0.policies.bae.checkpoint import Checkpoint, save_checkpoint
    from gn0.policies.bae.sizes import build_model
    from gn0.policies.bae.tokenizer import read_token_ids, train_tokenizer

    torch.set_num_threads(1)
    words = train_tokenizer(["go to the sofa", "Go to the place at 3.2 m.", "PLANNING at"], 300)
    ids = read_token_ids(words)
    model = build_model(size, ids, seed)
    if spread:
        with torch.no_grad(), torch.random.fork_rng(devices=[]):  # of some size, as if trained
            torch.manual_seed(seed)
            for weight in model.parameters():
                weight.add_(spread * torch.randn_like(weight))
    save_checkpoint(folder, Checkpoint(model, words, ids), dtype=torch.float32)
    save_policy_settings(folder, settings)
    return folder


@pytest.fixture(scope="session")
def write_checkpoint():
    """Writes a checkpoint of random weights: folder, settings, size, seed, spread of weights."""
    return _write


@pytest.fixture(scope="session")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint of size nano that is shown two small ego maps."""
    return _write(tmp_path_factory.mktemp("bae") / "checkpoint", SETTINGS, "nano", 5, 0.08)
