"""One picture of a scene: plan, bird's-eye view, four views and the numbers that matter."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from gn0.counted import counted
from gn0.geometry import Pose2D, view_from_pose
from gn0.render.bev import render_bev
from gn0.render.camera import Camera
from gn0.render.instance import Instance
from gn0.render.labels import colour_labels
from gn0.render.renderer import Renderer
from gn0.scenes.scene import Scene
from gn0.viewer.floor_plan import INK, MUTED, PAPER, font, plan_bounds, render_plan
from gn0.viewer.viewpoints import EYE, PITCH, choose_viewpoints

_GAP = 16
_TITLE = 74
_VIEWS = 4


def render_sheet(
    scene: Scene,
    renderer: Renderer,
    *,
    width: int = 1920,
    cut_height: float | None = None,
    labels: str = "",
    people: Sequence[Sequence[Instance]] = (),
) -> Image.Image:
    """Plan with rooms and objects, BEV, and four views of a scene.

    Args:
        scene: the scene.
        renderer: a renderer of its splats.
        width: width of the picture [px]; the height follows.
        cut_height: height [m] above which the BEV shows nothing; by default a little below the
            ceiling when it is known, else 2.0.
        labels: "semantic" or "instance": the views show these in false colours.
        people: instances for each view, see `gn0.viewer.bystanders`.
    """
    x0, y0, x1, y1 = plan_bounds(scene)
    column = (width - 3 * _GAP) // 2
    tall = min(max(round(column * (y1 - y0) / (x1 - x0)), 320), round(column * 1.1))
    view_width = (width - (_VIEWS + 1) * _GAP) // _VIEWS
    view_height = round(view_width * 3 / 4)
    height = _TITLE + tall + view_height + 3 * _GAP
    sheet = Image.new("RGB", (width, height), PAPER)
    pen = ImageDraw.Draw(sheet)
    _title(pen, scene, width)
    poses = choose_viewpoints(scene, _VIEWS, renderer=renderer)
    plan = render_plan(scene, column, tall, keep_clear=[(p.x, p.y) for p in poses])
    sheet.paste(plan, (_GAP, _TITLE))
    bev = draw_bev(scene, renderer, column, tall, cut_height)
    sheet.paste(bev, (2 * _GAP + column, _TITLE))
    top = _TITLE + tall + _GAP
    views = render_views(renderer, poses, view_width, view_height, labels=labels, people=people)
    for index, (pose, view) in enumerate(zip(poses, views, strict=True)):
        left = _GAP + index * (view_width + _GAP)
        sheet.paste(view, (left, top))
        _badge(pen, left + 20, top + 20, index + 1)
        _mark(pen, scene, pose, index + 1, column, tall)
    for left in (_GAP, 2 * _GAP + column):
        pen.rectangle((left, _TITLE, left + column, _TITLE + tall), outline=(216, 214, 208))
    return sheet


def _title(pen: ImageDraw.ImageDraw, scene: Scene, width: int) -> None:
    pen.text((_GAP + 2, 14), scene.id[:60], font=font(30), fill=INK)
    categories = len({thing.category for thing in scene.objects})
    size = scene.bounds[1] - scene.bounds[0]
    facts = "   ·   ".join(
        (
            f"{len(scene.gaussians):,} splats",
            f"{scene.grid.free_area:.1f} sq m walkable",
            f"{size[0]:.1f} x {size[1]:.1f} x {size[2]:.1f} m",
            counted(len(scene.rooms), "room"),
            f"{counted(len(scene.objects), 'object')} of {categories} categories",
        )
    )
    pen.text((width - _GAP, 22), facts, font=font(18), fill=INK, anchor="ra")
    licence = _short(scene.licence, 60)
    source = f"{scene.source.kind}: {_short(scene.source.detail, 110)}"
    pen.text(
        (width - _GAP, 48),
        f"{source}   ·   {licence or 'licence not recorded'}",
        font=font(13),
        fill=MUTED,
        anchor="ra",
    )


def _short(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 3].rstrip() + "..."


def draw_bev(
    scene: Scene,
    renderer: Renderer,
    width: int,
    height: int,
    cut_height: float | None = None,
    *,
    look: str = "",
) -> Image.Image:
    """A scene from above, whole, in the middle of a picture of width x height [px].

    `look` is the content hash of the splats of `renderer`, where they are not the scene's own.
    """
    x0, y0, x1, y1 = plan_bounds(scene)
    scale = max((x1 - x0) / width, (y1 - y0) / height)  # metres a pixel
    x, y = (x0 + x1) / 2 - width * scale / 2, (y0 + y1) / 2 - height * scale / 2
    bounds = np.array([[x, y], [x + (width - 0.5) * scale, y + (height - 0.5) * scale]])
    paper = tuple(v / 255 for v in PAPER)
    if cut_height is None:
        ceiling = scene.source.settings.get("ceiling")
        cut_height = min(max(float(ceiling or 2.4) - 0.4, 1.6), 2.2)
    picture = render_bev(
        look or scene.cloud_hash or scene.gaussians.content_hash,
        renderer,
        bounds,
        scale,
        cut_height,
        background=(paper[0], paper[1], paper[2]),
    )
    return Image.fromarray(np.ascontiguousarray(picture.rgb)).resize((width, height))


def render_views(
    renderer: Renderer,
    poses: list[Pose2D],
    width: int,
    height: int,
    pitches: Sequence[float] | None = None,
    labels: str = "",
    people: Sequence[Sequence[Instance]] = (),
) -> list[Image.Image]:
    """A picture [width x height px] from each pose at eye height, smoothed by 1.5 x 1.5 samples.

    `pitches` [rad] say how far up each looks; slightly down when absent. With `labels`, semantic
    or instance, the numbers in false colours instead, one ray a pixel, without `people`, which are
    instances for each view.
    """
    if not poses:
        return []
    camera = Camera.from_hfov(round(width * 1.5), round(height * 1.5), 79.0)
    tilts = [PITCH] * len(poses) if pitches is None else pitches
    views = np.stack(
        [view_from_pose(p.x, p.y, EYE, p.yaw, t) for p, t in zip(poses, tilts, strict=True)]
    )
    if labels:
        camera = Camera.from_hfov(width, height, 79.0)
        numbers = getattr(renderer.render(camera, views, outputs=(labels,)), labels)  # type: ignore[arg-type]
        return [Image.fromarray(colour_labels(picture)) for picture in numbers]
    rgb = renderer.render(camera, views, outputs=("rgb",), parts=people or ()).rgb
    assert rgb is not None
    out = []
    for picture in rgb:
        pixels = picture if picture.dtype == np.uint8 else np.clip(picture * 255 + 0.5, 0, 255)
        image = Image.fromarray(np.ascontiguousarray(pixels, np.uint8))
        out.append(image.resize((width, height), Image.Resampling.LANCZOS))
    return out


def _badge(pen: ImageDraw.ImageDraw, x: float, y: float, number: int) -> None:
    pen.ellipse((x - 13, y - 13, x + 13, y + 13), fill=(206, 66, 52), outline=(255, 255, 255))
    pen.text((x, y), str(number), font=font(16), fill=(255, 255, 255), anchor="mm")


def _mark(
    pen: ImageDraw.ImageDraw, scene: Scene, pose: Pose2D, number: int, column: int, tall: int
) -> None:
    """Where the view is taken from, on the plan: a badge and a wedge along the view."""
    x0, y0, x1, y1 = plan_bounds(scene)
    scale = min(column / (x1 - x0), tall / (y1 - y0))
    px = _GAP + column / 2 + (pose.x - (x0 + x1) / 2) * scale
    py = _TITLE + tall / 2 - (pose.y - (y0 + y1) / 2) * scale
    wedge = [(px, py)]
    for turn in (-0.69, -0.35, 0.0, 0.35, 0.69):
        angle = pose.yaw + turn
        wedge.append((px + 30 * math.cos(angle), py - 30 * math.sin(angle)))
    pen.polygon(wedge, fill=(240, 176, 166), outline=(206, 66, 52))
    _badge(pen, px, py, number)
