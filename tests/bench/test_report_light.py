"""Clips of a report show an episode in the light that it was played in."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.bench.episode_clip import BAD, CAPTION, render_clip
from gn0.bench.report import draw_scene, load_run
from gn0.bench.runner import run_suite
from gn0.geometry import U8, view_from_pose
from gn0.render.camera import Camera
from gn0.render.light import draw_condition
from gn0.suites.suite import Suite

pytestmark = pytest.mark.usefixtures("workers_here")


def test_a_clip_is_lit_as_its_episode_was(flats_suite: Suite, tmp_path: Path) -> None:
    run_suite(flats_suite, "oracle", tmp_path / "run", max_episodes=1)
    run = load_run(tmp_path / "run")
    result = run.results[0]
    plain = next(e for e in flats_suite.episodes if e.id == result.episode)
    night = msgspec.structs.replace(plain, light=draw_condition(0, mood="night"))
    art = draw_scene(flats_suite, plain.scene_id, 0, 1, "cpu")
    eye = view_from_pose(*plain.start[:2], 1.3, plain.start[2], 0.0)[None]
    views, maps, clips = [], [], []
    for episode in (plain, night):
        scene = art.clips(episode.light)
        picture = scene.renderer.render(Camera.from_hfov(64, 48, 90.0), eye, outputs=("rgb",)).rgb
        assert picture is not None
        views.append(float(np.mean(picture)))
        maps.append(float(np.mean(scene.bev.rgb)))
        trace = run.traces[plain.id]
        clips.append(render_clip(scene, episode, result, trace, title="oracle", most_frames=4).mp4)
    assert views[1] < 0.6 * views[0] and maps[1] < 0.6 * maps[0]
    assert clips[0] != clips[1]


def test_only_the_last_caption_of_a_clip_is_red_or_green(
    flats_suite: Suite, tmp_path: Path
) -> None:
    run_suite(flats_suite, "oracle", tmp_path / "run", max_episodes=1)
    run = load_run(tmp_path / "run")
    result = run.results[0]
    assert result.metrics is not None and not result.metrics.success
    episode = next(e for e in flats_suite.episodes if e.id == result.episode)
    scene = draw_scene(flats_suite, episode.scene_id, 0, 1, "cpu").clips(episode.light)
    trace = run.traces[episode.id]

    def red(poster: U8) -> int:
        words = np.asarray(poster, np.int64)[-CAPTION:]
        return int((np.abs(words - BAD).max(axis=2) < 12).sum())

    middle = render_clip(scene, episode, result, trace, title="oracle", most_frames=4).poster
    only = msgspec.structs.replace(trace, poses=trace.poses[:1], actions=())
    last = render_clip(scene, episode, result, only, title="oracle").poster
    assert red(middle) == 0 and red(last) > 20
