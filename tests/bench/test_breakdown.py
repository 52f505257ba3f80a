"""What a report breaks down and gives away: histograms by length and category, the CSV table."""

from __future__ import annotations

import csv
import io

import msgspec
import pytest

from gn0.bench.breakdown import BINS, CATEGORIES, split_categories, split_lengths, split_tiers
from gn0.bench.metrics import EpisodeMetrics
from gn0.bench.results import EpisodeResult
from gn0.bench.spreadsheet import COLUMNS, render_csv
from gn0.missions.episode import AgentSpec, Episode, MissionGoal


def result(name: str, length: float | None, success: bool = True, spl: float = 1.0):
    if length is None:
        return EpisodeResult(episode=name, scene="s", status="failed", reason="took too long")
    metrics = EpisodeMetrics(
        steps=7, trajectory_length=length, shortest_length=length, navigation_error_euclid=0.5,
        navigation_error_geodesic=0.1 + 0.2, success=success, success_euclid=success,
        oracle_success=success, spl=spl, ndtw=0.5, sdtw=0.5, collisions=0, collision_rate=0.0,
    )  # fmt: skip
    return EpisodeResult(episode=name, scene="s", status="valid", metrics=metrics)


def episode(name: str, category: str, instruction: str = "Go there.") -> Episode:
    mission = MissionGoal(goal=(1.0, 0.0), object_id="", category=category, instruction=instruction)
    return Episode(
        id=name, scene_id="s", mission=mission, start=(0.0, 0.0, 0.0),
        path=((0.0, 0.0), (1.0, 0.0)), agent=AgentSpec(),
    )  # fmt: skip


def test_every_scored_episode_is_in_one_bar_of_length() -> None:
    lengths = [0.0, 1.99, 2.0, 5.5, 15.999, 16.0]
    one = [result(str(i), length, success=i < 3) for i, length in enumerate(lengths)]
    one.append(result("x", None))
    two = [result("0", 5.9, success=False, spl=0.0)]
    bars = split_lengths([one, two])
    assert len(bars) <= BINS and bars[0].label == "0–5 m" and bars[-1].label == "15–20 m"
    counts = [[share.count if share else 0 for share in bar.shares] for bar in bars]
    assert counts == [[3, 0], [1, 1], [0, 0], [2, 0]]
    assert bars[0].shares[0].success == 1.0 and bars[1].shares[1].success == 0.0
    assert split_lengths([[result("x", None)]]) == []


@pytest.mark.parametrize("longest", [0.0, 0.05, 1.0, 7.999999, 8.0, 80.0, 799.9, 1e5])
def test_there_are_never_more_bars_than_a_page_has_room_for(longest: float) -> None:
    bars = split_lengths([[result("a", 0.0), result("b", longest)]])
    assert 1 <= len(bars) <= BINS
    assert sum(bar.shares[0].count for bar in bars if bar.shares[0]) == 2


def test_rare_categories_stand_together_and_nobody_is_lost() -> None:
    names = [f"thing {i:02d}" for i in range(CATEGORIES + 4)] + ["sofa", "sofa"]
    episodes = {str(i): episode(str(i), name) for i, name in enumerate(names)}
    bars = split_categories([[result(key, 3.0) for key in episodes]], episodes)
    assert len(bars) == CATEGORIES and bars[0].label == "sofa" and bars[0].shares[0].count == 2
    assert bars[-1].label.endswith("others")
    assert sum(bar.shares[0].count for bar in bars) == len(names)


def test_a_table_is_cut_by_the_tier_of_goals() -> None:
    """With tiers by two bars that hold every scored episode, without any by none."""
    tiers = {"a": "visible from above", "b": "", "c": "visible from above", "d": ""}
    episodes = {k: msgspec.structs.replace(episode(k, "sofa"), tier=t) for k, t in tiers.items()}
    run = [result("a", 3.0), result("b", 3.0, False), result("c", 3.0, False), result("d", None)]
    bars = split_tiers([run], episodes)
    assert [(bar.label, bar.shares[0].count, bar.shares[0].success) for bar in bars] == [
        ("visible from above", 2, 0.5),
        ("others", 1, 0.0),
    ]
    rows = list(csv.DictReader(io.StringIO(render_csv([("x", run)], episodes).decode())))
    assert [row["tier"] for row in rows] == list(tiers.values())
    assert split_tiers([run[1:2]], episodes) == []


def test_the_csv_gives_numbers_in_full_and_no_formula() -> None:
    episodes = {
        "a": episode("a", "sofa", '=HYPERLINK("http://x","y"), then, "stop"\nthere'),
        "b": episode("b", "@SUM(1)"),
    }
    table = render_csv([("+mine", [result("a", 4.0, False, 0.0), result("b", None)])], episodes)
    rows = list(csv.DictReader(io.StringIO(table.decode(), newline="")))
    assert tuple(rows[0]) == COLUMNS and len(rows) == 2
    assert rows[0]["policy"] == "'+mine" and rows[0]["instruction"].startswith("'=HYPERLINK")
    assert rows[1]["category"] == "'@SUM(1)" and rows[1]["reason"] == "took too long"
    assert float(rows[0]["navigation_error_geodesic"]) == 0.1 + 0.2
    assert rows[0]["success"] == "0" and rows[1]["success"] == ""
