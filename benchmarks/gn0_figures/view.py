"""Figures of the live view, measured in a real headless Chromium without a GPU."""

from __future__ import annotations

import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from gn0.errors import BenchError
from gn0.geometry import U8
from gn0_figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    FigureSkipped,
    row_at_least,
    row_at_most,
)
from gn0_trials.browser import BrowserPage, open_browser, why_no_browser

SPLATS = 30_000
SIZE = (960, 640)  # px
_SECONDS = 6.0  # of turning, a run
_RUNS = 3
_READ = (
    "(() => { const c = [...document.querySelectorAll('canvas')].pop();"
    "const g = c.getContext('webgl2'); g.readPixels(0, 0, 1, 1, g.RGBA, g.UNSIGNED_BYTE,"
    " new Uint8Array(4)); return [performance.now() / 1000, window.gn0Frames || 0]; })()"
)


# counts the canvas's colours, 5 bits a channel, after each frame with splats, until there are many
COLOURS = """(() => {
  window.gn0Colours = 0;
  let frames = 0;
  const look = () => {
    frames = window.gn0Frames;
    const canvas = [...document.querySelectorAll("canvas")].pop();
    const gl = canvas && canvas.width > 9 && canvas.getContext("webgl2");
    if (!gl) return;
    const pixels = new Uint8Array(4 * canvas.width * canvas.height);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    const seen = new Set();
    for (let i = 0; i < pixels.length; i += 4) {
      seen.add(((pixels[i] >> 3) << 10) | ((pixels[i + 1] >> 3) << 5) | (pixels[i + 2] >> 3));
    }
    window.gn0Colours = seen.size;
  };
  const ask = window.requestAnimationFrame;
  window.requestAnimationFrame = (work) => ask.call(window, (time) => {
    work(time);
    if (window.gn0Frames > frames && window.gn0Colours < 200) look();
  });
})();"""


def is_picture(shot: U8) -> bool:
    """Whether a screenshot shows a scene: in its left half many colours, none of them dominant.

    The empty page is one colour there; the splats of a furnished flat are thousands.
    """
    left = shot[:, : shot.shape[1] // 2].astype(np.int32) >> 3
    codes = (left[..., 0] << 10) | (left[..., 1] << 5) | left[..., 2]
    _, counts = np.unique(codes, return_counts=True)
    return len(counts) >= 200 and counts.max() < 0.97 * counts.sum()


@contextmanager
def running_view(*arguments: str) -> Iterator[tuple[str, float]]:
    """A `gn0 view` of its own process: its address, and when it was started."""
    command = [sys.executable, "-m", "gn0", "view", *arguments, "--no-browser", "--port", "0"]
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ})
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        while line and not line.startswith("open "):
            line = process.stdout.readline()
        if not line:
            raise BenchError("the view does not start", remedy="run `gn0 view` by hand")
        yield line.split()[1], start
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(15)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


def wait_for_picture(page: BrowserPage, wait: float = 120.0) -> None:
    """Wait until the canvas holds the scene; needs `COLOURS` prepared."""
    page.wait_for("window.gn0Colours >= 200", wait=wait, what="a picture of the scene")


def confirm_picture(page: BrowserPage, tries: int = 20) -> None:
    """Look at the page itself; it may be laying out its panels just then.

    Raises:
        BenchError: the canvas holds the scene and the page never shows it.
    """
    if not any(is_picture(page.screenshot()) for _ in range(tries)):
        raise BenchError("the canvas shows the scene, the page does not", remedy="take a look")


def turning_rate(page: BrowserPage, seconds: float) -> float:
    """Frames with splats drawn in a second while the camera turns; all work is finished first."""
    page.hold("ArrowRight")
    start = page.evaluate("window.gn0Frames")
    page.wait_for(f"window.gn0Frames > {start} + 2", what="the camera to turn")
    before = page.evaluate(_READ)
    page.evaluate(f"new Promise(done => setTimeout(done, {1000 * seconds:.0f}))")
    after = page.evaluate(_READ)
    page.release("ArrowRight")
    return float((after[1] - before[1]) / (after[0] - before[0]))


def _flat(context: FigureContext) -> Path:
    from gn0.scenes.procedural.generate import GenerateSettings, generate_scene

    folder = context.work / "flat"
    if not folder.exists():
        settings = GenerateSettings(seed=12, size="small", light="draft", density=10_000.0)
        generate_scene(settings, folder, progress=context.progress)
    return folder


def measure_view(context: FigureContext) -> list[FigureRow]:
    """Time from the command to the first picture, and frames a second while turning.

    Raises:
        FileNotFoundError: no viser on this machine.
        FigureSkipped: no Playwright or no Chromium.
    """
    try:
        import viser
    except ImportError:
        raise FileNotFoundError("viser (pip install -e '.[view]')") from None
    if missing := why_no_browser():
        raise FigureSkipped(missing)
    flat = str(_flat(context))
    first, inside, over = [], [], []
    for run in range(_RUNS + 1):  # the first run warms the caches of disk and kernels
        context.progress("live view", run, _RUNS + 1)
        with (
            open_browser(width=SIZE[0], height=SIZE[1]) as page,
            running_view(flat, "--splats", str(SPLATS)) as (url, start),
        ):
            page.prepare(COLOURS)
            page.navigate(url)
            wait_for_picture(page)
            seconds = time.perf_counter() - start
            confirm_picture(page)
            page.wait_for("document.body.innerText.includes('yaw')", what="the agent", wait=120)
            if run:
                first.append(seconds)
                over.append(turning_rate(page, _SECONDS))
                page.press("KeyC")
                page.wait_for(
                    "[...document.querySelectorAll('input')].some(i => i.value.includes('eyes'))",
                    what="the agent's eyes",
                )
                inside.append(turning_rate(page, _SECONDS))
    where = (
        f"apartment seed 12, small, draft light, thinned to {SPLATS:,} splats; page "
        f"{SIZE[0]}x{SIZE[1]}, Chromium with software WebGL2 (SwiftShader), viser "
        f"{viser.__version__}; median of {_RUNS}"
    )
    return [
        row_at_most(
            "first picture after the command",
            statistics.median(first),
            5.0,
            "s",
            f"{where}; browser already running; 200 colours on the canvas, then a look at a "
            "screenshot; kernels compiled before",
        ),
        row_at_least(
            "frames while turning, the whole flat in view",
            statistics.median(over),
            10.0,
            "frames/s",
            f"{where}; splat draw calls over {_SECONDS:g} s with a key held down, the last one "
            "finished",
        ),
        row_at_least(
            "frames while turning, inside a room",
            statistics.median(inside),
            10.0,
            "frames/s",
            f"{where}; at the agent's eyes",
        ),
    ]


FIGURES = [Figure("view.live", "Live view in a browser", measure_view, 3)]
