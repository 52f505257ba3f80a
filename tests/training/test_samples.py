"""Batches for a model hold what the codec writes, whatever the device."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.data.codec import EgoFrame, decode_waypoints, encode_heading, encode_waypoints

torch = pytest.importorskip("torch")
samples = pytest.importorskip("gn0.training.samples")

FRAME = EgoFrame(128, 0.06, 0.65)


@given(st.integers(0, 2**32 - 1))
def test_coordinates_and_headings_are_the_codecs(seed: int) -> None:
    stream = np.random.default_rng(seed)
    way = stream.uniform(-6, 6, (20, 13, 2)).astype(np.float32)
    tokens = encode_waypoints(FRAME, way, np.zeros((20, 3)))
    got = samples.encode_squares(FRAME, torch.from_numpy(way))
    assert np.array_equal(got.numpy(), tokens)
    back = decode_waypoints(FRAME, tokens, np.zeros((20, 3)))
    assert np.array_equal(samples.decode_squares(FRAME, got).numpy(), back)
    yaw = np.concatenate([stream.uniform(-7, 7, 50), np.arange(24) * np.pi / 12])
    assert samples.encode_headings(torch.from_numpy(yaw)).tolist() == [*map(encode_heading, yaw)]
