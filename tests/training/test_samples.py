"""Batches for a model hold what the codec writes, whatever the device."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.data.codec import EgoFrame, decode_waypoints, encode_heading, encode_waypoints
from gn0.sim.sensors import MapFrame

torch = pytest.importorskip("torch")
samples = pytest.importorskip("gn0.training.streams.samples")

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


@given(st.integers(0, 2**32 - 1))
def test_coordinates_on_whole_maps_are_the_codecs(seed: int) -> None:
    stream = np.random.default_rng(seed)
    count = 12
    frames = [
        MapFrame(int(w), int(h), float(scale), float(x), float(y))
        for w, h, scale, x, y in zip(
            stream.integers(1, 900, count), stream.integers(1, 900, count),
            stream.choice([0.05, 0.1, 0.025, 0.03], count), *stream.uniform(-9, 9, (2, count)),
            strict=True,
        )
    ]  # fmt: skip
    maps = torch.tensor(
        [(f.width, f.height, f.metres_per_pixel, f.x_min, f.y_min) for f in frames],
        dtype=torch.float64,
    )
    way = stream.uniform(-6, 6, (count, 13, 2)).astype(np.float32)
    pose = stream.uniform(-20, 20, (count, 3))
    pose[::2, 2] = np.arange(0, count, 2) * np.pi / 12
    got = samples.encode_maps(maps, torch.from_numpy(way), torch.from_numpy(pose))
    back = samples.decode_maps(maps, got, torch.from_numpy(pose))
    for k, frame in enumerate(frames):
        tokens = encode_waypoints(frame, way[k : k + 1], pose[k : k + 1])
        assert np.array_equal(got[k].numpy(), tokens[0])
        exact = decode_waypoints(frame, tokens, pose[k : k + 1])[0]
        assert np.array_equal(back[k].numpy(), exact)
