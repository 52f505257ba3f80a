"""Following split by level and category: what each word's measures are of, and where they stand."""

from __future__ import annotations

import csv
import io

import msgspec
import numpy as np
import pytest

from gn0.bench.follow_metrics import FollowMetrics, compute_follow_metrics
from gn0.bench.follow_record import FollowRecord
from gn0.bench.follow_split import split_following, split_tables
from gn0.bench.results import EpisodeResult
from gn0.bench.spreadsheet import render_csv
from gn0.missions.episode import Episode, MissionFollow


def walk(following: int, steps: int = 50) -> FollowMetrics:
    """Somebody who follows 1.5 m behind for so many steps of 0.2 s, then has its back turned."""
    yaw = np.r_[np.zeros(following + 1), np.full(steps - following, np.pi)]
    x = np.arange(steps + 1) * 0.1
    return compute_follow_metrics(
        FollowRecord(
            poses=np.column_stack([x, np.zeros(steps + 1), yaw]),
            people=np.column_stack([x + 1.5, np.zeros(steps + 1)])[None],
            actions=np.ones(steps, np.int8),
            target=0,
            hits=np.full(steps, -1),
            step_seconds=0.2,
            over_at=steps * 0.2 - 3.0,
            preferred=1.5,
            reference_steps=steps,
        )
    )


def followed(name: str, level: str, category: str, following: int) -> tuple[Episode, EpisodeResult]:
    mission = MissionFollow(
        goal=(1.0, 0.0), instruction="Follow her.", human="drawn:0:1", person=1,
        level=level, category=category,  # type: ignore[arg-type]
    )  # fmt: skip
    episode = Episode(
        id=name, scene_id="flat", mission=mission, start=(0.0, 0.0, 0.0), path=((0.0, 0.0),)
    )
    result = EpisodeResult(
        episode=name, scene="flat", status="valid", stopped=False, follow=walk(following)
    )
    return episode, result


PLAYED = [
    followed("a", "ambiguous", "turn", 50),
    followed("b", "single", "cruise", 50),
    followed("c", "ambiguous", "cruise", 10),
    followed("d", "", "cruise", 0),
]


def test_each_word_has_the_measures_of_its_episodes() -> None:
    episodes = {e.id: e for e, _ in PLAYED}
    found = split_following((r for _, r in PLAYED), episodes)
    assert isinstance(found, dict)
    assert list(found) == ["level", "category"]
    assert list(found["level"]) == ["single", "ambiguous", "not told"]
    assert list(found["category"]) == ["cruise", "turn"]
    assert found["level"]["ambiguous"]["SR"].count == 2
    assert found["level"]["ambiguous"]["SR"].mean == 0.5
    assert found["level"]["ambiguous"]["TR_pooled"].mean == pytest.approx(60 / 100)
    assert found["category"]["cruise"]["TR_pooled"].mean == pytest.approx(60 / 150)
    nobody = [msgspec.structs.replace(r, follow=msgspec.UNSET) for _, r in PLAYED]
    assert split_following(nobody, episodes) is msgspec.UNSET


def test_a_table_has_every_word_that_some_run_has() -> None:
    episodes = {e.id: e for e, _ in PLAYED}
    first = split_following([PLAYED[0][1]], episodes)
    second = split_following([PLAYED[1][1]], episodes)
    assert isinstance(first, dict) and isinstance(second, dict)
    level, category = split_tables([first, None, second])
    assert [word for word, _ in level["rows"]] == ["single", "ambiguous"]
    assert [cell is None for cell in level["rows"][0][1]] == [True, True, False]
    assert [word for word, _ in category["rows"]] == ["cruise", "turn"]
    assert split_tables([None]) == []


def test_the_spreadsheet_says_level_and_category() -> None:
    table = render_csv([("me", [r for _, r in PLAYED])], {e.id: e for e, _ in PLAYED})
    rows = list(csv.DictReader(io.StringIO(table.decode())))
    told = [(row["follow_level"], row["follow_category"]) for row in rows]
    assert told[0] == ("ambiguous", "turn") and told[3] == ("not told", "cruise")
    assert rows[0]["follow_success"] == "1" and rows[0]["follow_steps"] == "50"
