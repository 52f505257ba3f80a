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


def main(demo: Path, sheets: list[Path]) -> None:
    """Refresh everything."""
    for picture in sorted((demo / "pictures").glob("*.jpg")):
        shutil.copyfile(picture, PICTURES / picture.name)
    shoot(demo / "report.html", PICTURES / "report.jpg", 1300, 1250)
    for sheet in sheets:
        Image.open(sheet).convert("RGB").save(PICTURES / f"{sheet.stem}.jpg", quality=88)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
