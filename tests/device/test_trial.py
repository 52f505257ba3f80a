"""The trial of a card passes where all is well, and names what is not."""

from __future__ import annotations

import os
import re
from typing import Any

import pytest

from gn0.device.driver import DeviceCuda
from gn0.device.trial import try_card

TURNS = 5


def test_nothing_is_wrong(orderly: DeviceCuda) -> None:
    assert try_card(orderly, TURNS) == []


@pytest.mark.parametrize(
    ("call", "code", "expected"),
    [
        (b"cuFuncSetAttribute", 1, r"shared memory: .*49152 bytes of dynamic shared memory"),
        (b"cuStreamBeginCapture_v2", 900, r"recordings: .*BeginCapture.*900"),
        (b"cuStreamCreate", 801, r"order: .*StreamCreate"),
        (b"cuModuleLoadDataEx", 218, r"kernels: .*218"),
    ],
)
def test_what_fails_is_named(
    orderly: DeviceCuda, fake: Any, call: bytes, code: int, expected: str
) -> None:
    fake.fake_fail(call, code, 0)
    wrong = try_card(orderly, TURNS)
    assert re.search(expected, wrong[0]) and orderly.lost is None


def test_a_lost_card_ends_it(orderly: DeviceCuda, fake: Any) -> None:
    fake.fake_fail(b"cuLaunchKernel", 719, 0)
    wrong = try_card(orderly, TURNS)
    assert len(wrong) == 1 and "719" in wrong[0] and orderly.lost


def test_another_result_is_seen(orderly: DeviceCuda) -> None:
    os.environ["FAKE_CUDA_NO_FILL"] = "1"  # the C library reads its own copy
    try:
        wrong = try_card(orderly, TURNS)
    finally:
        del os.environ["FAKE_CUDA_NO_FILL"]
    assert wrong[0].startswith("copies: fill: ") and "for 117901063" in wrong[0]
