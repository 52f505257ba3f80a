"""The verbs of `gn0 data` as a user meets them."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from gn0.cli.main import main
from gn0.data.build import build_dataset
from gn0.data.dataset import open_dataset
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
from gn0.people.person import EpisodePerson
from gn0.sim.open import open_simulator
from gn0_trials.follow_suite_small import goal_episode, save_small


def test_build_render_show_verify(data_suite, tmp_path, capsys) -> None:
    out = str(tmp_path / "data")
    told = ["data", "build", str(data_suite.folder), "--layout", "none", "--out", out]
    assert main([*told, "--chunk", "4", "--tokens", "ego"]) == 0
    text = capsys.readouterr().out
    dataset = open_dataset(out)
    assert f"{dataset.about.rows} samples of 6 episodes in 1 scene, written to {out}" in text
    assert dataset.about.settings.tokens.frame == "ego"
    assert main(["data", "verify", out, "--pixels"]) == 0
    assert "no hashes yet" in capsys.readouterr().out
    assert main(["data", "render", out, "--format", "png"]) == 0
    assert "every picture matches its hash" in capsys.readouterr().out
    picture = tmp_path / "sheet.png"
    assert main(["data", "show", out, "--steps", "2", "--out", str(picture)]) == 0
    with Image.open(picture) as sheet:
        assert sheet.width > 800 and sheet.height > 500


def test_what_makes_no_sense_is_refused_in_words(labels_only, tmp_path, capsys) -> None:
    folder = str(labels_only.folder)
    assert main(["data", "show", folder, "--out", str(tmp_path / "x.gif")]) == 2
    assert "end it with .png or .jpg" in capsys.readouterr().err
    assert main(["data", "verify", str(tmp_path)]) == 2
    assert "gn0 data build EPISODES --out DIR" in capsys.readouterr().err
    assert main(["data", "build", str(tmp_path), "--out", str(tmp_path / "d")]) == 2
    assert "suite.json" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["data", "build", folder, "--quality", "high", "--out", str(tmp_path / "d")])


def test_a_walk_that_was_cut_off_ends_where_the_simulator_ended(data_suite, tmp_path) -> None:
    """Rollouts of policies end with any action; the last pose follows from the rules of motion."""
    settings = BuildSettings(
        pictures=PictureSettings(layout="none"),
        dagger=DaggerSettings(policy="wall_follower", beta=0.3, max_steps=9, halting="none"),
    )
    dataset = build_dataset(data_suite, tmp_path / "d", settings)
    last = set()
    for name in dataset.sampled:
        rollout = dataset.rollout(name)
        simulator = open_simulator(dataset.scene(rollout.episode.scene_id), max_steps=500)
        simulator.reset(rollout.episode)
        for step, action in enumerate(rollout.actions.tolist()):
            assert tuple(rollout.poses[step]) == tuple(simulator.pose)
            collided = simulator.step(action).collided
            assert collided == rollout.rows.collided[step]
        np.testing.assert_array_equal(rollout.poses[-1], simulator.pose)
        last.add(int(rollout.actions[-1]))
    assert last - {0}, "every walk ended with STOP: nothing was tested"


@pytest.mark.slow
def test_ray_writes_the_same_bytes(data_suite, settings_of, webdataset, tmp_path, files_of) -> None:
    pytest.importorskip("ray")
    build_dataset(data_suite, tmp_path / "ray", settings_of(), workers=2, executor="ray")
    assert files_of(tmp_path / "ray") == files_of(webdataset.folder)


@pytest.mark.slow
def test_kills_lose_nothing(tmp_path) -> None:
    from gn0_trials.crash_data import run_data_crashes

    report = run_data_crashes(4, tmp_path)
    assert report.same == report.runs
    assert (report.lost, report.twice, report.unreadable) == (0, 0, 0)
    assert (report.forgotten, report.leftovers) == (0, 0)


def test_a_build_of_which_every_episode_fell_is_no_success(tmp_path, capsys) -> None:
    """Somebody walks through a wall in each of them: each is skipped with the place."""
    walker = EpisodePerson(number=1, identity="drawn:0:1", path=((0.1, 0.1), (6.0, 4.4)))
    suite = save_small(tmp_path / "suite", goal_episode(walker))
    out = str(tmp_path / "data")
    assert main(["data", "build", str(suite.folder), "--layout", "none", "--out", out]) == 1
    text = capsys.readouterr().out
    assert "skipped b-goal: person 1 comes nearer than 0.3 m to a wall at (0.100, 0.100) m" in text
    assert "1 of 1 episode skipped" in text and "look at it" not in text
