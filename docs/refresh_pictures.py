"""Copy the demo's pictures into the docs: `make pictures`. A Chromium makes the report's picture.

Usage: refresh_pictures.py DEMO_FOLDER [SCENE_SHEET.png ...]
Sheets of other scenes are kept as docs/pictures/<name>.jpg for the gallery.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

PICTURES = Path(__file__).resolve().parent / "pictures"
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--hide-scrollbars",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def shoot(page: Path, out: Path, width: int, height: int) -> None:
    """A picture of the top of an HTML page."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        sys.stderr.write(f"no Chromium here: {out} is kept as it was\n")
        return
    with tempfile.TemporaryDirectory() as profile:
        png = Path(profile) / "page.png"
        size = [f"--user-data-dir={profile}", f"--window-size={width},{height}"]
        command = [browser, *FLAGS, *size, f"--screenshot={png}", page.resolve().as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        Image.open(png).convert("RGB").save(out, quality=88)


def shoot_view(arguments: list[str], out: Path, keys: str, done: str) -> None:
    """A picture of the live view after some keys, once the page says `done`."""
    from gn0_figures.view import running_view
    from gn0_trials.browser import open_browser, why_no_browser

    if missing := why_no_browser():
        sys.stderr.write(f"{missing}; {out} is kept as it was\n")
        return
    wait = 300.0
    with (
        open_browser(width=1320, height=800) as page,
        running_view(*arguments, "--splats", "120000") as (url, _),
    ):
        page.navigate(url)
        page.wait_for("window.gn0Frames > 0", wait=wait, what="splats drawn")
        page.wait_for("/yaw|outcome/.test(document.body.innerText)", wait=wait, what="the page")
        page.wait_for("document.querySelectorAll('img[src^=blob]').length >= 2", wait=wait)
        for key in keys:
            page.press("Space" if key == " " else f"Key{key.upper()}")
        page.wait_for(done, wait=wait, what=done)
        if " " in keys:
            page.press("Space")
        page.evaluate(
            "document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())"
        )
        frames = page.evaluate("window.gn0Frames")
        page.wait_for(f"window.gn0Frames > {frames} + 3", wait=wait, what="more frames")
        picture = Image.fromarray(page.screenshot())
    picture.quantize(256, kmeans=3).save(out, optimize=True)


def main(demo: Path, sheets: list[Path]) -> None:
    """Refresh everything."""
    for picture in sorted((demo / "pictures").glob("*.jpg")):
        shutil.copyfile(picture, PICTURES / picture.name)
    shoot(demo / "report.html", PICTURES / "report.jpg", 1300, 1250)
    shoot_view(
        [str(demo / "apartment")], PICTURES / "view.png", "iiil",
        "/step 4/.test(document.body.innerText)",
    )  # fmt: skip
    shoot_view(
        [str(demo / "runs" / name) for name in ("oracle", "wall_follower", "random")],
        PICTURES / "replay.png", " ",
        "[...document.querySelectorAll('input')].some(i => +i.value >= 24 && +i.value < 900)",
    )  # fmt: skip
    for sheet in sheets:
        Image.open(sheet).convert("RGB").save(PICTURES / f"{sheet.stem}.jpg", quality=88)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
