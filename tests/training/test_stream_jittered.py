"""Jitter on the device: NumPy's bytes, by sample number, and black stays black."""

from __future__ import annotations

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gn0.errors import FormatError  # noqa: E402
from gn0.training.streams.picture_jitter import PictureJitter  # noqa: E402
from gn0.training.streams.stream_jittered import (  # noqa: E402
    StreamJittered,
    jitter_pictures,
)


class Numbered:
    """States that hang on their number alone, with a view, a mosaic and a map."""

    texts = ("", "", "")

    def __init__(self, draw) -> None:
        self._all, self.drawn = draw(12), 0
        views = np.random.default_rng(0).integers(0, 256, (12, 6, 8, 3), np.uint8)
        self._all.pictures["rgb"] = torch.from_numpy(views)
        self._all.pictures["history"] = torch.from_numpy(views[::-1].copy())
        self._all.pictures["history"][3] = 0

    def draw(self, count: int):
        self.drawn += count
        return self._all.pick(slice(self.drawn - count, self.drawn))

    def state(self):
        return {"drawn": self.drawn}

    def restore(self, state) -> None:
        self.drawn = state["drawn"]


def test_the_bytes_are_those_of_one_picture_in_numpy() -> None:
    stream = np.random.default_rng(1)
    pictures = stream.integers(0, 256, (5, 9, 7, 3), np.uint8)
    draws, jitter = stream.random((5, 6)), PictureJitter()
    got = jitter_pictures(torch.from_numpy(pictures), *jitter.solve(draws))
    for one, picture, own in zip(got, pictures, draws, strict=True):
        assert (one.numpy() == jitter.apply(picture, own)).all()
    still = jitter_pictures(torch.from_numpy(pictures), *jitter.solve(np.full((5, 6), 0.5)))
    assert (still.numpy() == pictures).all()


def test_jitter_hangs_on_the_samples_number_whatever_the_batches(draw_states) -> None:
    whole = StreamJittered(Numbered(draw_states), PictureJitter(), 7).draw(12)
    plain = Numbered(draw_states).draw(12)
    parts = StreamJittered(Numbered(draw_states), PictureJitter(), 7)
    first = parts.draw(5)
    kept = json.loads(json.dumps(parts.state()))
    rest = parts.draw(7)
    parts.restore(kept)
    again = parts.draw(7)
    for name, pictures in whole.pictures.items():
        assert torch.equal(torch.cat([first.pictures[name], rest.pictures[name]]), pictures)
        assert torch.equal(again.pictures[name], rest.pictures[name])
    assert torch.equal(whole.pictures["near"], plain.pictures["near"])
    assert not whole.pictures["history"][3].any()
    changed = (whole.pictures["rgb"] != plain.pictures["rgb"]).flatten(1).any(1)
    assert changed.all()
    other = StreamJittered(Numbered(draw_states), PictureJitter(), 8).draw(12)
    assert not torch.equal(other.pictures["rgb"], whole.pictures["rgb"])
    with pytest.raises(FormatError):
        parts.restore({"drawn": -1})
