"""One picture of a corpus: every scene from above, by split."""

from __future__ import annotations

from pathlib import Path

from PIL import Image, ImageDraw

from gn0.counted import counted
from gn0.progress import Progress, no_progress
from gn0.render.open import build_renderer
from gn0.scenes.corpus import CorpusFile
from gn0.scenes.folder import load_scene
from gn0.storage import safe_join
from gn0.viewer.floor_plan import INK, MUTED, PAPER, font
from gn0.viewer.scene_sheet import draw_bev

SHOWN = 48  # scenes at most
_TILE, _GAP, _TEXT = 300, 16, 46
_ORDER = ("train", "val_unseen", "test")


def render_corpus(
    corpus: CorpusFile, folder: Path | str, *, width: int = 1920, progress: Progress = no_progress
) -> Image.Image:
    """Bird's-eye views of the scenes of a corpus, training scenes first, at most `SHOWN`.

    Args:
        corpus: what is in it.
        folder: where it lies.
        width: width of the picture [px]; the height follows.
        progress: progress sink.

    Raises:
        StorageError, FormatError: a scene cannot be read.
    """
    scenes = sorted(corpus.scenes, key=lambda s: (_ORDER.index(s.split), s.id))
    left_out = max(len(scenes) - SHOWN, 0)
    scenes = scenes[:SHOWN]
    columns = max(1, (width - _GAP) // (_TILE + _GAP))
    rows = -(-len(scenes) // columns)
    sheet = Image.new("RGB", (width, 64 + rows * (_TILE + _TEXT + _GAP) + _GAP), PAPER)
    pen = ImageDraw.Draw(sheet)
    title = f"{corpus.name}: {counted(len(corpus.scenes), 'scene')}"
    if left_out:
        title += f", {left_out} not shown"
    pen.text((_GAP, 14), title, font=font(28), fill=INK)
    for k, about in enumerate(scenes):
        progress("drawing", k, len(scenes))
        scene = load_scene(safe_join(folder, about.folder))
        view = draw_bev(scene, build_renderer(scene.gaussians), _TILE, _TILE)
        x = _GAP + (k % columns) * (_TILE + _GAP)
        y = 64 + (k // columns) * (_TILE + _TEXT + _GAP)
        sheet.paste(view, (x, y))
        pen.text((x, y + _TILE + 4), about.id[:32], font=font(17), fill=INK)
        words = f"{about.split}   ·   {about.area:.0f} sq m   ·   {about.objects:,} objects"
        pen.text((x, y + _TILE + 26), words, font=font(13), fill=MUTED)
    progress("drawing", len(scenes), len(scenes))
    return sheet
