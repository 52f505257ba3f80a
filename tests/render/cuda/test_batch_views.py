"""Views on the device, of scenes that only it knows: the pictures that the host asks for."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import DeviceMemoryError, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.pack import cloud_bytes
from gn0.testing.renderer_check import random_cloud

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

CAMERA = Camera.from_hfov(40, 30, 90)
SPLATS = 300
VIEWS = np.stack([view_from_pose(-4 * np.cos(k), -4 * np.sin(k), 0.2, float(k)) for k in range(5)])
KEYS = ["a", None, "b", "c"]
SHOWN = np.array([3, 0, 0, 2, 3], np.int32)
NAMES = list("caabc")


def batch_of(memory: int | None = None) -> RendererBatch:
    batch = RendererBatch(DeviceHost(), memory=memory)
    for key in "abc":
        batch.add(key, lambda key=key: cloud_of(key), f"hash of {key}")
    return batch


def cloud_of(key: str) -> GaussianCloud:
    return random_cloud(SPLATS, seed=ord(key))


def bytes_of(pictures) -> list[bytes]:
    got = pictures.numpy()
    return [a.tobytes() for a in (got.rgb, got.depth, got.alpha)]


@pytest.fixture(scope="module")
def want() -> list[bytes]:
    return bytes_of(batch_of().draw(CAMERA, VIEWS, NAMES))


def test_scenes_that_only_the_device_knows(want, monkeypatch) -> None:
    batch = batch_of()
    device = batch.device
    poses, chosen = device.upload(VIEWS), device.upload(SHOWN)
    with monkeypatch.context() as no_waiting:
        no_waiting.setattr(device, "download", None)
        pictures = batch.draw(CAMERA, poses, KEYS, chosen=chosen)
    assert bytes_of(pictures) == want
    assert bytes_of(batch.draw(CAMERA, poses, NAMES)) == want
    one = batch.draw(CAMERA, poses, "b")
    assert bytes_of(one) == bytes_of(batch.draw(CAMERA, VIEWS, "b"))
    assert bytes_of(batch.draw(CAMERA, poses, ["b"] * 5)) == bytes_of(one)
    assert batch.store.loads == 3


def test_what_the_host_arranges_is_the_same(want) -> None:
    """Tails, and scenes that do not fit together; those are not loaded in vain each time."""
    tight = batch_of(2 * cloud_bytes(SPLATS, 0))
    poses, chosen = tight.device.upload(VIEWS), tight.device.upload(SHOWN)
    loads = []
    for _ in range(3):
        assert bytes_of(tight.draw(CAMERA, poses, KEYS, chosen=chosen)) == want
        loads.append(tight.store.loads)
    assert loads[2] - loads[1] == 1, "two stay, and make room for the third when they are drawn"
    pair = np.where(SHOWN == 3, 2, SHOWN)
    two = tight.draw(CAMERA, poses, ["a", None, "b"], chosen=tight.device.upload(pair))
    assert bytes_of(two) == bytes_of(batch_of().draw(CAMERA, VIEWS, list("baabb")))
    batch, tail = batch_of(), random_cloud(60, seed=7)
    poses, chosen = batch.device.upload(VIEWS), batch.device.upload(SHOWN)
    mine = batch.draw(CAMERA, poses, KEYS, chosen=chosen, tails=tail)
    assert bytes_of(mine) == bytes_of(batch.draw(CAMERA, VIEWS, NAMES, tails=tail))


def test_a_full_device_lets_others_give_way(want, monkeypatch) -> None:
    batch = batch_of()
    batch.add("other", lambda: random_cloud(SPLATS, seed=5))
    batch.draw(CAMERA, VIEWS, "other")
    works, tries = type(batch.drawer).pictures, []

    def full(*args):
        tries.append(batch.store.resident)
        if "other" in batch.store.resident:
            raise DeviceMemoryError("no room")
        return works(*args)

    monkeypatch.setattr(type(batch.drawer), "pictures", full)
    poses, chosen = batch.device.upload(VIEWS), batch.device.upload(SHOWN)
    assert bytes_of(batch.draw(CAMERA, poses, KEYS, chosen=chosen)) == want
    assert [len(names) for names in tries] == [4, 3]


@pytest.mark.parametrize(
    ("named", "match"),
    [
        ({"keys": ["a"]}, "1 keys for 5 views"),
        ({"keys": ["a", "x"], "chosen": SHOWN}, "no scene 'x'"),
        ({"keys": ["a", None], "chosen": SHOWN % 2}, "view 0: a view shows a scene"),
        (
            {"keys": ["a", None], "chosen": SHOWN % 2, "tails": random_cloud(3, seed=1)},
            "is not here",
        ),
        ({"keys": ["a"], "chosen": SHOWN}, "view 0: a view shows a scene"),
        (
            {"keys": ["a"], "chosen": SHOWN, "tails": random_cloud(3, seed=1)},
            "no key number 3",
        ),
        ({"keys": KEYS, "chosen": SHOWN[:2]}, r"int32 \(2,\) for 5 views"),
        ({"keys": KEYS, "chosen": SHOWN.astype(np.int64)}, "int64"),
        ({"keys": "a", "chosen": SHOWN}, "`chosen`"),
        ({"keys": "a", "views": VIEWS.astype(np.float32)}, "float32"),
        ({"keys": "a", "views": VIEWS[:, 0]}, r"\(5, 4\)"),
        ({"keys": "a", "views": 2 * VIEWS}, "view 0: a view is not a rigid"),
        ({"keys": "a", "outputs": ("colour",)}, "unknown output"),
    ],
)
def test_refusals_say_what_is_wrong(named: dict, match: str) -> None:
    batch = batch_of()
    more = {"views": VIEWS} | named
    for name in ("views", "chosen"):
        if name in more:
            more[name] = batch.device.upload(more[name])
    with pytest.raises(RenderError, match=match):
        batch.draw(CAMERA, **more)


def test_chosen_needs_views_on_the_device() -> None:
    batch = batch_of()
    with pytest.raises(RenderError, match="on the device"):
        batch.draw(CAMERA, VIEWS, KEYS, chosen=batch.device.upload(SHOWN))
    none = batch.device.empty((0, 4, 4), np.float64)
    assert batch.draw(CAMERA, none, "a").numpy().rgb.shape == (0, 30, 40, 3)
