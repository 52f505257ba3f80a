"""Frames of LeRobot's videos: shared by episodes of any length, and none that belongs to nobody."""

from __future__ import annotations

from pathlib import Path

import pytest

from gn0.export import lerobot3_reader
from gn0.export.clips import ClipFacts
from gn0.export.faults import Faults
from gn0.export.lerobot3_reader import EpisodeRow, Info, Span

KEY, FPS = "observation.images.goal", 2


def faults_of(
    monkeypatch: pytest.MonkeyPatch, spans: list[tuple[int, int]], frames: int
) -> list[str]:
    """What is said of episodes with these first frames and lengths in one video."""
    rows = [
        EpisodeRow(
            index=number, tasks=["go"], length=length, first=0, data=(0, 0), id=str(number),
            videos={KEY: Span((0, 0), first / FPS, (first + length) / FPS)}, scene="s",
            beside=(), map_size=(1, 1),
        )
        for number, (first, length) in enumerate(spans)
    ]  # fmt: skip
    info = Info("v3.0", len(rows), 0, 1, FPS, "", "", {KEY: {"shape": [8, 16, 3]}}, {})
    facts = ClipFacts(frames=frames, fps=FPS, width=16, height=8, codec="av1")
    monkeypatch.setattr(lerobot3_reader, "inspect_clip", lambda path: facts)
    faults = Faults()
    lerobot3_reader._check_video(KEY, info, rows, Path("d"), faults)
    return faults.found


def test_a_still_picture_is_as_long_as_the_longest_episode_that_shows_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # no goal: frames 0 to 62, shown by a short episode first; a goal of its own behind it
    spans = [(0, 38), (62, 38), (0, 62), (100, 62)]
    assert faults_of(monkeypatch, spans, 162) == []


def test_frames_that_no_episode_shows_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    (fault,) = faults_of(monkeypatch, [(0, 38), (62, 38)], 100)
    assert "frames 38 to 62 belong to nobody" in fault
    (fault,) = faults_of(monkeypatch, [(0, 38)], 40)
    assert "40 frames for 38" in fault
