"""Many scenes in little memory: who stays, who goes, and never the splats of yesterday."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import DeviceMemoryError, FormatError, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.render.cuda.pack import cloud_bytes, prepare_cloud, upload_cloud
from gn0.render.cuda.store import CloudStore
from gn0.render.light import LightCondition
from gn0.scenes.folder import load_scene, save_scene
from gn0.sim.open import look_hash
from gn0.testing.renderer_check import random_cloud
from gn0.testing.scenes import build_room_scene

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

SPLATS = 500
ONE = cloud_bytes(SPLATS, 0)


class Loader:
    """Gives a cloud, and counts."""

    def __init__(self, seed: int) -> None:
        self.seed, self.times = seed, 0

    def __call__(self) -> GaussianCloud:
        self.times += 1
        return random_cloud(SPLATS, seed=self.seed)


def store_of(
    names: str, memory: int, limit: int = 2**33
) -> tuple[CloudStore, dict[str, Loader], DeviceHost]:
    device = DeviceHost(limit=limit)
    store = CloudStore(device, memory)
    loaders = {name: Loader(k) for k, name in enumerate(names)}
    for name, loader in loaders.items():
        store.add(name, loader, f"hash of {name}")
    return store, loaders, device


def test_a_cloud_is_loaded_when_first_drawn_and_kept() -> None:
    store, loaders, device = store_of("ab", 10 * ONE)
    assert device.used == 0
    first = store.open("a")
    assert store.open("a") is first
    assert (loaders["a"].times, loaders["b"].times) == (1, 0)
    assert store.used == device.used == first.nbytes <= ONE
    assert "a" in store
    assert "c" not in store
    store.remove("a")
    del first
    assert device.used == 0


def test_the_least_recently_used_goes_first() -> None:
    store, loaders, _ = store_of("abc", 2 * ONE)
    for key in "aba":
        store.open(key)
    store.open("c")
    assert store.resident == ["a", "c"]
    store.open("b")
    assert store.resident == ["c", "b"]
    assert [loaders[key].times for key in "abc"] == [1, 2, 1]
    assert store.used <= store.memory


def test_what_does_not_fit_together_comes_in_groups() -> None:
    """Clouds of a group stay for its turn, and what is here already is drawn first."""
    store, loaders, device = store_of("abcde", 2 * ONE)
    store.open("c")
    seen = []
    for group in store.groups("abacbde"):
        assert set(group) <= set(store.resident)
        seen.append(set(group))
        assert device.used <= store.memory
    assert seen == [{"c", "a"}, {"b", "d"}, {"e"}]
    assert [loader.times for loader in loaders.values()] == [1] * 5
    assert [len(group) for group in store.groups("e")] == [1]


def test_a_scene_larger_than_the_budget_is_a_clear_error() -> None:
    store, _, _ = store_of("a", ONE // 2)
    with pytest.raises(DeviceMemoryError, match=r"scene 'a' needs .* MiB, more than the .* MiB"):
        store.open("a")


def test_a_full_device_drops_others_before_it_gives_up() -> None:
    """The budget says yes, the device says no: other tenants have its memory."""
    # room for two, and for what is under way of a third
    store, loaders, _ = store_of("abc", 10 * ONE, limit=int(2.95 * ONE))
    for key in "abc":
        store.open(key)
    assert store.resident == ["b", "c"]
    assert [sorted(group) for group in store.groups("abc")] == [["b", "c"], ["a"]]
    assert loaders["a"].times == 2
    small, _, _ = store_of("a", 10 * ONE, limit=ONE // 2)
    with pytest.raises(DeviceMemoryError, match=r"and .* MiB are free.*backend 'cpu'"):
        small.open("a")


def test_a_kept_cloud_never_gives_way() -> None:
    store, _, _ = store_of("ab", 2 * ONE)
    kept = store.keep("scene", random_cloud(SPLATS, seed=9))
    for key in "abab":
        store.open(key)
    assert store.open("scene") is kept
    assert store.give_way()
    assert not store.give_way()


def test_another_hash_is_another_cloud() -> None:
    store = CloudStore(DeviceHost(), 10 * ONE)
    old, new = Loader(1), Loader(2)
    assert store.add("home", old, "one")
    first = store.open("home").splats.numpy()
    assert not store.add("home", new, "one"), "the same hash: the same splats, whoever loads"
    assert (store.open("home").splats.numpy() == first).all()
    assert store.add("home", new, "two")
    assert store.digest("home") == "two"
    assert store.resident == []
    assert not (store.open("home").splats.numpy() == first).all()


def test_without_hashes_another_loader_is_another_cloud() -> None:
    store = CloudStore(DeviceHost(), 10 * ONE)
    one, other = Loader(1), Loader(2)
    assert store.add("home", one)
    store.open("home")
    assert not store.add("home", one)
    assert store.add("home", other)
    assert store.resident == []


def test_a_scene_swapped_on_disk_is_never_shown_as_it_was(tmp_path: Path) -> None:
    """As a simulator does it: the key is the scene's name, the hash that of its look."""
    folder = tmp_path / "home"
    scene = build_room_scene(spacing=0.4)
    save_scene(scene, folder)
    before = load_scene(folder)
    store = CloudStore(DeviceHost(), 2**26)

    def add(light: LightCondition | None = None) -> bool:
        now = load_scene(folder)
        load: Callable[[], GaussianCloud] = now.load_cloud
        return store.add("home", load, look_hash(now, light))

    assert add()
    first = store.open("home").splats.numpy()
    assert not add(), "opened again, nothing has changed"
    assert add(LightCondition(name="dusk", exposure=-1.0)), "another light is another look"
    assert add()
    moved = scene.gaussians.means + np.float32(0.5)
    cloud = replace(scene.gaussians, means=moved)
    save_scene(
        replace(scene, load_cloud=lambda: cloud, cloud_hash=cloud.content_hash),
        folder,
        overwrite=True,
    )
    assert add()
    assert not (store.open("home").splats.numpy()[:, :3] == first[:, :3]).all()
    stale = CloudStore(DeviceHost(), 2**26)
    stale.add("home", before.load_cloud, look_hash(before))
    with pytest.raises(FormatError, match=r"not those that scene\.json records"):
        stale.open("home")


def test_unknown_keys_and_failing_loaders_are_errors() -> None:
    store, _, _ = store_of("a", ONE)
    with pytest.raises(RenderError, match="no scene 'z'"):
        store.open("z")
    with pytest.raises(RenderError, match="no scene 'z'"):
        store.digest("z")
    store.remove("z")

    def broken() -> GaussianCloud:
        raise FormatError("the file is cut", file="x.ply")

    store.add("b", broken)
    with pytest.raises(FormatError):
        store.open("b")
    store.open("a")


def test_the_next_cloud_is_loaded_while_one_is_drawn(monkeypatch) -> None:
    """Of large ones one ahead and no more, each once and in order, whatever fits beside what."""
    monkeypatch.setattr("gn0.render.cuda.store._AHEAD", ONE - 1)
    store, loaders, _ = store_of("abcd", ONE)
    ahead = threading.Event()

    def load_b() -> GaussianCloud:
        ahead.set()
        return loaders["b"]()

    store.add("b", load_b, "another hash")
    groups = store.groups("abcd")
    assert list(next(groups)) == ["a"]
    assert ahead.wait(10) and loaders["d"].times == 0
    assert [list(group) for group in groups] == [["b"], ["c"], ["d"]]
    assert [loader.times for loader in loaders.values()] == [1, 1, 1, 1]
    assert store.holds("d") and not store.holds("a")


def test_small_clouds_are_loaded_several_at_a_time(monkeypatch) -> None:
    """As many as the host's room holds by the size of the last; they come in order all the same."""
    monkeypatch.setattr("gn0.render.cuda.store._AHEAD", 3 * ONE)
    monkeypatch.setattr("gn0.render.cuda.store.count_cores", lambda: 1)
    store, loaders, _ = store_of("abcdefg", 10 * ONE)
    three = threading.Barrier(3)

    def wait_for_others(loader: Loader) -> GaussianCloud:
        three.wait(20)
        return loader()

    for key in "bcdefg":
        store.add(key, partial(wait_for_others, loaders[key]), "another hash")
    assert [list(group) for group in store.groups("abcdefg")] == [list("abcdefg")]
    assert [loader.times for loader in loaders.values()] == [1] * 7


def test_looks_that_wait_for_their_scene_take_no_core(monkeypatch) -> None:
    """On one core a scene's other looks wait for its first, and the next scene is read beside."""
    monkeypatch.setattr("gn0.render.cuda.store.count_cores", lambda: 1)
    store, loaders, _ = store_of("abcd", 10 * ONE)
    read, next_begun = threading.Event(), threading.Event()

    def load(key: str) -> GaussianCloud:
        if key == "d":
            next_begun.set()
        elif key == "b":
            assert next_begun.wait(20)
            read.set()
        elif key == "c":
            assert read.wait(20)
        return loaders[key]()

    for key in "bcd":
        store.add(key, partial(load, key), "another hash")
    assert [list(group) for group in store.groups("abcd")] == [list("abcd")]


def test_a_cloud_that_cannot_be_loaded_ahead_is_said_at_its_turn() -> None:
    store, loaders, _ = store_of("abc", 10 * ONE)

    def broken() -> GaussianCloud:
        raise FormatError("a broken file", file=Path("b.ply"))

    store.add("b", broken, "another hash")
    with pytest.raises(FormatError, match="a broken file"):
        list(store.groups("abc"))
    assert store.resident == ["a"]
    assert list(next(store.groups("ac"))) == ["a", "c"]
    with pytest.raises(RenderError, match="not finite"):
        prepare_cloud(replace(loaders["a"](), opacities=np.full(SPLATS, np.nan, np.float32)))


def test_a_cloud_made_ready_is_packed_as_any_other() -> None:
    device = DeviceHost()
    for seed in range(3):
        cloud = random_cloud(SPLATS, seed=seed)
        one, other = upload_cloud(device, cloud), upload_cloud(device, prepare_cloud(cloud))
        for name in ("splats", "order", "boxes"):
            np.testing.assert_array_equal(getattr(one, name).numpy(), getattr(other, name).numpy())
        assert (one.alive, one.ordered, one.size) == (other.alive, other.ordered, other.size)
