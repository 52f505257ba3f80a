"""A call that comes again is replayed: the bytes of a renderer that never drew before."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.replay import PicturesDevice, Replay
from gn0.render.visible_places import VisibleOptions
from gn0_figures.device_scenes import flat_scene
from gn0_figures.flat import flat_bev, flat_camera

TURNS = 5


def _bytes(pictures: PicturesDevice) -> list[bytes]:
    got = pictures.numpy()
    return [a.tobytes() for a in (got.rgb, got.depth, got.alpha) if a is not None]


@pytest.mark.small
@pytest.mark.parametrize("kind", ["one view", "16 views", "from above", "visible sets"])
def test_a_repeated_call_equals_a_fresh_one(
    device: Any, scale: Any, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = flat_scene(min(scale.splats, 20_000))  # checkers of races take a thousand times as long
    camera, count = flat_camera(scale.pixels, scale.pixels), {"16 views": 16, "visible sets": 2}
    full = device.kind == "cuda"
    turns = TURNS if full else 3  # the emulation has tests/render/cuda/test_again.py besides
    views = scene.views(turns * count.get(kind, 1), 3).reshape(turns, -1, 4, 4)
    if kind == "from above":
        camera, view = flat_bev(scale.bev)
        views = np.tile(view.reshape(1, 1, 4, 4), (turns, 1, 1, 1))
        views[:, 0, 0, 3] += 0.1 * np.arange(turns)  # m
    options = (
        VisibleOptions(places=2, pixels=160)
        if full
        else VisibleOptions(cell=2.0, places=1, pixels=24)
    )

    def make(known: np.ndarray) -> Callable[[np.ndarray], PicturesDevice]:
        batch = RendererBatch(device)
        batch.add("flat", lambda: scene.cloud, "flat")
        visible = kind == "visible sets"
        if visible:
            sets = batch.limit_to_visible(
                "flat", "flat", scene.floor, scene.eye, options, cache=False
            )
            seen = sets.locate(camera, known.reshape(-1, 4, 4))
            sets.open([cell for cell in seen if cell is not None], batch.store.open("flat"))
        return lambda some: batch.draw(camera, some, "flat", visible=visible)

    replayed, works = [], Replay.draw

    def draw(self: Replay, *args: Any, **named: Any) -> Any:
        found = works(self, *args, **named)
        replayed.append(found is not None)
        return found

    monkeypatch.setattr(Replay, "draw", draw)
    want = [
        _bytes(make(some)(some)) for some in views
    ]  # first: buffers, which all share, grow here
    assert not replayed
    again = make(views)
    for turn, some in enumerate(views):
        assert _bytes(again(some)) == want[turn], turn
    assert sum(replayed) == turns - 2
