"""Recurrent baselines of random weights, small enough for a CPU."""

from __future__ import annotations

from pathlib import Path

import pytest

TEXTS = ["Walk to the sofa and stop.", "Go to the place at 3.2 m.", "Leave the room; turn left."]


def _scatter(net, seed: int, spread: float) -> None:
    """Let actions hang on what differs from state to state, as if the net were trained."""
    import torch

    found = []
    hook = net.choose.register_forward_pre_hook(lambda _, given: found.append(given[0]))
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        net.actions.weight.mul_(0.1)  # else it does for ever what it did first
        words = net.read(torch.zeros((120, 9), dtype=torch.int64), torch.full((120,), 9))
        shown = [torch.randint(0, 256, (120, *shape)).to(torch.uint8)
                 for shape in net.settings.shapes.values()]  # fmt: skip
        net(words, net.see(shown), torch.randint(0, 4, (30, 4)), net.begin(4))
        states = found[0][10:].flatten(0, 1)
        _, sizes, ways = torch.linalg.svd(states - states.mean(0), full_matrices=False)
        weight = torch.randn(4, 8) @ (ways[:8] / sizes[:8, None]) * spread * 8
        net.choose.weight.copy_(weight)
        net.choose.bias.copy_(torch.tensor([-2.0, 0.5, 0.0, 0.0]) - weight @ states.mean(0))
    hook.remove()


def _write(folder: Path, seed: int = 5, spread: float = 0.0, **chosen) -> Path:
    pytest.importorskip("torch", reason="recurrent baselines need gn0[train]")
    pytest.importorskip("transformers", reason="tokenizers are trained with gn0[train]")
    from gn0.policies.bae.tokenizer import train_tokenizer
    from gn0.policies.cma.cma_checkpoint import CmaCheckpoint, build_net, save_cma_checkpoint
    from gn0.policies.cma.cma_settings import SIZES, CmaSettings

    words = train_tokenizer(TEXTS, 60).backend_tokenizer
    own = {"sizes": SIZES["nano"], "text_length": 40, "vocabulary": words.get_vocab_size()}
    net = build_net(CmaSettings(**(own | chosen)), seed)
    if spread:
        _scatter(net, seed, spread)
    save_cma_checkpoint(folder, CmaCheckpoint(net, words.to_str().encode()))
    return folder


@pytest.fixture(scope="session")
def write_cma():
    """Writes a checkpoint of random weights: folder, seed, spread, fields of its settings."""
    return _write


@pytest.fixture(scope="session")
def near_checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A CMA that is shown the near map alone."""
    folder = tmp_path_factory.mktemp("cma") / "checkpoint"
    return _write(folder, spread=2.0, pictures=("near",))
