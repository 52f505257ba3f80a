"""Looks of one scene share what they can, and are those that each would have had alone."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from gn0.errors import RenderError, StorageError
from gn0.gaussians.cloud import GaussianCloud
from gn0.render.cuda.pack import CloudReady, prepare_cloud
from gn0.render.light import draw_condition, relight_cloud
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.scenes.scene import Scene, read_splats
from gn0.sim.scene_looks import SceneLooks


class _Drawer:
    """What `SceneLooks` asks of a renderer on a card, which keeps the loaders."""

    def __init__(self) -> None:
        self.loads: dict[str, Callable[[], CloudReady]] = {}
        self.ordered = 0

    def add(self, key: str, load: Callable[[], Any], digest: str = "") -> None:
        self.loads[key] = load

    def prepare(self, cloud: GaussianCloud, like: Any = None) -> CloudReady:
        self.ordered += like is None or not like.fits(cloud)
        return prepare_cloud(cloud, like=like)


class _Folder:
    """Scenes whose splats are other arrays each time they are read."""

    def __init__(self, names: tuple[str, ...]) -> None:
        made = build_example_scene()
        self._cloud, self._made, self.read = made.gaussians, made, 0
        self.broken = False
        self.scenes = {name: lambda name=name: self.open(name) for name in names}

    def open(self, name: str) -> Scene:
        return replace(self._made, id=name, load_cloud=self._load, cloud_hash=name)

    def _load(self) -> GaussianCloud:
        if self.broken:
            raise StorageError("gone")
        self.read += 1
        return replace(self._cloud, means=self._cloud.means.copy())


def _looks(name: str) -> list[str]:
    lit = (draw_condition(k, "looks") for k in range(2))
    return [name, *(f"{name}\0{msgspec.json.encode(light).decode()}" for light in lit)]


def test_looks_of_a_scene_are_those_of_each_alone_and_it_is_read_once() -> None:
    folder, drawer = _Folder(("a",)), _Drawer()
    looks = SceneLooks(drawer, folder.scenes)  # type: ignore[arg-type]
    for look in _looks("a"):
        looks.add(look)
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda load: load(), drawer.loads.values()))
    assert (folder.read, drawer.ordered) == (1, 1)
    cloud = folder.open("a").gaussians
    for k, ready in enumerate(found):
        alone = cloud if k == 0 else relight_cloud(cloud, draw_condition(k - 1, "looks"))
        expected = prepare_cloud(alone)
        assert np.array_equal(ready.places, expected.places)
        assert (ready.alive, ready.ordered) == (expected.alive, expected.ordered)
        for name in ("means", "quats", "scales", "opacities", "sh"):
            assert np.array_equal(getattr(ready.cloud, name), getattr(alone, name))


def test_scenes_of_folders_do_not_keep_their_splats(tmp_path) -> None:
    """Of hundreds they would fill the host's memory; what is drawn is the same."""
    save_scene(build_example_scene(), tmp_path / "a")
    scene, drawer = load_scene(tmp_path / "a"), _Drawer()
    looks = SceneLooks(drawer, {"a": lambda: scene})  # type: ignore[arg-type]
    for look in _looks("a"):
        looks.add(look)
    found = [load() for load in drawer.loads.values()]
    assert "gaussians" not in vars(scene)
    assert found[0].cloud.content_hash == scene.gaussians.content_hash
    assert read_splats(scene) is scene.gaussians  # which are here now


def test_looks_are_told_once_each_as_they_are_loaded() -> None:
    folder, drawer = _Folder(("a", "b")), _Drawer()
    looks = SceneLooks(drawer, folder.scenes)  # type: ignore[arg-type]
    told: list[tuple[int, int]] = []
    looks.progress = lambda stage, done, total: told.append((done, total))
    for look in _looks("a") + _looks("b"):
        looks.add(look)
    loads = list(drawer.loads.values())
    for load in (loads[0], loads[0], *loads):
        load()
    assert told == [(1, 6), (1, 6), (1, 6), *((k, 6) for k in range(2, 7))]


def test_few_scenes_wait_for_their_next_look() -> None:
    """One that gave way is read again; what was loaded first is not kept for ever."""
    names = ("a", "b", "c", "d", "e")
    folder, drawer = _Folder(names), _Drawer()
    looks = SceneLooks(drawer, folder.scenes)  # type: ignore[arg-type]
    for name in names:
        looks.add(name)
        drawer.loads[name]()
    assert folder.read == 5
    drawer.loads["e"]()
    assert folder.read == 5
    drawer.loads["a"]()
    assert folder.read == 6


def test_a_scene_that_could_not_be_read_is_tried_again() -> None:
    folder, drawer = _Folder(("a",)), _Drawer()
    looks = SceneLooks(drawer, folder.scenes)  # type: ignore[arg-type]
    looks.add("a")
    folder.broken = True
    for _ in range(2):
        with pytest.raises(StorageError, match="gone"):
            drawer.loads["a"]()
    folder.broken = False
    assert len(drawer.loads["a"]()) == len(folder.open("a").gaussians)


def test_an_order_is_taken_from_the_same_splats_alone() -> None:
    """Others are ordered anew, and colours are checked in any case."""
    cloud = build_example_scene().gaussians
    ready = prepare_cloud(cloud)
    moved = replace(cloud, means=np.ascontiguousarray(cloud.means[::-1]))
    assert not ready.fits(moved)
    assert np.array_equal(prepare_cloud(moved, like=ready).places, prepare_cloud(moved).places)
    wrong = cloud.sh.copy()
    wrong[-1] = np.nan
    with pytest.raises(RenderError, match="not finite") as caught:
        prepare_cloud(replace(cloud, sh=wrong), like=ready)
    assert caught.value.where == "cloud.sh"
