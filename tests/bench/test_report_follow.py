"""Episodes of following in the report: tracks in time, the strip of the distance, the numbers."""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec
import numpy as np
import pytest

from gn0.bench import report_follow
from gn0.bench.follow_metrics import FOLLOW_METRICS, compute_follow_metrics, score_steps
from gn0.bench.follow_record import FollowRecord
from gn0.bench.follow_trace import FollowTrace
from gn0.bench.report import load_run, write_report
from gn0.bench.report_follow import distance_strip, spans, track_marks
from gn0.bench.report_maps import MapWindow
from gn0.bench.results import (
    EpisodeTrace,
    aggregate_following,
    load_results,
    load_traces,
    write_lines,
)
from gn0.bench.runner import run_suite
from gn0.cli.result_tables import print_summaries
from gn0.missions.follow_rules import FOLLOW_EVT
from gn0.scenes.folder import load_scene
from gn0.suites.suite import Suite, save_suite
from gn0_trials.browser import open_browser, why_no_browser
from gn0_trials.follow_examples import PICTURE, behind_on, docs_picture, round_the_corner

pytestmark = pytest.mark.usefixtures("workers_here")
needs_driver = pytest.mark.skipif(bool(why_no_browser()), reason=why_no_browser())
WINDOW = MapWindow(0.0, 0.0, 13.0, 12.0)
EVIL = "<script>document.documentElement.dataset.pwned='1'</script>"


class Shapes(HTMLParser):
    """Tag, class and attributes of everything in a piece."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.found.append((tag, given.get("class") or "", given))

    def of(self, kind: str) -> list[dict[str, str | None]]:
        return [given for _, own, given in self.found if own == kind]


def test_spans_are_the_runs_of_what_is_true() -> None:
    assert spans([True, True, False, True]) == [(0, 1), (3, 3)]
    assert spans([False]) == [] and spans([]) == []


def test_the_strip_shows_when_it_followed_and_when_it_did_not() -> None:
    record = round_the_corner()
    steps = score_steps(record)
    shapes = Shapes(str(distance_strip(record, steps)))
    # one loss, as the measures have it, drawn from its first moment to its last
    (loss,) = shapes.of("loss")
    metrics = compute_follow_metrics(record)
    per_second = (720 - 64 - 12) / steps.times[-1]
    assert float(loss["x"] or 0) == pytest.approx(64 + metrics.first_loss * per_second, abs=0.1)
    assert float(loss["width"] or 0) == pytest.approx(
        metrics.recovery_seconds * per_second, abs=0.1
    )
    bars = shapes.of("follows")
    held = sum(float(bar["width"] or 0) for bar in bars) / per_second / 0.2
    assert held == pytest.approx(metrics.following_steps, abs=0.2)
    assert len(shapes.of("distance")) == 2 and len(shapes.of("distance astray")) == 1
    assert not shapes.of("hit") and len(shapes.of("track-over")) == 1
    touched = round_the_corner(touch=True)
    assert len(Shapes(str(distance_strip(touched, score_steps(touched)))).of("hit")) == 1
    theirs = distance_strip(record, score_steps(record, FOLLOW_EVT), FOLLOW_EVT)
    assert Shapes(str(theirs)).of("level touching")


def test_the_plan_shows_who_was_where_when_up_to_the_end() -> None:
    record = round_the_corner(touch=True)
    steps = score_steps(record)
    shapes = Shapes(str(track_marks(WINDOW, record, steps)))
    assert len(shapes.of("person")) == 1 and len(shapes.of("other-person")) == 2
    # 11.8 s: a moment every 2 s, from 0 to 10
    links = shapes.of("link")
    assert len(links) == 6 == len(shapes.of("moment")) == len(shapes.of("moment-person"))
    row = round(4.0 / 0.2)
    for axis, place, flip in (("x", record.poses[row, 0], 1), ("y", record.poses[row, 1], -1)):
        drawn = float(links[2][f"{axis}1"] or 0)
        assert drawn == pytest.approx(20 * place if flip == 1 else 20 * (12.0 - place), abs=0.06)
    (end,) = shapes.of("end")
    last = record.poses[len(steps.times) - 1]
    assert float(end["x"] or 0) + 4 == pytest.approx(20 * last[0], abs=0.06)
    assert len(shapes.of("hit")) == 1


def test_who_stands_is_a_dot_and_needs_no_direction() -> None:
    people = np.zeros((1, 30, 2)) + 3.0
    record = FollowRecord(
        np.zeros((30, 3)), people, np.zeros(29, np.int64), step_seconds=0.2, over_at=1.0
    )
    text = str(track_marks(WINDOW, record, score_steps(record)))
    assert "nan" not in text and not Shapes(text).of("track")
    assert "nan" not in str(distance_strip(record, score_steps(record)))


def test_names_are_text() -> None:
    record = round_the_corner()
    steps = score_steps(record)
    marks = str(track_marks(WINDOW, record, steps, [EVIL, '"><b>', "Ada"]))
    strip = str(distance_strip(record, steps, title='"><script>1</script>'))
    for text in (marks, strip):
        assert not {"script", "b"} & {tag for tag, _, _ in Shapes(text).found}
    assert "Ada" in marks and html.escape(EVIL, quote=False).split("'")[0] in marks


def test_a_trace_keeps_a_record_to_the_bit() -> None:
    for record in (round_the_corner(touch=True), behind_on(np.array([[0.0, 0], [6, 0], [6, 5]]))):
        kept = msgspec.json.encode(FollowTrace.of(record))
        poses = [tuple(pose) for pose in record.poses.tolist()]
        again = msgspec.json.decode(kept, type=FollowTrace).record(poses, record.actions.tolist())
        assert compute_follow_metrics(again) == compute_follow_metrics(record)
        for name, value in vars(record).items():
            np.testing.assert_array_equal(getattr(again, name), value)


def test_the_picture_of_the_page_is_drawn_by_the_code_of_now() -> None:
    assert PICTURE.read_text() == docs_picture(), "run python -m gn0_trials.follow_examples"


@pytest.fixture(scope="module")
def run(flats_suite: Suite, flat_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of which three episodes are made ones of following, one of an evil name."""
    root = tmp_path_factory.mktemp("follow")
    own = [e for e in flats_suite.episodes if e.scene_id == "flat"]
    own = sorted(own, key=lambda e: -len(e.path))[:4]
    own[0] = msgspec.structs.replace(own[0], id=EVIL.replace("/", "∕"))
    suite = save_suite(root / "suite", [load_scene(flat_folder)], own, name="follow")
    summary = run_suite(suite, "oracle", root / "run")
    results, traces = load_results(root / "run"), load_traces(root / "run")
    paths = {e.id: np.array(e.path).reshape(-1, 2) for e in own}
    for i, result in enumerate(results[:3]):
        record = behind_on(paths[result.episode], lost=i == 1)
        results[i] = msgspec.structs.replace(
            result, metrics=None, follow=compute_follow_metrics(record)
        )
        traces[result.episode] = EpisodeTrace(
            episode=result.episode,
            poses=tuple(tuple(pose) for pose in record.poses.tolist()),
            actions=tuple(record.actions.tolist()),
            follow=FollowTrace.of(record),
        )
    write_lines(root / "run" / "results.jsonl", results)
    write_lines(root / "run" / "trajectories.jsonl", (traces[r.episode] for r in results))
    summary = msgspec.structs.replace(summary, following=aggregate_following(results))
    (root / "run" / "summary.json").write_bytes(msgspec.json.encode(summary))
    return root / "run"


def test_the_report_has_following_beside_the_rest(run: Path) -> None:
    summary = load_run(run).summary
    assert isinstance(summary.following, dict) and summary.following["SR"].count == 3
    text = write_report(run, videos=2).read_text()
    shapes = Shapes(text)
    assert sum(own == "strip" for _, own, _ in shapes.found) == 3
    assert sum(own == "person" for _, own, _ in shapes.found) == 6  # on the BEV and on the plan
    assert outcomes_of(shapes, "tr") == ["success"]  # to a goal, in a table of their own
    assert outcomes_of(shapes, "tbody") == ["failure", "success", "success"]
    assert "TR pooled" in text and "off the preferred distance" in text
    captions = re.findall("<caption>(Following by [^<]*)", text)
    assert [words.split(":")[0] for words in captions] == [
        "Following by level", "Following by category",
    ]  # fmt: skip
    assert len(re.findall("<video", text)) == 2
    assert ">★</span>goal" in text  # one leads to a goal
    table = base64.b64decode(re.findall(r'href="data:text/csv[^,]*,([^"]+)"', text)[0]).decode()
    cells = list(csv.DictReader(io.StringIO(table)))
    ends = {row["episode"]: row["follow_end"] for row in cells}
    assert sorted(ends.values()) == ["", "over", "over", "over"]
    assert {row["success"] for row in cells if row["follow_end"]} == {""}


STRIP = """
(() => {
  const box = document.querySelector("svg.strip").getBoundingClientRect();
  const maps = document.querySelector("#follow-table td.map").getBoundingClientRect();
  const drawn = 10 * box.width / 720;
  const name = document.querySelector(".following tbody th[scope=row]");
  const beside = [...document.querySelectorAll(".named")].map((named) => {
    const [dot, word] = [...named.children].map((child) => child.getBoundingClientRect());
    return dot.right <= word.left && dot.bottom > word.top && dot.top < word.bottom;
  });
  const lefts = [...document.querySelectorAll(".split")].map((table) => {
    const at = [...table.querySelectorAll(".key")].map((dot) => dot.getBoundingClientRect().left);
    return at.length ? Math.max(...at) - Math.min(...at) : 0;
  });
  return JSON.stringify([drawn, box.left >= maps.left, getComputedStyle(name).whiteSpace,
    beside, lefts]);
})()
"""


@pytest.mark.skipif(bool(why_no_browser()), reason=why_no_browser())
def test_the_strip_can_be_read_and_a_policys_name_stays_beside_its_dot(run: Path) -> None:
    with open_browser(width=1320) as browser:
        browser.navigate(write_report(run, videos=0).as_uri())
        browser.wait_for("document.querySelector('footer') && document.readyState === 'complete'")
        letters, below, wrap, beside, _ = json.loads(str(browser.evaluate(STRIP)))
    assert letters >= 10.0 and below and wrap == "nowrap" and len(beside) > 3 and all(beside)


@pytest.mark.skipif(bool(why_no_browser()), reason=why_no_browser())
def test_long_names_stand_beside_their_dots_in_every_table(run: Path, tmp_path: Path) -> None:
    """The dot of `wall_follower` stood above it, and dots of one column at two places."""
    again = tmp_path / "again"
    shutil.copytree(run, again)
    about = json.loads((again / "summary.json").read_text())
    (again / "summary.json").write_text(json.dumps(about | {"name": "wall_follower, the second"}))
    page = write_report([run, again], tmp_path / "page.html", videos=0)
    text = page.read_text()
    assert "best mean of a column" in text
    with open_browser(width=1200) as browser:
        browser.navigate(page.as_uri())
        browser.wait_for("document.querySelector('footer') && document.readyState === 'complete'")
        *_, beside, lefts = json.loads(str(browser.evaluate(STRIP)))
    assert len(beside) > 8 and all(beside)
    assert len(lefts) == 2 and max(lefts) < 0.5


def test_numbers_of_a_turned_map_stand_upright() -> None:
    turned = """<svg width="200" height="200"><g transform="translate(0 200) rotate(-90)">
    <text class="second" x="100" y="50">1234</text></g></svg>"""
    if missing := why_no_browser():
        pytest.skip(missing)
    style = (Path(report_follow.__file__).parent / "templates" / "follow.css").read_text()
    page = f"<!doctype html><style>{style}</style>{turned}"
    with open_browser(width=400) as browser:
        browser.navigate(f"data:text/html,{quote(page)}")
        box = "document.querySelector('text').getBoundingClientRect()"
        assert browser.evaluate(f"{box}.width / {box}.height") > 1.5  # wider than high


def outcomes_of(shapes: Shapes, tag: str) -> list[str | None]:
    return [own["data-outcome"] for kind, _, own in shapes.found
            if kind == tag and "data-rank" in own]  # fmt: skip


def table_of(text: str, name: str) -> list[list[str]]:
    """Rows of texts of a table of the page: its heads, then what each cell says first."""
    (table,) = re.findall(rf'<table class="episodes" id="{name}">(.*?)</table>', text, re.DOTALL)
    rows = []
    for row in re.findall(r"<tr[ >](.*?)</tr>", table, re.DOTALL):
        cells = re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL)
        rows.append([re.sub(r"<.*", "", cell, flags=re.DOTALL).strip() for cell in cells])
    return rows


def test_every_measure_stands_under_its_own_head(run: Path, tmp_path: Path) -> None:
    text = write_report(run, tmp_path / "page.html", videos=0).read_text()
    heads, *rows = table_of(text, "follow-table")
    assert heads[4:] == ["TR", "distance", "bearing", "losses", "wrong", "steps"]
    followed = [r.follow for r in load_results(run) if r.follow]
    numbers = {tuple(row[4:]) for row in rows if len(row) == len(heads)}
    assert numbers == {
        (f"{100 * m.following_rate:.1f}", f"{m.distance_error:.2f}", f"{m.bearing:.0f}",
         str(m.losses), f"{100 * m.wrong_person:.1f}", str(m.steps))
        for m in followed
    }  # fmt: skip
    assert len(rows) == 2 * len(followed) == 6  # and a strip below each
    heads, row = table_of(text, "episode-table")
    assert heads[4:] == ["SPL", "NE geo", "TL", "nDTW", "steps", "cut"] and "" not in row[4:]


FULL = """
(() => {
  for (const cell of document.querySelectorAll(".split td.number:not(:nth-child(2))")) {
    cell.innerHTML = '<span class="mean">99.0</span><span class="interval">97.5–100.0</span>';
  }
  const cut = [];
  for (const box of document.querySelectorAll(".scroll, html")) {
    if (box.scrollWidth > box.clientWidth) cut.push([box.innerText.slice(0, 40), box.scrollWidth]);
  }
  const ends = [...document.querySelectorAll("svg.strip")].map(
    (strip) => strip.closest(".scroll").getBoundingClientRect().right
      - strip.getBoundingClientRect().right);
  return JSON.stringify({cut, ends});
})()
"""


@pytest.mark.browser
@pytest.mark.skipif(bool(why_no_browser()), reason=why_no_browser())
@pytest.mark.parametrize("width", [1200, 1600])
def test_tables_and_strips_of_following_fit_their_cards(
    run: Path, tmp_path: Path, width: int
) -> None:
    page = write_report(run, tmp_path / "page.html", videos=0)
    with open_browser(width=width) as browser:
        browser.navigate(page.as_uri())
        browser.wait_for("document.querySelector('footer') && document.readyState === 'complete'")
        said = json.loads(str(browser.evaluate(FULL)))
    assert said["cut"] == [] and len(said["ends"]) == 3 and min(said["ends"]) > 0


def test_a_run_of_following_alone_has_no_heads_of_goals(run: Path, tmp_path: Path) -> None:
    text = write_report(run, tmp_path / "page.html", videos=0).read_text()
    alone = tmp_path / "run"
    shutil.copytree(run, alone)
    results = [r for r in load_results(run) if r.follow]
    write_lines(alone / "results.jsonl", results)
    page = write_report(alone, tmp_path / "alone.html", videos=0).read_text()
    assert 'id="episode-table"' in text and "nDTW" in text
    assert 'id="episode-table"' not in page and 'id="follow-table"' in page
    assert 'data-sort="spl"' not in page and 'data-sort="ne"' not in page


def test_the_terminal_has_a_row_for_each_measure(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    print_summaries([load_run(run).summary])
    said = capsys.readouterr().out
    rows = [line.split() for line in said.splitlines() if line.strip()]
    named = [row[0] for row in rows if row[0] in {info.key for info in FOLLOW_METRICS}]
    assert named == [info.key for info in FOLLOW_METRICS]
    (rate,) = [row for row in rows if row[0] == "SR" and row[1] == "%"]
    assert rate[2] == "66.7"


def test_a_run_without_following_says_nothing_of_it(flats_suite: Suite, tmp_path: Path) -> None:
    run_suite(flats_suite, "oracle", tmp_path / "run", max_episodes=2)
    for name in ("results.jsonl", "trajectories.jsonl", "summary.json"):
        assert "follow" not in (tmp_path / "run" / name).read_text().replace("followed", "")
    assert "TR pooled" not in write_report(tmp_path / "run", videos=0).read_text()


@pytest.mark.browser
@needs_driver
def test_it_works_in_a_browser_and_runs_nobodys_script(run: Path, tmp_path: Path) -> None:
    page = write_report(run, tmp_path / "page.html", videos=0)
    loose = tmp_path / "loose.html"
    loose.write_text(
        re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text())
    )
    script = """
(() => {
  const strip = document.querySelector("svg.strip");
  const said = { width: strip.getBoundingClientRect().width };
  const line = getComputedStyle(strip.querySelector(".distance"));
  said.line = line.strokeWidth; said.fill = line.fill;
  const shown = () => Array.from(
    document.querySelectorAll("#follow-table tbody"), (body) => Number(body.dataset.rate));
  const head = document.querySelector('#follow-table th[data-sort="rate"]');
  head.click(); said.up = shown();
  head.click(); said.down = shown();
  const pick = document.getElementById("pick-outcome");
  pick.value = "failure"; pick.dispatchEvent(new Event("change"));
  said.count = document.getElementById("count").textContent;
  pick.value = ""; pick.dispatchEvent(new Event("change"));
  strip.dispatchEvent(new Event("click"));
  said.open = document.getElementById("closer").open;
  said.large = document.querySelectorAll("#stage svg.strip").length;
  said.maps = document.querySelectorAll("#stage svg").length;
  said.pwned = document.documentElement.dataset.pwned || "";
  return JSON.stringify(said);
})()
"""
    for file in (page, loose):
        with open_browser(width=1280, flags=("--host-resolver-rules=MAP * ~NOTFOUND",)) as browser:
            browser.navigate(file.as_uri())
            browser.wait_for("document.querySelector('footer')")
            said: dict[str, Any] = msgspec.json.decode(str(browser.evaluate(script)))
        assert said["pwned"] == "" and said["open"] and said["large"] == 1 and said["maps"] == 3
        assert said["up"] == sorted(said["up"]) == said["down"][::-1] and len(said["up"]) == 3
        assert said["up"][0] < said["up"][-1] and said["count"] == "1 of 4"
        assert said["width"] > 300 and said["line"] == "2.2px" and said["fill"] == "none"
