"""The report: one file, whole in itself, that a stock browser shows and no data can take over."""

from __future__ import annotations

import base64
import html
import itertools
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.bench.episode_clip import choose_frames
from gn0.bench.report import choose_videos, load_run, write_report
from gn0.bench.report_maps import CELL, MapWindow, fit_view, path_marks, simplify
from gn0.bench.results import EpisodeResult
from gn0.bench.runner import run_suite
from gn0.errors import BenchError, StorageError
from gn0.maps.goal_places import GoalSet
from gn0.render.video import VP9, encode_video
from gn0.scenes.folder import load_scene
from gn0.suites.suite import Suite, build_suite, save_suite
from gn0_trials.browser import open_browser, why_no_browser

pytestmark = pytest.mark.usefixtures("workers_here")

CHROMIUM = next(
    (p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None
)
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
needs_driver = pytest.mark.skipif(bool(why_no_browser()), reason=why_no_browser())


@pytest.fixture(scope="module")
def runs(flats_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The oracle and chance over six episodes of one flat."""
    root = tmp_path_factory.mktemp("runs")
    for name in ("oracle", "random"):
        run_suite(flats_suite, name, root / name, max_episodes=6)
    return [root / "oracle", root / "random"]


@pytest.fixture(scope="module")
def page(runs: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both policies side by side, with a clip each."""
    return write_report(runs, tmp_path_factory.mktemp("page") / "report.html", videos=1)


class Tags(HTMLParser):
    """All tags with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def test_it_is_one_file_that_asks_for_nothing(page: Path) -> None:
    text = page.read_text()
    tags = Tags(text).found
    for tag, attributes in tags:
        for name in ("src", "href", "xlink:href", "action", "data", "poster", "srcset"):
            value = attributes.get(name)
            assert value is None or value.startswith(("data:", "#")), (tag, name, value[:40])
        assert "style" not in attributes and not any(a.startswith("on") for a in attributes)
    assert [t for t, _ in tags].count("script") == 1 and [t for t, _ in tags].count("style") == 1
    assert "@import" not in text and "url(" not in text
    policy = next(a["content"] for t, a in tags if a.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None and policy.startswith("default-src 'none'")
    assert "unsafe" not in policy and "http" not in policy and "*" not in policy


def test_it_shows_every_episode_of_every_policy_failures_first(page: Path) -> None:
    rows = [a for t, a in Tags(page.read_text()).found if t == "tr" and "data-rank" in a]
    assert len(rows) == 12
    ranks = [int(a["data-rank"] or 9) for a in rows]
    assert ranks == sorted(ranks) and ranks[0] == 2 and ranks[-1] == 3
    assert {a["data-run"] for a in rows} == {"0", "1"}


def test_it_tells_intervals_protocol_and_both_errors(page: Path, runs: list[Path]) -> None:
    text = html.unescape(page.read_text())
    summary = load_run(runs[0]).summary
    assert summary.suite_hash in text
    for key, how in summary.protocol:
        assert key in text and how in text
    assert "never acts for the agent" in text and "no sliding" in text
    for word in ("NE geo", "NE euclid", "95 %", "side by side", "oracle", "random"):
        assert word in text
    mean = summary.metrics["NE_geo"]
    assert f"{mean.low:.2f}–{mean.high:.2f}" in text
    success = summary.metrics["SR"]
    assert success.high == 1.0
    assert f">{100 * success.low:.1f}–100<" in text, (
        "100.0–100.0 in every cell is wider than a page"
    )


def test_the_same_runs_give_the_same_report(runs: list[Path], page: Path, tmp_path: Path) -> None:
    again = write_report(runs, tmp_path / "again.html", videos=1)
    assert again.read_bytes() == page.read_bytes()


def test_it_offers_the_table_as_csv_and_says_how_to_open_an_episode(
    runs: list[Path], page: Path
) -> None:
    tags = Tags(page.read_text()).found
    link = next(a for t, a in tags if t == "a" and a.get("download"))
    kind, _, body = str(link["href"]).partition(",")
    assert kind.startswith("data:text/csv") and link["download"] == "episodes.csv"
    lines = base64.b64decode(body).decode().splitlines()
    assert len(lines) == 13 and lines[0].startswith("policy,episode,scene")
    folders = json.loads(next(a["data-folders"] or "" for _, a in tags if "data-folders" in a))
    assert [(page.parent / way).resolve() for way in folders] == [run.resolve() for run in runs]
    classes = [a.get("class") for t, a in tags if t == "button"]
    assert classes.count("view") == 12
    assert [a.get("class") for t, a in tags if t == "table"].count(
        "breakdown"
    ) == 3  # length, category, tier


def test_it_lands_beside_the_run_and_says_what_is_missing(
    runs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = Path(shutil.copytree(runs[1], tmp_path / "alone"))
    assert write_report(alone, videos=0) == alone / "report.html"
    (alone / "run.json").write_text('{"suite_folder": "/nowhere", "suite_relative": "../gone"}')
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "of-another-person"))
    with pytest.raises(BenchError, match=r"is not known here .* '/nowhere' \(name .* --suite DIR"):
        write_report(alone)
    with pytest.raises(StorageError, match=r"summary\.json"):
        write_report(tmp_path)
    with pytest.raises(BenchError, match="no run given"):
        write_report([])


def test_runs_of_two_suites_do_not_share_a_page(
    runs: list[Path], flat_folder: Path, tmp_path: Path
) -> None:
    other = build_suite([flat_folder], tmp_path / "suite", 1)
    run_suite(other, "random", tmp_path / "run")
    with pytest.raises(BenchError, match="another suite"):
        write_report([runs[0], tmp_path / "run"], tmp_path / "r.html")


def test_failed_and_invalid_episodes_come_first_and_are_counted(
    runs: list[Path], tmp_path: Path
) -> None:
    run = Path(shutil.copytree(runs[1], tmp_path / "run"))
    about = (run / "run.json").read_text()
    (run / "run.json").write_text(about.replace('"suite_relative": "', '"suite_relative": "x'))
    lines = (run / "results.jsonl").read_bytes().splitlines()
    broken = msgspec.json.decode(lines[0], type=EpisodeResult)
    broken = EpisodeResult(
        episode=broken.episode, scene=broken.scene, status="failed", reason="took longer than 9 s"
    )
    lines[0] = msgspec.json.encode(broken)
    (run / "results.jsonl").write_bytes(b"\n".join(lines) + b"\n")
    summary = load_run(run).summary
    summary = msgspec.structs.replace(summary, valid=5, failed=(broken,))
    (run / "summary.json").write_bytes(msgspec.json.encode(summary))
    text = write_report(run, videos=0).read_text()
    rows = [a for t, a in Tags(text).found if t == "tr" and "data-rank" in a]
    assert rows[0]["data-outcome"] == "failed"
    assert "took longer than 9 s" in text and "1 of\n6 episodes have no score" in text


HOSTILE = [
    "<script>document.documentElement.dataset.pwned='1'</script>",
    "<img src=x onerror=\"document.documentElement.dataset.pwned='2'\">",
    '"><svg onload="document.documentElement.dataset.pwned=\'3\'">',
    "</style></script><script>document.documentElement.dataset.pwned='4'</script>",
    "' onmouseover='document.documentElement.dataset.pwned=5' autofocus onfocus='x",
    '{{ 7*191 }}{% raw %}<iframe srcdoc="<script>parent.document.documentElement.dataset.pwned=6'
    '</script>">',
    "<svg><script>document.documentElement.dataset.pwned='7'</script></svg>",
    "<svg><animate onbegin=document.documentElement.dataset.pwned=8 attributeName=x dur=1s>",
    "<math><mtext><style><img src=x onerror=document.documentElement.dataset.pwned=9></style>",
    "<a href='javascript:document.documentElement.dataset.pwned=10' autofocus>x</a>",
    "javascript:document.documentElement.dataset.pwned=11",
    "data:text/html,<script>document.documentElement.dataset.pwned=12</script>",
    "<base href='javascript:document.documentElement.dataset.pwned=13//'>",
    "<meta http-equiv=refresh content='0;javascript:document.documentElement.dataset.pwned=14'>",
    "<style>*{background:url(javascript:document.documentElement.dataset.pwned=15)}</style>",
    "x}</style><style>body{display:none}#x{",
    "expression(document.documentElement.dataset.pwned=16)",
    "<details open ontoggle=document.documentElement.dataset.pwned=17><summary>x",
    "<template><script>document.documentElement.dataset.pwned=18</script></template>",
    "<noscript><p title='</noscript><img src=x onerror=document.documentElement.dataset.pwned=1>'>",
    "<!--<img src='--><img src=x onerror=document.documentElement.dataset.pwned=20>'-->",
    "]]><script>document.documentElement.dataset.pwned='21'</script><![CDATA[",
    "<scr<script>ipt>document.documentElement.dataset.pwned='22'</scr</script>ipt>",
    "\u003cscript\u003edocument.documentElement.dataset.pwned='23'\u003c/script\u003e",
    "\\u003cimg src=x onerror=document.documentElement.dataset.pwned=24\\u003e",
    "&lt;script&gt;document.documentElement.dataset.pwned=25&lt;/script&gt;",
    "\u202etpircs\u202c<script>document.documentElement.dataset.pwned='26'</script>",
    "${document.documentElement.dataset.pwned=27}`;document.documentElement.dataset.pwned=28;`",
    "');document.documentElement.dataset.pwned=29;('",
    "</video><video src=x onerror=document.documentElement.dataset.pwned=30 autoplay>",
    "</title><textarea><object data='javascript:document.documentElement.dataset.pwned=31'>",
    "\x1b]0;owned\x07\x1b[2J\x08\ufeff\u2028😀",
]


@pytest.fixture(scope="module")
def hostile_page(
    flats_suite: Suite, flat_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A report of a suite whose every name is an attack."""
    root = tmp_path_factory.mktemp("hostile")
    own = [e for e in flats_suite.episodes if e.scene_id == "flat"]
    episodes = [
        msgspec.structs.replace(
            e,
            id=attack.replace("/", "∕").replace("\\", "⧵"),
            split=attack,
            mission=msgspec.structs.replace(e.mission, instruction=attack, category=attack),
        )
        for e, attack in zip(itertools.cycle(own), HOSTILE, strict=False)
    ]
    suite = save_suite(
        root / "suite", [load_scene(flat_folder)], episodes, name=HOSTILE[3], version=HOSTILE[1],
        max_steps=60,
    )  # fmt: skip
    run_suite(suite, "random", root / "run")
    summary = json.loads((root / "run" / "summary.json").read_text())
    summary["policy"] = HOSTILE[0]  # whoever hands the folder on can write what they like
    summary["protocol"] += [[attack, attack] for attack in HOSTILE]
    (root / "run" / "summary.json").write_text(json.dumps(summary))
    return write_report(root / "run", videos=1)


def test_hostile_names_are_text(hostile_page: Path) -> None:
    text = hostile_page.read_text()
    tags = Tags(text).found
    assert [t for t, _ in tags].count("script") == 1
    assert not {"img", "iframe", "object", "embed", "base", "form", "link"} & {t for t, _ in tags}
    for _, attributes in tags:
        assert not any(name.startswith("on") for name in attributes)
    shown = re.sub(r"data:[^\"]+", "", text)
    assert not re.search(r"(?<![\d.])1337(?![\d.])", shown), "no template runs inside data"
    assert html.escape(HOSTILE[0], quote=False).split("'")[0] in text


FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    "--host-resolver-rules=MAP * ~NOTFOUND",
)


def browse(page: Path, tmp_path: Path) -> str:
    """The page's DOM after its scripts ran in headless Chromium, network refused."""
    assert CHROMIUM is not None
    result = subprocess.run(
        [
            *(CHROMIUM, *FLAGS, f"--user-data-dir={tmp_path / 'profile'}"),
            *("--virtual-time-budget=4000", "--dump-dom", page.as_uri()),
        ],
        capture_output=True,
        timeout=120,
        check=False,
    )
    return result.stdout.decode("utf-8", "replace")


@pytest.mark.browser
@needs_browser
@pytest.mark.parametrize("with_policy", [True, False])
def test_hostile_names_run_no_script_even_without_the_content_policy(
    hostile_page: Path, tmp_path: Path, with_policy: bool
) -> None:
    text = hostile_page.read_text()
    if not with_policy:
        text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    page = tmp_path / "page.html"
    page.write_text(text)
    dom = browse(page, tmp_path)
    count = len(HOSTILE)
    assert f"{count} of {count}</output>" in dom, "our own script did run"
    assert "data-pwned" not in dom
    assert dom.count("<style") == 1, "and no style came in with the data"


PROBE = """
(async () => {
  const said = {};
  const bodyRows = (more) => document.querySelectorAll("#episode-table tbody tr" + more);
  const find = document.getElementById("find");
  find.value = "sofa"; find.dispatchEvent(new Event("input"));
  said.found = bodyRows(":not([hidden])").length;
  find.value = ""; find.dispatchEvent(new Event("input"));
  const head = document.querySelector('th[data-sort="ne"]');
  const order = () => Array.from(bodyRows(""), (row) => Number(row.dataset.ne));
  head.click(); const up = order();
  head.click(); const down = order();
  said.up = up.every((v, i) => !i || up[i - 1] <= v);
  said.down = down.every((v, i) => !i || down[i - 1] >= v);
  said.map = document.querySelector(".map svg use").getBBox().width;
  document.querySelector(".map svg").dispatchEvent(new Event("click"));
  said.dialog = document.getElementById("closer").open;
  document.getElementById("closer").close();
  const video = document.querySelector("video");
  video.muted = true;
  await video.play();
  for (let i = 0; i < 100 && video.currentTime < 0.4; i++) {
    await new Promise((done) => setTimeout(done, 100));
  }
  said.time = video.currentTime;
  const canvas = document.createElement("canvas");
  canvas.width = said.width = video.videoWidth;
  canvas.height = said.height = video.videoHeight;
  const pen = canvas.getContext("2d");
  pen.drawImage(video, 0, 0);
  said.colours = new Set(pen.getImageData(0, 0, canvas.width, canvas.height).data).size;
  return JSON.stringify(said);
})()
"""


def evaluate(page: Path, script: str, width: int = 960) -> str:
    """The string that a script returns in a page, network refused."""
    with open_browser(width=width, flags=("--host-resolver-rules=MAP * ~NOTFOUND",)) as browser:
        browser.navigate(page.as_uri())
        browser.wait_for("document.querySelector('footer') && document.readyState === 'complete'")
        said = str(browser.evaluate(script))
        assert browser.failures == []
        return said


WIDE = """
(async () => {
  for (const cell of document.querySelectorAll("#episode-table td.number")) {
    if (cell.colSpan > 1) continue;
    const small = cell.querySelector(".interval");
    cell.firstChild.textContent = small ? "1128.27" : "10000";
    if (small) small.textContent = "1128.27 shortest";
  }
  for (const small of document.querySelectorAll(".task .quiet")) {
    small.textContent = "a_policy_with_a_long_name · an_episode_with_a_long_name_000123";
  }
  const cut = [];
  for (const box of document.querySelectorAll(".scroll, html")) {
    if (box.scrollWidth > box.clientWidth) cut.push([box.scrollWidth, box.clientWidth]);
  }
  const map = document.querySelector(".map svg").getBoundingClientRect();
  document.querySelector(".view").click();
  return JSON.stringify({
    cut, page: document.documentElement.clientWidth, map: map.width,
    command: document.getElementById("command").textContent,
  });
})()
"""


@pytest.mark.browser
@needs_driver
def test_no_column_is_cut_at_1400_px(page: Path, runs: list[Path]) -> None:
    said = json.loads(evaluate(page, WIDE, width=1400))
    assert 1380 <= said["page"] <= 1400 and said["cut"] == [] and said["map"] >= 200
    episode = next(iter(load_run(runs[1]).results)).episode.rpartition("_")[0]
    command = said["command"].split()
    assert command[:4] == ["gn0", "view", *map(str, runs)] and f"--episode={episode}" in command[4]


@pytest.mark.browser
@needs_driver
def test_it_works_in_a_stock_browser_under_its_own_policy(page: Path) -> None:
    """Filter, sort, enlarge and play, on the very file that a user opens from disk."""
    said = json.loads(evaluate(page, PROBE))
    text = page.read_text()
    sofas = text.count('<span class="instruction">Go to the sofa')
    assert said["found"] == sofas and 0 < sofas < 12
    assert said["up"] and said["down"] and said["dialog"]
    assert said["map"] > 50
    assert said["time"] >= 0.4, "the clip plays"
    assert said["width"] > 300 and said["height"] > 200
    assert said["colours"] > 50, "and is not blank"


def test_clips_show_failures_and_successes() -> None:
    def result(name: str, success: bool, length: float) -> EpisodeResult:
        from gn0.bench.metrics import EpisodeMetrics

        metrics = EpisodeMetrics(
            steps=1, trajectory_length=1.0, shortest_length=length, navigation_error_euclid=0.0,
            navigation_error_geodesic=0.0, success=success, success_euclid=success,
            oracle_success=success, spl=0.0, ndtw=0.0, sdtw=0.0, collisions=0, collision_rate=0.0,
        )  # fmt: skip
        return EpisodeResult(episode=name, scene="s", status="valid", metrics=metrics)

    mixed = [
        result("a", True, 5),
        result("b", False, 4),
        result("c", True, 9),
        result("d", False, 8),
    ]
    assert choose_videos(mixed, 2) == ["d", "c"]
    assert choose_videos(mixed, 4) == ["d", "b", "c", "a"]
    assert choose_videos(mixed[::2], 2) == ["c", "a"]
    assert choose_videos(mixed[1::2], 1) == ["d"]
    assert choose_videos([], 3) == [] and choose_videos(mixed, 0) == []


def test_frames_are_spread_evenly_with_both_ends() -> None:
    assert choose_frames(5, 96) == [0, 1, 2, 3, 4]
    spread = choose_frames(501, 96)
    assert len(spread) == 96 and spread[0] == 0 and spread[-1] == 500
    assert set(np.diff(spread)) <= {5, 6}


def test_a_clip_is_vp9_in_mp4_and_decodes_to_what_went_in() -> None:
    import io

    import av

    x = np.linspace(0, 255, 96, dtype=np.uint8)
    frames = [np.stack([np.tile(np.roll(x, 4 * i), (64, 1))] * 3, axis=2) for i in range(10)]
    data = encode_video(frames, 20, 8, VP9)
    with av.open(io.BytesIO(data)) as container:
        assert "mp4" in container.format.name
        stream = container.streams.video[0]
        assert stream.codec_context.name == "vp9"
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert len(decoded) == 10
    error = np.abs(decoded[4].astype(int) - frames[4].astype(int))
    assert np.median(error) <= 6


@pytest.mark.parametrize("size", [(40.0, 3.0), (3.0, 40.0), (10.0, 8.0), (8.0, 11.0), (60.0, 6.0)])
def test_a_thin_plan_fills_its_cell_and_shows_the_whole_episode(size: tuple[float, float]) -> None:
    window = MapWindow(-2.0, 1.0, -2.0 + size[0], 1.0 + size[1])
    share = np.linspace(0.35, 0.5, 9)[:, None]
    points = np.array([-2.0, 1.0]) + share * np.array(size)
    view = fit_view(window, points)
    left, top, width, height = map(float, view.box.split())
    shape = width / height * CELL[1] / CELL[0]
    assert min(shape, 1 / shape) >= 0.45, "less than half of the cell is used"
    whole = [float(number) for number in view.whole.split()]
    assert left >= 0 and top >= 0
    assert left + width <= whole[2] + 0.1 and top + height <= whole[3] + 0.1
    spots = window.place(points)
    if view.turn:
        spots = np.column_stack([spots[:, 1], window.size[0] - spots[:, 0]])
    assert (spots >= (left - 0.1, top - 0.1)).all()
    assert (spots <= (left + width + 0.1, top + height + 0.1)).all()


def test_maps_are_drawn_at_their_own_size(page: Path) -> None:
    """A browser gives a symbol the size of the view else: turned maps fell out of their cells."""
    text = page.read_text("utf-8")
    sizes = dict(re.findall(r'<symbol id="([^"]+)" viewBox="0 0 ([^"]+)"', text))
    used = re.findall(r'<use href="#([^"]+)"([^>]*)/>', text)
    assert used and sizes
    for symbol, told in used:
        width, height = map(float, sizes[symbol].split())
        assert told.split() == [f'width="{width:.1f}"', f'height="{height:.1f}"']


def test_map_drawing_keeps_shape_and_places_north_up() -> None:
    window = MapWindow(-1.0, 2.0, 9.0, 8.0)
    placed = window.place(np.array([(-1.0, 8.0), (9.0, 2.0)]))
    assert placed.tolist() == [[0.0, 0.0], [200.0, 120.0]]
    line = np.array([(0, 0), (1, 0.001), (2, 0), (2, 2), (2.001, 3), (2, 4)])
    assert simplify(line).tolist() == [[0, 0], [2, 0], [2, 4]]
    assert len(simplify(np.zeros((5, 2)))) == 2
    marks = path_marks(
        window, reference=line, path=np.zeros((0, 2)), goal=(1.0, 3.0), collided=(),
        success_radius=3.0,
    )  # fmt: skip
    assert 'class="reference"' in marks and 'class="path"' not in marks
    both = path_marks(
        window, reference=line, path=np.zeros((0, 2)), goal=(1.0, 3.0), collided=(),
        success_radius=3.0, goal_set=GoalSet(points=((1.0, 3.0), (5.0, 4.0))),
    )  # fmt: skip
    assert both.count('<circle class="reach"') == both.count('class="goal other"') == 2
    room = GoalSet(areas=(((0.0, 2.0), (2.0, 2.0), (2.0, 4.0)),))
    inside = path_marks(
        window, reference=line, path=np.zeros((0, 2)), goal=(1.0, 3.0), collided=(),
        success_radius=3.0, goal_set=room,
    )  # fmt: skip
    assert '<polygon class="reach"' in inside and "<circle" not in inside
