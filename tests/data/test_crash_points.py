"""A dataset survives a kill after every single write: what is resumed equals what was not cut."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from gn0.data.build import build_dataset
from gn0.data.dataset import JOURNAL
from gn0.data.picture_build import render_dataset
from gn0.data.repair import repair_dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.data.verify import verify_dataset
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.sim.presets import find_preset
from gn0.suites.suite import Suite, save_suite

CAMERA = "rgbd_224"


@pytest.fixture(scope="module")
def small_suite(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """Two walks of a small camera: two parts."""
    root = tmp_path_factory.mktemp("small")
    save_scene(build_example_scene(), root / "flat")
    scene = load_scene(root / "flat")
    agent = find_preset(CAMERA).agent
    navigation = NavigationMap(scene.grid, agent.radius)
    episodes = sample_goal_episodes(scene, navigation, 2, 0, maximum_length=5.0, agent=agent)
    episodes = [msgspec.structs.replace(e, split="train") for e in episodes]
    return save_suite(root / "suite", [scene], episodes, name="small", camera=CAMERA)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["webdataset", "lerobot", "render", "depth"])
def test_a_kill_after_any_write_loses_nothing(
    kind: str, small_suite: Suite, files_of, cut_after_writes
) -> None:
    layout = {"render": "none", "depth": "none"}.get(kind, kind)
    pictures = PictureSettings(layout=layout, depth=kind == "depth")
    settings = BuildSettings(chunk=1, pictures=pictures)

    def make(out: Path) -> None:
        build_dataset(small_suite, out, settings)
        if layout == "none":
            render_dataset(out)

    whole, cuts = cut_after_writes(make)
    wanted = files_of(whole)
    assert len(cuts) > 20
    for left in cuts:
        make(left)
        assert verify_dataset(left, workers=1).damages == (), left
        assert files_of(left) == wanted, left


@pytest.mark.slow
def test_a_repair_that_is_killed_is_finished_by_the_next(
    small_suite: Suite, files_of, cut_after_writes
) -> None:
    def damage(out: Path) -> None:
        build_dataset(small_suite, out, BuildSettings(chunk=1))
        for path in [*out.glob("samples/*"), *out.glob("pictures/*/*.tar"), out / JOURNAL]:
            path.write_bytes(path.read_bytes()[:-9])

    def repair(out: Path) -> None:
        assert repair_dataset(out).ok

    whole, cuts = cut_after_writes(repair, damage)
    wanted = files_of(whole)
    assert verify_dataset(whole).ok and len(cuts) > 4
    for left in cuts:
        repair(left)
        assert files_of(left) == wanted, left
