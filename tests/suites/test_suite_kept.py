"""A suite is read once by a process, as long as it is as it was."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gn0.errors import Gn0Error
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.suites.suite import Suite, load_suite, save_suite
from gn0.suites.suite_kept import load_suite_kept


def _save(folder: Path, count: int) -> Suite:
    if not (folder / "scene").exists():
        save_scene(build_example_scene(), folder / "scene")
    scene = load_scene(folder / "scene")
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), count, 0)
    return save_suite(folder / "suite", [scene], episodes, name="one", overwrite=True)


def test_a_suite_is_read_again_only_when_it_changed(tmp_path, monkeypatch) -> None:
    _save(tmp_path, 3)
    monkeypatch.chdir(tmp_path)
    first = load_suite_kept("suite")
    assert first.episodes == load_suite("suite").episodes
    assert load_suite_kept(tmp_path / "suite") is first  # by whatever name
    _save(tmp_path, 2)
    assert len(load_suite_kept("suite").episodes) == 2
    file = tmp_path / "suite" / "suite.json"
    os.utime(file, ns=(1, 1))  # touched: who knows what is in it
    assert load_suite_kept("suite") is not first


def test_what_is_wrong_is_said_as_without_it(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    _save(tmp_path, 2)
    load_suite_kept("suite")
    (tmp_path / "suite" / "suite.json").write_text("{")
    for path in ("suite", "nowhere"):
        said = []
        for load in (load_suite, load_suite_kept):
            with pytest.raises(Gn0Error) as caught:
                load(path)
            said.append((type(caught.value), str(caught.value)))
        assert said[0] == said[1]
