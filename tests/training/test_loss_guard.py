"""A loss that is no number stops a run at once and says where to go on."""

from __future__ import annotations

from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="training needs gn0[train]")

from gn0.errors import TrainingError  # noqa: E402
from gn0.training.runs.loss_guard import LossGuard, check_finite  # noqa: E402


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_step_batch_and_last_good_state_are_named(bad: float) -> None:
    guard = LossGuard(Path("run/checkpoints/step-000000100"))
    guard.watch(101, "samples 0 to 511", loss=torch.tensor(0.5), norm=torch.tensor(2.0))
    with pytest.raises(TrainingError) as caught:
        guard.watch(102, "samples 512 to 1023", loss=torch.tensor(0.5), norm=torch.tensor(bad))
    text = str(caught.value)
    assert "norm is" in text and "step 102" in text and "samples 512 to 1023" in text
    assert "step-000000100" in text


def test_numbers_pass() -> None:
    guard = LossGuard()
    for step in range(1, 10):
        guard.watch(step, "", loss=torch.tensor(1.0 / step, requires_grad=True))
    guard.settle()
    check_finite({"loss": 0.0}, step=1, batch="")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_card_is_heard_before_a_state_is_saved() -> None:
    guard = LossGuard()
    bad = torch.tensor(0.0, device="cuda").log() * 0
    with pytest.raises(TrainingError, match="step 7"):
        guard.watch(7, "b", loss=bad)
        guard.settle()
