"""What the figure of the model does on a card with 4B is tried on a CPU with a small one."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")
pytest.importorskip("peft")

from gn0.policies.bae.sizes import build_model
from gn0.policies.qwen.layout import PictureSize
from gn0_figures import bae


def test_a_step_of_both_kinds_by_adapters() -> None:
    small = bae.Large(
        lambda: build_model("nano", bae.IDS), (PictureSize(32, 32),) * 2, 8, 4, 33, "cpu"
    )
    found = list(bae.learn_by_adapters(small))
    assert [name for name, *_ in found] == ["SFT", "a policy gradient"]
    assert all(seconds > 0 and math.isfinite(seconds) for _, seconds, *_ in found)
    assert len({weights for *_, weights in found}) == 1
