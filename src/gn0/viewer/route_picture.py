"""A route to look at: its steps on the bird's-eye view, and what one sees on the way."""

from __future__ import annotations

import math
import textwrap

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gn0.geometry import Pose2D
from gn0.missions.language.route import Landmark, RouteDescription, RouteSegment
from gn0.render.bev import render_bev
from gn0.render.renderer import Renderer
from gn0.scenes.scene import Scene
from gn0.viewer.floor_plan import INK, PAPER, font
from gn0.viewer.overlay import GOAL, PATH, START
from gn0.viewer.scene_sheet import EYE, PITCH, render_views

_GAP = 12
_CAPTION = 38
_MARGIN = 1.2  # m round the route
_MARK = (206, 66, 52)
_VIEWS_MOST = 8


def render_route(
    scene: Scene,
    renderer: Renderer,
    route: RouteDescription,
    path: NDArray[np.floating],
    start_yaw: float,
    *,
    height: int = 520,
    cut_height: float = 2.0,
) -> Image.Image:
    """A route from above with its numbered steps and landmarks, beside the views on the way.

    Args:
        scene: the scene.
        renderer: a renderer of its splats.
        route: the route, described.
        path: its points [N, 2] m.
        start_yaw: heading at the start [rad].
        height: height of the picture [px]; its width follows.
        cut_height: what lies higher [m] is left out of the BEV.
    """
    p = np.asarray(path, np.float64).reshape(-1, 2)
    above = _draw_above(scene, renderer, route, p, start_yaw, height, cut_height)
    stops = _stops(scene, route, p, start_yaw)
    columns = max(1, math.ceil(len(stops) / 2))
    rows = math.ceil(len(stops) / columns)
    tall = (height - (rows - 1) * _GAP) // rows - _CAPTION
    wide = min(round(tall * 4 / 3), 420)
    tall = round(wide * 3 / 4)
    pitches = [PITCH] * (len(stops) - 1) + [_arrival_pitch(scene, route, stops[-1][0])]
    views = render_views(renderer, [pose for pose, _ in stops], wide, tall, pitches)
    sheet = Image.new("RGB", (above.width + (wide + _GAP) * columns, height), PAPER)
    sheet.paste(above, (0, 0))
    pen = ImageDraw.Draw(sheet)
    for number, ((_, words), view) in enumerate(zip(stops, views, strict=True)):
        left = above.width + _GAP + (number % columns) * (wide + _GAP)
        top = (number // columns) * (tall + _CAPTION + _GAP)
        sheet.paste(view, (left, top + _CAPTION))
        lines = textwrap.wrap(words, max(16, int(wide / 6.6)), max_lines=2, placeholder=" …")
        for line, text in enumerate(lines):
            pen.text((left, top + 10 + 17 * line), text, font=font(13), fill=INK, anchor="lm")
    return sheet


def segment_words(segment: RouteSegment) -> str:
    """A segment in a few words, e.g. "left 85°, at the sofa"."""
    if segment.turn is not None:
        words = f"{segment.turn} {abs(segment.angle):.0f}°"
    else:
        words = f"straight {segment.distance:.1f} m"
        rooms = [segment.inside, *segment.crosses, segment.enters]
        told = list(dict.fromkeys(r for r in rooms if r))
        if told:
            words += f", {' to '.join(told)}"
    return words + (f", {landmark_words(segment.landmarks[0])}" if segment.landmarks else "")


def landmark_words(landmark: Landmark) -> str:
    """A landmark in a few words, e.g. "past sofa (left)"."""
    side = f" ({landmark.side})" if landmark.side else ""
    return f"{landmark.relation} {landmark.name}{side}"


def _stops(
    scene: Scene, route: RouteDescription, path: NDArray[np.float64], start_yaw: float
) -> list[tuple[Pose2D, str]]:
    """Where one looks, and what is said there: each straight at its start, and the arrival."""
    out: list[tuple[Pose2D, str]] = []
    words: list[str] = []
    for number, segment in enumerate(route.segments, 1):
        words.append(f"{number} {segment_words(segment)}")
        if segment.turn is not None:
            continue
        away = np.hypot(*(path - segment.start).T)
        first = int(np.argmin(away))
        ahead = np.hypot(*(path[first:] - segment.start).T)
        reach = min(1.0, max(segment.distance / 2, 0.3))
        k = first + int(np.argmax(ahead >= reach)) if (ahead >= reach).any() else len(path) - 1
        d = path[k] - segment.start
        yaw = float(np.arctan2(d[1], d[0])) if np.hypot(*d) > 1e-6 else start_yaw
        out.append((Pose2D(*segment.start, yaw), " · ".join(words)))
        words = []
    end = _arrival(scene, route, path, start_yaw)
    if len(out) >= _VIEWS_MOST:
        out = out[: _VIEWS_MOST - 1]
    out.append((end, f"arrival: {route.target.name}"))
    return out


def _arrival(
    scene: Scene, route: RouteDescription, path: NDArray[np.float64], start_yaw: float
) -> Pose2D:
    """At the end of the path, turned to the target."""
    x, y = path[-1].tolist()
    there = [t.box.centre for t in scene.objects if t.id == route.target.object_id]
    if there:
        return Pose2D(x, y, math.atan2(there[0][1] - y, there[0][0] - x))
    d = path[-1] - path[-2] if len(path) > 1 else np.zeros(2)
    return Pose2D(x, y, math.atan2(d[1], d[0]) if d.any() else start_yaw)


def _arrival_pitch(scene: Scene, route: RouteDescription, pose: Pose2D) -> float:
    """How far up [rad] the target's middle is seen from the end: a bin is looked down on."""
    for thing in scene.objects:
        if thing.id == route.target.object_id:
            x, y, z = thing.box.centre
            away = max(math.hypot(x - pose.x, y - pose.y), 0.3)
            return min(max(math.atan2(z - EYE, away), -1.2), 0.3)
    return PITCH


def _draw_above(
    scene: Scene,
    renderer: Renderer,
    route: RouteDescription,
    path: NDArray[np.float64],
    start_yaw: float,
    height: int,
    cut_height: float,
) -> Image.Image:
    by_id = {thing.id: thing for thing in scene.objects}
    marks = [by_id[m.object_id] for m in route.landmarks if m.object_id in by_id]
    if route.target.object_id in by_id:
        marks.append(by_id[route.target.object_id])
    around = [path, *(np.array([thing.box.centre[:2]]) for thing in marks)]
    low = np.concatenate(around).min(axis=0) - _MARGIN
    high = np.concatenate(around).max(axis=0) + _MARGIN
    middle, span = (low + high) / 2, np.maximum(high - low, 4.0)
    span = np.maximum(span, (0.6 * span[1], span[0] / 1.7))
    scale = float(span[1]) / height  # metres a pixel
    width = round(float(span[0]) / scale)
    x0, y0 = middle - np.array([width, height]) * scale / 2
    bounds = np.array([[x0, y0], [x0 + (width - 0.5) * scale, y0 + (height - 0.5) * scale]])
    paper = (PAPER[0] / 255, PAPER[1] / 255, PAPER[2] / 255)
    bev = render_bev(
        scene.cloud_hash or scene.gaussians.content_hash,
        renderer,
        bounds,
        scale,
        cut_height,
        background=paper,
    )
    picture = Image.fromarray(np.ascontiguousarray(bev.rgb)).resize((width, height))
    pen = ImageDraw.Draw(picture)

    def at(x: float, y: float) -> tuple[float, float]:
        return (x - x0) / scale, height - (y - y0) / scale

    pen.line([at(x, y) for x, y in path.tolist()], fill=PATH, width=4, joint="curve")
    sx, sy = at(*path[0].tolist())
    pen.line(
        [(sx, sy), (sx + 24 * math.cos(start_yaw), sy - 24 * math.sin(start_yaw))],
        fill=START,
        width=4,
    )
    for x, y, colour in ((sx, sy, START), (*at(*path[-1].tolist()), GOAL)):
        pen.ellipse((x - 8, y - 8, x + 8, y + 8), fill=colour, outline=PAPER)
    for landmark in route.landmarks:
        if landmark.object_id in by_id:
            thing = by_id[landmark.object_id]
            _tag(pen, at(*thing.box.centre[:2]), landmark.name, (20, 20, 24))
    if route.target.object_id in by_id:
        _tag(pen, at(*by_id[route.target.object_id].box.centre[:2]), route.target.name, GOAL)
    for number, segment in enumerate(route.segments, 1):
        a, b = np.array(segment.start), np.array(segment.end)
        x, y = at(*((a + b) / 2 if segment.turn is None else a).tolist())
        pen.ellipse((x - 9, y - 9, x + 9, y + 9), fill=_MARK, outline=PAPER)
        pen.text((x, y), str(number), font=font(12), fill=PAPER, anchor="mm")
    return picture


def _tag(
    pen: ImageDraw.ImageDraw, spot: tuple[float, float], text: str, colour: tuple[int, int, int]
) -> None:
    box = pen.textbbox(spot, text, font=font(13), anchor="mm")
    pen.rectangle((box[0] - 3, box[1] - 2, box[2] + 3, box[3] + 2), fill=(250, 249, 246))
    pen.text(spot, text, font=font(13), fill=colour, anchor="mm")
