"""Many scenes and tails in one call: each view is what it would be alone."""

from __future__ import annotations

import gc
import shutil
import weakref
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import DeviceMemoryError, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.pack import cloud_bytes
from gn0.render.cuda.renderer import RendererCuda
from gn0.render.renderer import RenderOptions
from gn0.testing.renderer_check import random_cloud

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
either = pytest.mark.usefixtures("either_drawer")

CAMERA = Camera.from_hfov(40, 30, 90)
SPLATS = 400
SCENES = "abc"


def cloud_of(key: str) -> GaussianCloud:
    return random_cloud(SPLATS, seed=ord(key))


def batch_of(
    memory: int | None = None, options: RenderOptions | None = None, keys: Sequence[str] = SCENES
) -> RendererBatch:
    batch = RendererBatch(DeviceHost(), options, memory)
    for key in keys:
        batch.add(key, lambda key=key: cloud_of(key), f"hash of {key}")
    return batch


def views(count: int) -> np.ndarray:
    return np.stack(
        [view_from_pose(-4 * np.cos(k), -4 * np.sin(k), 0.2, float(k)) for k in range(count)]
    )


@either
def test_a_view_does_not_depend_on_its_batch() -> None:
    """Views of three scenes in any order, some with tails, equal those drawn one by one."""
    keys, poses = list("cabacb"), views(6)
    tail, other = random_cloud(60, seed=7), random_cloud(30, seed=8, sh_degree=1)
    tails = [None, tail, other, tail, None, random_cloud(0, seed=1)]
    batch = batch_of()
    together = batch.draw(CAMERA, poses, keys, tails=tails).numpy()
    for v, key in enumerate(keys):
        alone = batch.draw(CAMERA, poses[v], key, tails=tails[v]).numpy()
        for name in ("rgb", "depth", "alpha"):
            assert getattr(together, name)[v].tobytes() == getattr(alone, name)[0].tobytes()
    assert batch.store.loads == 3
    assert (together.rgb[0] != together.rgb[4]).any()


@either
def test_more_scenes_than_memory_are_drawn_in_turns() -> None:
    """Room for one scene at a time: the same bytes in the order of the views."""
    keys, poses = list("cabacb"), views(6)
    want = batch_of().draw(CAMERA, poses, keys).numpy()
    tight = batch_of(cloud_bytes(SPLATS, 0))
    got = tight.draw(CAMERA, poses, keys).numpy()
    for name in ("rgb", "depth", "alpha"):
        assert getattr(got, name).tobytes() == getattr(want, name).tobytes()
    assert tight.drawer.batches == 3
    assert len(tight.store.resident) == 1
    assert tight.store.used <= tight.store.memory


@either
@pytest.mark.parametrize("step", ["draw", "pictures"])
def test_without_room_scenes_give_way(step: str, monkeypatch) -> None:
    """What the draw under way needs stays; when nothing is left to drop, the error is said."""
    batch = batch_of()
    batch.draw(CAMERA, views(3), list("abc"))
    assert batch.store.resident == list("abc")
    works, room = getattr(type(batch.drawer), step), 1

    def tight(self, *args, **named):
        if len(batch.store.resident) > room:
            raise DeviceMemoryError("no room", where="host emulation")
        return works(self, *args, **named)

    monkeypatch.setattr(type(batch.drawer), step, tight)
    batch.draw(CAMERA, views(1), "b")
    assert batch.store.resident == ["b"]
    room = -1
    with pytest.raises(DeviceMemoryError, match="no room"):
        batch.draw(CAMERA, views(1), "b")


@either
def test_one_tail_for_all_views() -> None:
    batch, tail, poses = batch_of(), random_cloud(50, seed=7), views(3)
    one = batch.draw(CAMERA, poses, "a", tails=tail).numpy()
    each = batch.draw(CAMERA, poses, "a", tails=[tail] * 3).numpy()
    none = batch.draw(CAMERA, poses, "a", tails=[None] * 3).numpy()
    assert one.rgb.tobytes() == each.rgb.tobytes() != none.rgb.tobytes()
    assert none.rgb.tobytes() == batch.draw(CAMERA, poses, "a").numpy().rgb.tobytes()


@either
def test_another_hash_shows_at_once() -> None:
    batch, poses = batch_of(), views(1)
    before = batch.draw(CAMERA, poses, "a").numpy().rgb
    batch.add("a", lambda: cloud_of("b"), "hash of a")
    assert (batch.draw(CAMERA, poses, "a").numpy().rgb == before).all()
    batch.add("a", lambda: cloud_of("b"), "hash of b")
    after = batch.draw(CAMERA, poses, "a").numpy().rgb
    assert (after == batch.draw(CAMERA, poses, "b").numpy().rgb).all()
    batch.remove("a")
    assert "a" not in batch
    with pytest.raises(RenderError, match="no scene 'a'"):
        batch.draw(CAMERA, poses, "a")


@either
def test_outputs_and_options() -> None:
    batch = batch_of(options=RenderOptions(rgb_float=True, background=(1, 0, 0)))
    away = view_from_pose(9, 0, 0, 0)
    pictures = batch.draw(CAMERA, away, "a", outputs=("rgb",))
    assert pictures.depth is None
    assert pictures.alpha is None
    assert (pictures.numpy().rgb == np.float32([1, 0, 0])).all()
    blue = batch.draw(CAMERA, away, "a", background=(0, 0, 1)).numpy().rgb
    assert (blue == np.float32([0, 0, 1])).all()
    assert batch.draw(CAMERA, np.empty((0, 4, 4)), []).numpy().rgb.shape == (0, 30, 40, 3)


@either
@pytest.mark.parametrize(
    ("named", "match"),
    [
        ({"keys": ["a"]}, "1 keys for 2 views"),
        ({"keys": "a", "tails": [None]}, "1 tails for 2 views"),
        ({"keys": "a", "visible": [None]}, "1 visible for 2 views"),
        ({"keys": ["a", "x"]}, "no scene 'x'"),
        ({"keys": "a", "visible": [(0, 0), None]}, "no visible sets"),
        ({"keys": "a", "outputs": ("colour",)}, "unknown output 'colour'"),
    ],
)
def test_refusals_say_what_is_wrong(named: dict, match: str) -> None:
    with pytest.raises(RenderError, match=match):
        batch_of().draw(CAMERA, views(2), **named)


def test_renderers_of_a_device_share_their_buffers() -> None:
    """And take turns: two threads with a renderer each get what each would get alone."""
    device = DeviceHost()
    pair = [RendererCuda(cloud_of(key), None, device) for key in "ab"]
    assert pair[0].batch.drawer is pair[1].batch.drawer
    assert RendererBatch(DeviceHost()).drawer is not pair[0].batch.drawer
    want = [renderer.render(CAMERA, views(2)).rgb.tobytes() for renderer in pair]

    def draw(k: int) -> bytes:
        return pair[k % 2].render(CAMERA, views(2)).rgb.tobytes()

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(draw, range(6))) == want * 3
    drawer = weakref.ref(pair[0].batch.drawer)
    pair.clear()
    gc.collect()
    assert drawer() is None, "buffers go with the last of them"
