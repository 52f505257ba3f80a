"""The live view in a real browser: what is clicked happens, what is hostile does not."""

from __future__ import annotations

import base64
import io
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gn0.bench.replay import replay_run
from gn0.bench.report import load_run
from gn0.bench.runner import run_suite
from gn0.cli.main import main
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.suites.suite import build_suite
from gn0.viewer.live_server import open_server
from gn0.viewer.live_text import name_line, plain
from gn0.viewer.recorded_runs import load_replay
from gn0_figures.view import running_view
from gn0_trials.browser import BrowserPage, open_browser, why_no_browser

pytest.importorskip("viser")
pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.skipif(bool(why_no_browser()), reason=why_no_browser()),
]
HOSTILE = (
    "<script>window.gn0Hacked=1</script>",
    "<img src=x onerror=window.gn0Hacked=1>",
    "<iframe srcdoc='<script>parent.gn0Hacked=1</script>'></iframe>",
    "[click](javascript:window.gn0Hacked=1)",
    '![x](x" onerror="window.gn0Hacked=1)',
    "<svg onload=window.gn0Hacked=1></svg>",
    "</div><style>*{display:none}</style>",
    "{window.gn0Hacked=1} ~~gone~~ __under__ *star* `code` | cell | &lt;b&gt;",
)
BLOBS = """document.querySelectorAll('img[src^="blob:"]')"""
PICTURE = f"""(async () => {{
  let sum = 7;
  for (const image of [...{BLOBS}]) {{
    const bytes = new Uint8Array(await (await fetch(image.src)).arrayBuffer());
    for (const byte of bytes) sum = (sum * 31 + byte) % 2147483647;
  }}
  return sum;
}})()"""


@pytest.fixture(scope="module")
def flat(tmp_path_factory) -> Path:
    """A small scene whose objects and rooms have names with a purpose."""
    folder = tmp_path_factory.mktemp("view") / "flat"
    scene = build_example_scene(spacing=0.1)
    objects = tuple(
        replace_struct(thing, category=HOSTILE[i % len(HOSTILE)])
        for i, thing in enumerate(scene.objects)
    )
    rooms = tuple(
        replace_struct(room, type=HOSTILE[1 + i % 2]) for i, room in enumerate(scene.rooms)
    )
    save_scene(replace(scene, objects=objects, rooms=rooms), folder)
    return folder


def replace_struct(value, **changes):
    import msgspec

    return msgspec.structs.replace(value, **changes)


@pytest.fixture(scope="module")
def page():
    with open_browser(width=720, height=480) as found:
        yield found


def press_button(page: BrowserPage, text: str) -> None:
    """Click a button of the panel, where it is on the page."""
    x, y = page.wait_for(
        f"""(() => {{
            const all = [...document.querySelectorAll('button')];
            const one = all.find(b => b.textContent.trim() === {text!r});
            if (!one) return null;
            one.scrollIntoView({{block: 'center'}});
            const box = one.getBoundingClientRect();
            return [box.x + box.width / 2, box.y + box.height / 2];
        }})()""",
        what=f"a button {text!r}",
    )
    page.click(x, y)


def words(page: BrowserPage) -> str:
    return page.evaluate("document.body.innerText")


def check_eyes(page: BrowserPage) -> None:
    """The canvas is filled by what the agent's own picture shows, and sharper than that is."""
    left, top, width, height = page.evaluate("""(() => {
        const box = [...document.querySelectorAll('canvas')].pop().getBoundingClientRect();
        return [box.x, box.y, box.width, box.height];
    })()""")
    for _ in range(100):
        seen, shot = small_picture(page), page.screenshot()
        whole = shot[int(top) : int(top + height), int(left) : int(left + width)]
        scale = min(whole.shape[1] / seen.shape[1], whole.shape[0] / seen.shape[0])
        w, h = seen.shape[1] * scale, seen.shape[0] * scale
        x, y = (whole.shape[1] - w) / 2, (whole.shape[0] - h) / 2
        own = whole[round(y) : round(y + h), round(x) : round(x + w)]
        size = (seen.shape[1] // 4, seen.shape[0] // 4)
        a, b = (
            np.asarray(Image.fromarray(p).resize(size, Image.Resampling.BOX), float)
            for p in (own, seen)
        )
        a, b = (p[len(p) // 2 :] for p in (a, b))  # viser's own note may cover the upper half
        if np.abs(a - b).mean() < 4:
            break
    else:
        raise AssertionError(f"the canvas shows something else: {np.abs(a - b).mean():.1f}")
    assert (whole.max(axis=2) > 0).mean() > 0.97, "the canvas is not filled"


def small_picture(page: BrowserPage) -> np.ndarray:
    """The agent's picture of the panel."""
    script = f"""(async () => {{
        const bytes = new Uint8Array(await (await fetch({BLOBS}[0].src)).arrayBuffer());
        return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(''));
    }})().catch(() => null)"""  # a newer picture may take its place just then
    data = page.wait_for(script, what="the agent's picture")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))


def test_a_click_moves_the_agent(flat, page):
    with running_view(str(flat), "--splats", "2000") as (url, _):
        page.navigate(url)
        page.wait_for("window.gn0Frames > 0", what="splats drawn")
        page.wait_for("/step 0/.test(document.body.innerText)", what="the agent", wait=120)
        page.wait_for(f"{BLOBS}.length >= 2", what="pictures")
        before, picture = words(page), page.evaluate(PICTURE)
        press_button(page, "left")
        page.wait_for("/step 1: turn left/.test(document.body.innerText)")
        page.wait_for(f"(async () => await {PICTURE} !== {picture})()")
        yaw = [line for line in words(page).splitlines() if "yaw" in line]
        assert yaw and yaw != [line for line in before.splitlines() if "yaw" in line]
        page.press("KeyI")
        page.wait_for("/step 2: forward/.test(document.body.innerText)", what="the key")
        for _ in range(40):
            page.press("KeyI")
        page.wait_for("/Bump/.test(document.body.innerText)", what="a wall")
        page.press("KeyC")
        check_eyes(page)
        assert page.evaluate("window.gn0Hacked") is None
        assert page.failures == [] and page.dialogs == []
        blocked = page.evaluate("""(async () => {
            let found = '';
            addEventListener('securitypolicyviolation', e => found += e.effectiveDirective);
            await fetch('http://127.0.0.2:9/').catch(() => 0);
            const picture = new Image();
            picture.src = 'http://127.0.0.2:9/a.png';
            await new Promise(then => setTimeout(then, 200));
            return found;
        })()""")
        assert "connect-src" in blocked and "img-src" in blocked  # nothing goes elsewhere
        page.failures.clear()  # which the browser reports
        # visitors come and go; the agent stays where it is
        status = [line for line in words(page).splitlines() if "yaw" in line]
        page.navigate("about:blank")
        page.navigate(url)
        page.wait_for("/yaw/.test(document.body.innerText)", what="the page again")
        assert [line for line in words(page).splitlines() if "yaw" in line] == status


def test_hostile_names_are_shown_and_do_not_run(page):
    with open_server(port=0) as live:
        gui = live.viser.gui
        for text in HOSTILE:
            gui.add_markdown("**name:** " + plain(text))
            gui.add_dropdown(name_line(text, 30), [name_line(text), "b"])
        for number, text in enumerate(HOSTILE):
            live.viser.scene.add_label(f"/labels/{number}", name_line(text, 40))
        page.navigate(live.url)
        page.wait_for("document.body.innerText.includes('gn0Hacked')", what="the names")
        page.wait_for(f"document.body.innerText.split('name:').length > {len(HOSTILE)}")
        shown = " ".join(words(page).split())
        for text in HOSTILE:
            assert " ".join(text.split()) in shown
        assert page.evaluate("window.gn0Hacked") is None
        assert page.evaluate("document.querySelectorAll('iframe, svg[onload]').length") == 0
        hrefs = page.evaluate("[...document.querySelectorAll('a')].map(a => a.href)")
        assert not any(href.startswith("javascript:") for href in hrefs)
        assert page.dialogs == []


def test_a_replay_plays_to_its_end(flat, page, tmp_path):
    suite = build_suite([flat], tmp_path / "suite", count=1, seed=1, max_steps=12)
    folders = [tmp_path / "oracle", tmp_path / "random"]
    for folder in folders:
        run_suite(suite, folder.name, folder, workers=1)
    replay = load_replay(folders)
    last = replay.length(replay.episodes[0])
    with running_view(*map(str, folders), "--splats", "2000") as (url, _):
        page.navigate(url)
        page.wait_for("window.gn0Frames > 0", what="splats drawn")
        page.wait_for("/outcome/.test(document.body.innerText)", what="the scores")
        page.wait_for(f"{BLOBS}.length >= 2", what="pictures")
        picture = page.evaluate(PICTURE)
        press_button(page, "Play")
        values = "[...document.querySelectorAll('input')].map(input => input.value)"
        page.wait_for(f"{values}.includes('{last}')", what="the last step")
        page.wait_for("/Play/.test(document.body.innerText)", what="the end")
        page.wait_for(f"(async () => await {PICTURE} !== {picture})()", what="other pictures")
        assert page.failures == []
        assert page.evaluate("window.gn0Hacked") is None


def test_a_link_opens_the_episode_that_it_names(flat, page, tmp_path):
    suite = build_suite([flat], tmp_path / "suite", count=3, seed=1, max_steps=6)
    run_suite(suite, "random", tmp_path / "run", workers=1)
    first, second, third = load_replay([tmp_path / "run"]).episodes
    view = (str(tmp_path / "run"), "--splats", "2000", "--episode", second.id)
    shown = "[...document.querySelectorAll('input')].map(input => input.value).join()"
    with running_view(*view) as (url, _):
        page.navigate(url)
        page.wait_for(f"{shown}.includes({second.id!r})", what="the episode of --episode")
        page.navigate(f"{url}&episode={third.id}")
        page.wait_for(f"{shown}.includes({third.id!r})", what="the episode of the link")
        page.navigate("about:blank")  # the cookie is known now
        page.navigate(f"{url.partition('?')[0]}?episode={first.id}")
        page.wait_for(
            f"{shown}.includes({first.id!r})", what="the episode of a link without secret"
        )
        page.navigate(f"{url}&episode=%3Cscript%3Ewindow.gn0Hacked=1%3C/script%3E")
        page.wait_for("/was not recorded here/.test(document.body.innerText)", what="the reason")
        assert page.evaluate("window.gn0Hacked") is None
        assert page.failures == [] and page.dialogs == []


def test_a_walk_by_hand_is_scored_and_saved_as_a_run(flat, page, tmp_path):
    build_suite([flat], tmp_path / "suite", count=2, seed=1, max_steps=40)
    with running_view(str(tmp_path / "suite"), "--record", str(tmp_path / "hand")) as (url, _):
        page.navigate(url)
        page.wait_for("/step 0 of 40/.test(document.body.innerText)", what="the start", wait=120)
        page.press("KeyJ")
        page.wait_for("/step 1 of 40: turn left/.test(document.body.innerText)", what="a turn")
        press_button(page, "Begin again")
        page.wait_for("/step 0 of 40/.test(document.body.innerText)", what="the start again")
        for _ in range(4):
            page.press("KeyL")
        page.press("KeyI")
        page.wait_for("/step 5 of 40: forward/.test(document.body.innerText)", what="a step")
        press_button(page, "Stop")
        page.wait_for("/1 of 2 episodes are walked/.test(document.body.innerText)", what="a score")
        page.press("KeyN")
        page.wait_for("/step 0 of 40/.test(document.body.innerText)", what="the next episode")
        assert page.evaluate("window.gn0Frames || 0") == 0, "no splats are sent"
        assert page.evaluate("window.gn0Hacked") is None and page.failures == []
    run = load_run(tmp_path / "hand")
    assert run.summary.policy == "human" and run.summary.valid == 1
    (trace,) = run.traces.values()
    assert trace.actions == (3, 3, 3, 3, 1, 0)
    assert run.about["episodes"][trace.episode]["attempts"] == 2
    assert replay_run(tmp_path / "hand", tmp_path / "suite").ok
    walks, out = str(tmp_path / "walks"), str(tmp_path / "streamvln")
    assert main(
        ["data", "dagger", str(tmp_path / "suite"), "--policy", "recorded", "--policy-option",
         f"run={tmp_path / 'hand'}", "--labels", "own", "--beta", "0", "--halting", "none",
         "--out", walks]
    ) == 0  # fmt: skip
    assert main(["export", "streamvln", walks, "--out", out]) == 0
    assert main(["export", "check", out]) == 0


def test_check_ends_by_itself_and_a_stranger_is_told_no(flat):
    done = subprocess.run(
        [sys.executable, "-m", "gn0", "view", str(flat), "--check", "--port", "0"],
        capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "the page is ready" in done.stdout and "?secret=" in done.stdout
