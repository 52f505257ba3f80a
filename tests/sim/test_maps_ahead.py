"""Map pictures that several processes draw ahead are those that an environment would draw."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import FormatError
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.render.cuda.batch import RendererBatch
from gn0.render.light import LightCondition
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.maps_ahead import draw_maps_ahead, number_card, place_evenly


def test_each_of_several_cards_begins_with_other_scenes() -> None:
    """Two, four or eight of them share the scenes out evenly, none of them knowing how many."""
    for cards in (1, 2, 4, 8):
        assert sorted(map(place_evenly, range(cards))) == [k / cards for k in range(cards)]


def test_processes_with_a_card_each_begin_with_other_scenes(monkeypatch) -> None:
    """To each of them its card is number 0; the machine knows better."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3")
    assert number_card(0) == 3
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4, 6")
    assert [number_card(k) for k in range(3)] == [4, 6, 2]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "²")
    assert number_card(0) == 0
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES")
    assert number_card(1) == 1


def test_cards_that_go_by_their_uuid_have_their_places(tmp_path: Path, monkeypatch) -> None:
    """As schedulers name them; CUDA takes the beginning of a UUID for the whole."""
    uuids = ["GPU-9a01-1", "GPU-5f2c-7", "GPU-5f2d-7"]
    for bus, uuid in enumerate(uuids):
        (tmp_path / f"0000:{bus:02x}:00.0").mkdir()
        (tmp_path / f"0000:{bus:02x}:00.0" / "information").write_text(
            f"Model: \t\t NVIDIA H100\nGPU UUID: \t {uuid}\nDevice Minor: \t {bus}\nno colon\n"
        )
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "GPU-5f2c, GPU-9a01-1,GPU-5f2d-7")
    assert [number_card(k, tmp_path) for k in range(3)] == [1, 0, 2]
    assert number_card(3, tmp_path) == 3


def test_cards_that_nobody_lists_begin_with_scenes_of_their_own(
    tmp_path: Path, monkeypatch
) -> None:
    """Slices of a card, and cards of a machine whose driver tells nothing."""
    names = [f"{kind}-{n:x}7c1/1/0" for kind in ("MIG", "GPU") for n in range(4)]
    starts = []
    for name in names:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", name)
        assert number_card(0, tmp_path) == number_card(0, tmp_path / "none")
        starts.append(place_evenly(number_card(0, tmp_path)))
    assert len(set(starts)) == len(names) and all(0 <= start < 1 for start in starts)


@pytest.mark.slow
def test_they_are_drawn_once_with_the_same_bytes(own_cache, tmp_path: Path, monkeypatch) -> None:
    """Two flats, each as it was made and in the evening; then nothing is left to draw."""
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    lights = (None, LightCondition("evening", exposure=-1.0, kelvin=3500))
    scenes, episodes = [], []
    for name in ("one", "two"):
        save_scene(replace(build_example_scene(), id=name), tmp_path / name)
        scenes.append(load_scene(tmp_path / name))
        floor = NavigationMap(scenes[-1].grid, 0.2)
        for light, one in zip(lights, sample_goal_episodes(scenes[-1], floor, 2, 0), strict=True):
            episodes.append(msgspec.structs.replace(one, light=light))
    told: list[tuple[int, int | None]] = []

    def open_env(*sensors: str) -> VectorEnvDevice:
        device = DeviceHost(2)
        return VectorEnvDevice(
            4, scenes, episodes=episodes, device=device, preset="tiny_128", sensors=sensors,
            renderer=RendererBatch(device), map_view={"squares": [{"size": 48}]},
        )  # fmt: skip

    def see(env: VectorEnvDevice) -> np.ndarray:
        seen, _ = env.reset(seed=0, options={"episode": np.arange(4)})
        return seen["ego_map"].numpy().copy()

    def cache(name: str) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        (folder / "emulation").symlink_to(own_cache / "emulation")
        monkeypatch.setenv("GN0_CACHE", str(folder))
        return folder / "bev"

    cache("alone")
    alone = see(open_env("ego_map"))
    kept, env = cache("ahead"), open_env("ego_map")
    assert draw_maps_ahead(env) == 0  # so few are left to the environment
    drawn = draw_maps_ahead(env, processes=2, few=0, progress=lambda _, *n: told.append(n))
    assert drawn == 4 and told[-1] == (2, 2)
    assert len(list(kept.iterdir())) == 2  # the flats are alike
    assert draw_maps_ahead(open_env("ego_map"), processes=2, few=0) == 0
    assert draw_maps_ahead(open_env("goal_vector"), few=0) == 0
    monkeypatch.setattr(RendererBatch, "render", None)  # is not asked any more
    assert (see(env) == alone).all() and len(np.unique(alone)) > 20
    for file in kept.iterdir():
        file.unlink()
    (tmp_path / "two" / "point_cloud.ply").write_bytes(b"no splats")
    with pytest.raises(FormatError, match="two"):
        draw_maps_ahead(open_env("ego_map"), processes=2, few=0)
