"""The page of a run holds what the run reported, as text and as lines, and nothing else."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from gn0.cli.main import main
from gn0.training.runs.run_chart import Series, draw_chart
from gn0.training.runs.run_folder import open_run


def _train(folder: Path, *, done: bool = True, name: str = "<b>sft</b>") -> None:
    how = {
        "recipe": {"batch": 4, "plan": {"samples": 9, "note": name}},
        "hashes": {"corpus": "abc"},
    }
    with open_run(
        folder, stage="sft", command=["gn0", "train", "sft"], device="card", processes=4,
        versions={"torch": "2.13"}, **how,
    ) as run:  # fmt: skip
        for step in range(1, 41):
            values = {"loss": 2 / step, "loss_action": 1 / step, "samples": 4.0 * step, "odd": 3.5}
            if step % 20 == 0:
                values |= {"first_action": step / 50, "SR": 0.25, "SR_goal": 0.5, "NE_goal": 1.0}
            if step == 1:
                values |= {"collected": 300032.0, "walks_arrived": 0.7594}
            run.report(step, values)
        run.report(41, {"loss": float("nan"), "samples": 164.0})
        if done:
            run.finish(41, {"SR": 0.25})


def test_a_stage_that_is_done_has_its_page(tmp_path: Path) -> None:
    _train(tmp_path / "run")
    page = (tmp_path / "run" / "page.html").read_text()
    assert (
        "<script" not in page
        and "default-src 'none'" in page
        and "http:" not in page
        and "https:" not in page
    )
    assert "&lt;b&gt;sft&lt;/b&gt;" in page and "<b>sft" not in page
    assert "done at step 41, 164 samples" in page
    captions = re.findall("<figcaption>(.*?)</figcaption>", page)
    assert captions == [
        "loss",
        "first action",
        "success in closed loop",
        "success by mission",
        "odd",
    ]
    once = page[page.index("Reported once") : page.index("Examinations")]
    assert re.findall("<td.*?>(.*?)</td>", once) == [
        "collected", "1", "300,032", "walks arrived", "1", "0.759"
    ]  # fmt: skip
    examined = page[page.index("Examinations") : page.index("Recipe")]
    assert re.findall("<td class=n>(.*?)</td>", examined) == [
        "20", "80", "0.400", "0.250", "40", "160", "0.800", "0.250"
    ]  # fmt: skip
    for told in ("plan.samples", "corpus", "abc", "gn0 train sft", "torch 2.13", "4 × card"):
        assert told in page


def test_a_run_that_goes_on_is_shown_by_command(tmp_path: Path, capsys) -> None:
    _train(tmp_path / "run", done=False)
    assert not (tmp_path / "run" / "page.html").exists()
    assert main(["train", "page", str(tmp_path / "run")]) == 0
    assert capsys.readouterr().out.strip().endswith("run/page.html")
    assert "not finished: step 41" in (tmp_path / "run" / "page.html").read_text()
    assert main(["train", "page", str(tmp_path)]) == 2
    assert "no training run" in capsys.readouterr().err


def test_lines_go_where_their_points_are() -> None:
    chart = draw_chart([Series("a", ((0, 0.0), (5, 1.0), (10, 2.0)))])
    spots = [tuple(map(float, s.split(","))) for s in re.search('points="(.*?)"', chart)[1].split()]
    (x0, y0), (x1, y1), (x2, y2) = spots
    assert x1 - x0 == pytest.approx(x2 - x1, abs=0.2) and y0 > y1 > y2
    assert y0 - y1 == pytest.approx(y1 - y2, abs=0.2)
    many = draw_chart([Series("many", tuple((k, k % 7) for k in range(5000)))])
    assert len(re.search('points="(.*?)"', many)[1].split()) == 300
    assert draw_chart([Series("none", ((1, float("nan")),))]) == "<svg></svg>"
    one = draw_chart([Series("<x>", ((3, 2.0),))])
    assert "circle" in one and "&lt;x&gt;" in one and "nan" not in one
    assert json.dumps(draw_chart([Series("flat", ((1, 0.0), (2, 0.0)))]))


def test_small_numbers_have_room_beside_the_axis() -> None:
    """Seven characters at most: longer ones would begin beyond the picture's edge."""
    for size in (1.13456e-4, 0.0098765, 0.0123456, 1.13456, 113.456, 11345.6, 1.13456e9):
        chart = draw_chart([Series("a", ((0, -size), (5, size)))])
        labels = re.findall('text-anchor="end">(.*?)</text>', chart)
        assert len(labels) >= 2 and max(map(len, labels)) <= 7
        assert any(float(one.rstrip("kMG")) for one in labels)
