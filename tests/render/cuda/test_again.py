"""Calls that come again: each gives the bytes that a renderer gives which never drew before."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_above, view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.calls import CALLS
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.replay import PicturesDevice, Replay
from gn0.render.renderer import RenderOptions
from gn0.render.visible_places import VisibleOptions
from gn0.testing.renderer_check import random_cloud

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

CAMERA = Camera.from_hfov(24, 18, 90)
ABOVE = Camera.orthographic(20, 20, 0.3)
SPLATS = 150
EYE = 0.2
CELL = 0.5  # m
NOTHING = random_cloud(0, seed=1)  # a tail that makes the host arrange the call
QUICK = VisibleOptions(cell=CELL, places=1, pixels=24, threshold=0.3)  # few splats: it shows


def cloud_of(seed: int) -> GaussianCloud:
    return random_cloud(SPLATS, seed=seed)


def floor_of() -> OccupancyGrid:
    """One metre by one metre of free floor round the origin: four cells of sets."""
    cells = np.ones((60, 60), np.uint8)
    cells[20:40, 20:40] = 0
    return OccupancyGrid(cells, 0.05, (-1.5, -1.5))


def batch_of(
    memory: int | None = None,
    options: RenderOptions | None = None,
    *,
    sets: str = "",
) -> RendererBatch:
    """Three scenes, some with visible sets."""
    batch = RendererBatch(DeviceHost(), options, memory)
    for key in "abc":
        batch.add(key, lambda key=key: cloud_of(ord(key)), f"hash of {key}")
    for key in sets:
        batch.limit_to_visible(key, key, floor_of(), EYE, QUICK, cache=False)
    return batch


def bring_sets(batch: RendererBatch) -> None:
    for key, sets in batch._sets.items():
        sets.open(sets.cells, batch.store.open(key))


def poses(turn: int, count: int = 5) -> np.ndarray:
    """Other views each turn, round the middle; seen from all four cells that have sets."""
    angles = 0.7 * turn + np.arange(count)
    return np.stack(
        [view_from_pose(0.4 * np.cos(a), 0.4 * np.sin(a), EYE, 1.3 * a) for a in angles]
    )


def above(turn: int) -> np.ndarray:
    return np.stack([view_from_above(0.1 * turn, 0.2 * k, 3.0) for k in range(3)])


def bytes_of(pictures: PicturesDevice) -> list[bytes | None]:
    got = pictures.numpy()
    return [None if a is None else a.tobytes() for a in (got.rgb, got.depth, got.alpha)]


def fresh(*args: Any, sets: str = "", options: RenderOptions | None = None, **named: Any) -> Any:
    """What a renderer draws that drew nothing before."""
    return bytes_of(batch_of(options=options, sets=sets).draw(*args, **named))


def settle(batch: RendererBatch, replays: list[Replay], *draws: Callable[[int], object]) -> None:
    """Draw once what will be drawn, so that lists have room from now on; remember no call."""
    for turn in range(5):
        for draw in draws:
            draw(turn)
    batch._held.forget_calls()
    replays.clear()


KINDS: dict[str, tuple[Camera, Callable[[int], np.ndarray], Any, dict[str, Any]]] = {
    "one view": (CAMERA, lambda t: poses(t)[0], "a", {}),
    "one of one": (CAMERA, lambda t: poses(t)[:1], "a", {}),
    "many": (CAMERA, poses, "a", {}),
    "float32": (CAMERA, lambda t: poses(t).astype(np.float32), "a", {}),
    "one float32": (CAMERA, lambda t: poses(t)[0].astype(np.float32), "b", {}),
    "every other": (CAMERA, lambda t: poses(t, 8)[::2], "a", {}),
    "several scenes": (CAMERA, poses, list("cabac"), {}),
    "one key each": (CAMERA, poses, list("bbbbb"), {}),
    "depth": (CAMERA, poses, "a", {"outputs": ("depth",)}),
    "without depth": (CAMERA, poses, "a", {"outputs": ("alpha", "rgb")}),
    "background": (CAMERA, poses, "a", {"background": (0.2, 0.9, 0.4)}),
    "from above": (ABOVE, above, "b", {"outputs": ("rgb",)}),
    "from above, with sets": (ABOVE, above, "a", {"visible": True}),
    "sets": (CAMERA, poses, "a", {"visible": True}),
    "sets of one view": (CAMERA, lambda t: poses(t)[1], "a", {"visible": True}),
    "sets of some": (CAMERA, poses, list("cabac"), {"visible": True}),
    "no sets": (CAMERA, poses, "b", {"visible": True}),
}


@pytest.mark.parametrize("kind", KINDS)
def test_each_is_what_it_is_alone(kind: str, replays: list[Replay]) -> None:
    """And pictures of an earlier call stay as they are."""
    camera, views, keys, named = KINDS[kind]
    sets = "ac" if "visible" in named else ""
    batch = batch_of(sets=sets)
    bring_sets(batch)
    settle(batch, replays, lambda turn: batch.draw(camera, views(turn), keys, **named))
    drawn = []
    for turn in range(4):
        pictures = batch.draw(camera, views(turn), keys, **named)
        want = fresh(camera, views(turn), keys, sets=sets, **named)
        assert bytes_of(pictures) == want, turn
        drawn.append((pictures, want))
    assert len(replays) == 2, "the first was noted, the second recorded"
    for pictures, want in drawn:
        assert bytes_of(pictures) == want
    assert len({tuple(want) for _, want in drawn}) == 4, "poses do matter"


def test_with_sets_for_this_call_alone(replays: list[Replay]) -> None:
    batch, other = batch_of(sets="a"), batch_of(sets="a")
    bring_sets(batch)
    sets, theirs = batch._sets.pop("a"), other._sets.pop("a")
    settle(batch, replays, lambda turn: batch.draw(CAMERA, poses(turn), "a", visible=sets))
    for turn in range(4):
        got = bytes_of(batch.draw(CAMERA, poses(turn), "a", visible=sets))
        want = other.draw(CAMERA, poses(turn), "a", visible=theirs, tails=NOTHING)
        assert got == bytes_of(want), turn
        assert got != bytes_of(other.draw(CAMERA, poses(turn), "a", tails=NOTHING))
    assert len(replays) == 2


def test_with_and_without_sets_in_turns(replays: list[Replay]) -> None:
    batch, other = batch_of(sets="a"), batch_of(sets="a")
    bring_sets(batch)
    few = other._sets["a"]
    wanted = (False, True, batch._sets["a"], None)

    def draw(turn: int) -> list[list[bytes | None]]:
        return [bytes_of(batch.draw(CAMERA, poses(turn), "a", visible=v)) for v in wanted]

    settle(batch, replays, draw)
    for turn in range(4):
        whole = bytes_of(other.draw(CAMERA, poses(turn), "a", tails=NOTHING))
        part = bytes_of(other.draw(CAMERA, poses(turn), "a", visible=few, tails=NOTHING))
        assert draw(turn) == [whole, part, part, whole]
        assert whole != part
    assert len(replays) == 4 * 2


@pytest.mark.parametrize("options", [RenderOptions(rgb_float=True), RenderOptions(antialiased=True),
                                     RenderOptions(background=(0.5, 0.1, 0.3))])  # fmt: skip
def test_with_options(options: RenderOptions, replays: list[Replay]) -> None:
    batch = batch_of(options=options)
    settle(batch, replays, lambda turn: batch.draw(CAMERA, poses(turn), "a"))
    for turn in range(4):
        got = bytes_of(batch.draw(CAMERA, poses(turn), "a"))
        assert got == fresh(CAMERA, poses(turn), "a", options=options)
    assert len(replays) == 2


def test_kinds_that_take_turns_are_told_apart(replays: list[Replay]) -> None:
    kinds = ["one view", "float32", "many", "several scenes", "background", "depth", "from above"]
    assert len(kinds) < CALLS
    batch = batch_of()

    def draw(kind: str, turn: int) -> PicturesDevice:
        camera, views, keys, named = KINDS[kind]
        return batch.draw(camera, views(turn), keys, **named)

    settle(batch, replays, *(partial(draw, kind) for kind in kinds))
    drawn = []
    for turn in range(4):
        for kind in kinds:
            camera, views, keys, named = KINDS[kind]
            pictures = draw(kind, turn)
            drawn.append((pictures, fresh(camera, views(turn), keys, **named)))
    for pictures, want in drawn:
        assert bytes_of(pictures) == want
    assert len({id(replay) for replay in replays}) == len(kinds) - 1, "float32 are views, too"


def test_the_oldest_kind_is_forgotten(replays: list[Replay]) -> None:
    batch = batch_of()

    def draw(kind: int) -> bool:
        """Draw a kind of call; whether it was replayed."""
        before = len(replays)
        background = (0.1 * kind, 0.0, 0.0)
        got = bytes_of(batch.draw(CAMERA, poses(kind)[0], "a", background=background))
        assert got == bytes_of(plain.draw(CAMERA, poses(kind)[0], "a", background=background,
                                            tails=NOTHING))  # fmt: skip
        return len(replays) > before

    plain = batch_of()
    kinds = range(CALLS)
    settle(batch, replays, *([draw] * 2))
    assert [draw(k) for k in kinds] == [draw(k) for k in kinds] == [False] * CALLS
    assert all(draw(k) for k in kinds)
    assert draw(0), "used last, it stays longest"
    draw(CALLS)
    assert draw(0) and all(draw(k) for k in range(2, CALLS))
    assert not draw(1)


@pytest.mark.parametrize("wrong", ["nan", "inf", "mirror", "stretch", "bottom", "both"])
@pytest.mark.parametrize("sets", ["", "a"])
def test_a_bad_view_is_said_as_the_first_time(wrong: str, sets: str, replays: list[Replay]) -> None:
    batch, named = batch_of(sets=sets), {"visible": True} if sets else {}
    bring_sets(batch)
    settle(batch, replays, lambda turn: batch.draw(CAMERA, poses(turn), "a", **named))
    for turn in range(3):
        batch.draw(CAMERA, poses(turn), "a", **named)
    bad = poses(3)
    if wrong in ("nan", "both"):
        bad[3, 1, 2] = np.nan
    if wrong == "inf":
        bad[2, 0, 3] = -np.inf
    if wrong == "mirror":
        bad[1, 0] *= -1
    if wrong in ("stretch", "both"):
        bad[0, :3, :3] *= 1.5
    if wrong == "bottom":
        bad[4, 3, 3] = 2
    said = []
    for one in (batch_of(sets=sets), batch, batch):
        with pytest.raises(RenderError) as error:
            one.draw(CAMERA, bad, "a", **named)
        said.append(str(error.value))
    assert len(set(said)) == 1
    replays.clear()
    got = bytes_of(batch.draw(CAMERA, poses(4), "a", **named))
    assert got == fresh(CAMERA, poses(4), "a", sets=sets, **named)
    assert len(replays) == 1, "it is still recorded"


@pytest.mark.parametrize(
    ("named", "match"),
    [
        ({"outputs": ("colour",)}, "unknown output"),
        ({"background": (0.1, np.nan, 0)}, "background"),
        ({"background": np.zeros((1, 3))}, "background"),
        ({"keys": list("ab")}, "2 keys"),
        ({"keys": "x"}, "no scene 'x'"),
        ({"keys": ["a", None, "a", "a", "a"]}, "view 1"),
        ({"views": poses(0)[:, :3]}, "shape"),
    ],
)
def test_a_bad_call_is_refused_each_time(named: dict[str, Any], match: str) -> None:
    batch = batch_of()
    for _ in range(3):
        batch.draw(CAMERA, poses(0), "a")
    for _ in range(3):
        with pytest.raises(RenderError, match=match):
            batch.draw(CAMERA, **({"views": poses(1), "keys": "a"} | named))


def test_a_drawer_draws_what_it_recorded_alone(replays: list[Replay]) -> None:
    batch = batch_of()
    settle(batch, replays, lambda turn: batch.draw(CAMERA, poses(turn), "a"))
    for turn in range(3):
        batch.draw(CAMERA, poses(turn), "a")
    assert len(replays) == 1
    batch.drawer = Drawer(batch.device)
    for turn in range(2):
        got = bytes_of(batch.draw(CAMERA, poses(0), "a"))
        assert got == fresh(CAMERA, poses(0), "a")
        assert batch.drawer.batches == 1
        assert len(replays) == 1 + turn
    assert replays[0] is not replays[1]


def test_nothing_is_replayed_while_stages_are_told(replays: list[Replay]) -> None:
    batch, told = batch_of(), []
    settle(batch, replays, lambda turn: batch.draw(CAMERA, poses(turn), "a"))
    for turn in range(3):
        batch.draw(CAMERA, poses(turn), "a")
    batch.drawer.on_stage = told.append
    batch.draw(CAMERA, poses(3), "a")
    assert told and len(replays) == 1
    batch.drawer.on_stage = None
    batch.draw(CAMERA, poses(4), "a")
    assert len(replays) == 2
