"""Any building that can be asked for can be made, and walked through."""

from __future__ import annotations

from typing import get_args

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.kinds import KINDS, KindName, SizeName


@pytest.mark.slow
@settings(max_examples=12)
@given(st.sampled_from(list(KINDS)), st.sampled_from(get_args(SizeName)), st.integers(0, 2**62))
@example("apartment", "small", 1793248938)  # a wall as wide as its toilet, to the last bit
def test_any_seed_is_furnished_and_walkable(kind: KindName, size: SizeName, seed: int) -> None:
    draft = KINDS[kind].draft(seed, size=size, style=None)
    assert draft.objects and draft.rooms
    assert build_occupancy(draft.mesh).free_area > 10
