"""One picture of a scene in many lights: the same views and map, one row per condition."""

from __future__ import annotations

from collections.abc import Sequence

from PIL import Image, ImageDraw

from gn0.progress import Progress, no_progress
from gn0.render.light import LightCondition, relight_cloud
from gn0.render.open import build_renderer
from gn0.scenes.scene import Scene
from gn0.sim.open import look_hash
from gn0.viewer.floor_plan import INK, MUTED, PAPER, font
from gn0.viewer.scene_sheet import draw_bev, render_views
from gn0.viewer.viewpoints import choose_viewpoints

_GAP, _ROW, _TEXT, _VIEWS = 12, 240, 190, 3


def render_light(
    scene: Scene,
    conditions: Sequence[LightCondition],
    *,
    width: int = 1600,
    progress: Progress = no_progress,
) -> Image.Image:
    """A contact sheet: a row for the scene as it was made, and one for each condition.

    Args:
        scene: the scene.
        conditions: the lights.
        width: width of the picture [px]; the height follows.
        progress: progress sink.
    """
    view_width = (width - _TEXT - (_VIEWS + 2) * _GAP - _ROW) // _VIEWS
    rows = [LightCondition(), *conditions]
    sheet = Image.new("RGB", (width, _GAP + len(rows) * (_ROW + _GAP)), PAPER)
    pen = ImageDraw.Draw(sheet)
    poses = choose_viewpoints(scene, _VIEWS, renderer=build_renderer(scene.gaussians))
    for k, condition in enumerate(rows):
        progress("drawing", k, len(rows))
        renderer = build_renderer(relight_cloud(scene.gaussians, condition))
        top = _GAP + k * (_ROW + _GAP)
        pen.text((_GAP, top + 6), condition.name, font=font(20), fill=INK)
        for line, words in enumerate(describe_light(condition)):
            pen.text((_GAP, top + 38 + 20 * line), words, font=font(14), fill=MUTED)
        look = look_hash(scene, condition)
        sheet.paste(draw_bev(scene, renderer, _ROW, _ROW, look=look), (_TEXT, top))
        for v, view in enumerate(render_views(renderer, poses, view_width, _ROW)):
            sheet.paste(view, (_TEXT + _ROW + _GAP + v * (view_width + _GAP), top))
    progress("drawing", len(rows), len(rows))
    return sheet


def describe_light(condition: LightCondition) -> list[str]:
    """What a condition changes, in words."""
    if condition.is_neutral:
        return ["nothing changed"]
    words = [f"{condition.exposure:+.2f} stops", f"{condition.kelvin:.0f} K"]
    if condition.tint:
        words.append(f"tint {condition.tint:+.2f}")
    if condition.contrast != 1.0:
        words.append(f"contrast {condition.contrast:.2f}")
    if condition.saturation != 1.0:
        words.append(f"saturation {condition.saturation:.2f}")
    return words
