"""Codes of people: many are posed to the bit as each alone, by any number of threads."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from gn0.avatars.avatar import SHADOWS
from gn0.avatars.coded_poses import PosesOneByOne
from gn0.avatars.detail import SHARES
from gn0.avatars.posed_device import rest_of
from gn0.device.host import DeviceHost
from gn0.errors import ConfigError
from gn0.people import shown_codes
from gn0.people.cast import Cast
from gn0.people.shown_codes import _BITS, ShownCodes
from gn0.render.cuda.posed import bring_rest, row_width

# role, level, clip, frame, gait, look, other, other frame, quarter, early, stood
_LOOKS = (
    (0, 0, "walk", 17, 2, 2, "", 0, 0, 0, 0),
    (1, 3, "walk", 63, 4, 0, "", 0, 0, 0, 0),
    (0, 1, "walk", 3, 1, 4, "idle_2", 12, 1, 0, 20),
    (1, 1, "walk", 60, 3, 2, "pivot_left", 41, 2, 1, 63),
    (0, 0, "idle_1", 24, 2, 2, "walk", 33, 3, 1, 48),
    (1, 0, "pivot_right", 30, 2, 1, "walk", 5, 2, 0, 48),
    (0, 2, "settle_left", 301, 2, 2, "walk", 8, 1, 1, 40),
    (1, 2, "settle_right", 77, 2, 3, "", 0, 0, 0, 0),
    (0, 3, "wave", 30, 2, 2, "", 0, 0, 0, 0),
    (2, 4, "sit", 48, 2, 2, "", 0, 0, 0, 0),
    (1, 0, "hold", 12, 2, 2, "", 0, 0, 0, 0),
)


@pytest.fixture(scope="module")
def shown() -> ShownCodes:
    codes = ShownCodes(Cast())
    assert [codes.role(*one) for one in (("drawn:5:0", 0.45), ("drawn:5:1", 0.45))] == [0, 1]
    assert codes.role("drawn:5:0", 0.5) == 2 and codes.role("drawn:5:1", 0.45) == 1
    return codes


@pytest.fixture(scope="module")
def many(shown: ShownCodes) -> np.ndarray:
    found = []
    for look in _LOOKS:
        code = 0
        for value, bits in zip(reversed(look), reversed(_BITS), strict=True):
            number = (63 if not value else shown.clip(value)) if isinstance(value, str) else value
            code = code << bits | number
        found.append(code + 1)
    return np.array(found, np.uint64)


def ready(poses: PosesOneByOne | ShownCodes, codes: np.ndarray) -> tuple[np.ndarray, ...]:
    device = DeviceHost()
    _, which = poses.rests(codes)
    _, first = np.unique(which, return_index=True)
    rests = [bring_rest(device, rest_of(poses.avatar(int(code)))) for code in codes[first]]
    rows = np.zeros((len(codes) + 1, row_width(SHADOWS)), np.float32)
    boxes, steps = poses.ready(codes, rests, which, rows, np.arange(len(codes)) + 1)
    assert not rows[0].any()
    return rows[1:], boxes, steps


def test_codes_say_who_is_shown_how(shown: ShownCodes, many: np.ndarray) -> None:
    for look, code in zip(_LOOKS, many.tolist(), strict=True):
        found = shown.read(code)
        role, level, clip, frame, gait, aside, other, other_frame, quarter, early, stood = look
        assert found.actor.name == ("drawn:5:1" if role == 1 else "drawn:5:0")
        assert found.level == level and found.shown.seat == (0.5 if role == 2 else 0.45)
        assert found.shown[:7] == (clip, frame, other, other_frame, quarter or 4, gait, aside)
        assert found.shown[8:] == (early, stood - 48 if other else 0)
    keys, which = shown.rests(many)
    assert [keys[n] for n in which] == [shown.read(code).rest_key for code in many.tolist()]


def test_many_are_posed_to_the_bit_as_each_alone(
    shown: ShownCodes, many: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    want = ready(shown, many)
    assert len(np.unique(want[0], axis=0)) == len(many)
    for got in (ready(PosesOneByOne(shown.read), many), [np.concatenate(one) for one in zip(
        *(ready(shown, many[n : n + 1]) for n in range(len(many))), strict=True
    )]):  # fmt: skip
        for one, other in zip(got, want, strict=True):
            assert one.tobytes() == other.tobytes()
    monkeypatch.setattr(shown_codes, "_TOGETHER", 4)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(min(2, numba.config.NUMBA_NUM_THREADS))
        parts = ready(shown, many)
    finally:
        numba.set_num_threads(threads)
    assert all(one.tobytes() == other.tobytes() for one, other in zip(parts, want, strict=True))


def test_levels_of_detail_share_postures(shown: ShownCodes, many: np.ndarray) -> None:
    one = int(many[2]) - 1
    assert sum(_BITS) == 64 and len(SHARES) <= 1 << _BITS[1]
    codes = np.array(
        [1 + (one & ~(7 << 15) | level << 15) for level in range(len(SHARES))], np.uint64
    )
    assert [shown.read(int(code)).level for code in codes] == list(range(len(SHARES)))
    assert len(set(shown.postures(codes).tolist())) == 1
    assert len(set(shown.postures(many).tolist())) == len(many) and shown.postures(many).all()
    rows = ready(shown, codes)[0]
    assert (rows == rows[0]).all()


def test_more_roles_than_a_code_holds_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """And those who have a number keep it."""
    codes = ShownCodes(Cast())
    assert shown_codes._ROLES == 2**15
    monkeypatch.setattr(shown_codes, "_ROLES", 2)
    assert [codes.role("drawn:5:0", seat) for seat in (0.45, 0.5)] == [0, 1]
    for _ in range(2):
        with pytest.raises(ConfigError, match=r"more than 2 people .* seat"):
            codes.role("drawn:5:1", 0.45)
    assert codes.role("drawn:5:0", 0.5) == 1 and len(codes._whom) == 2
