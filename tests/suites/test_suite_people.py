"""A sampled suite with people: the same missions, and people that stay when it is read again."""

from __future__ import annotations

import msgspec

from gn0.cli.main import main
from gn0.scenes import build_example_scene, save_scene
from gn0.suites.suite import load_suite


def test_people_join_the_missions_of_a_suite_without_them(tmp_path, capsys) -> None:
    save_scene(build_example_scene(), tmp_path / "flat")
    made = {}
    for name, flags in (("bare", []), ("lived-in", ["--people", "2", "--people-seed", "1"])):
        out = str(tmp_path / name)
        flat = str(tmp_path / "flat")
        assert main(["bench", "suite", flat, "--episodes", "3", "--out", out, *flags]) == 0
        made[name] = load_suite(tmp_path / name).episodes
    assert all(1 <= len(episode.people) <= 2 for episode in made["lived-in"])
    without = [msgspec.structs.replace(episode, people=()) for episode in made["lived-in"]]
    assert without == list(made["bare"])
