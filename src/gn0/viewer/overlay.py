"""The self-check picture of episodes: the path on the occupancy map on the bird's-eye view.

A set in a wrong frame shows at once: its path runs through walls and furniture.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gn0.counted import counted
from gn0.maps.grid import OCCUPIED, UNKNOWN
from gn0.missions.episode import Episode, MissionFollow
from gn0.people.person import RADIUS
from gn0.render.bev import render_bev
from gn0.render.renderer import Renderer
from gn0.scenes.scene import Scene
from gn0.viewer.coverage import count_paths, covered_share, tint_coverage
from gn0.viewer.floor_plan import INK, MUTED, PAPER, font, plan_bounds

PATH = (18, 92, 214)
BLOCKED_PATH = (214, 40, 40)
START, GOAL = (22, 140, 70), (178, 34, 140)
OTHERS = (90, 90, 90)  # people who are not to be followed
_WALL = (52, 58, 68, 150)
_DARK = (120, 120, 130, 110)
_GAP, _LINE = 18, 24
_SCALE = 2  # drawn twice as large, then reduced


def render_overlay(
    scene: Scene,
    episodes: Sequence[Episode],
    renderer: Renderer,
    *,
    width: int = 1200,
    rooms: bool = True,
    caption: Sequence[str] = (),
    cut_height: float = 2.0,
    coverage: bool = False,
) -> Image.Image:
    """Episodes of one scene over its map and BEV; what of a path is not on free cells is red.

    Args:
        scene: the scene.
        episodes: one (with start, heading, goal and instruction), or several (thin paths); with
            the ways of their people and where those begin.
        renderer: a renderer of the scene's splats.
        width: width of the picture [px]; less for a scene that is deeper than wide.
        rooms: draw the outlines of rooms.
        caption: more lines of text below the instruction.
        cut_height: what lies higher [m] is left out of the BEV.
        coverage: show how many paths pass through each spot, instead of the paths.
    """
    x0, y0, x1, y1 = plan_bounds(scene)
    width = max(600, min(width, round(width * (x1 - x0) / (y1 - y0))))  # no tower of a picture
    scale = (x1 - x0) / (width * _SCALE)
    height = max(1, round((y1 - y0) / scale / _SCALE))
    bounds = np.array([[x0, y0], [x1 - scale / 2, y1 - scale / 2]])
    bev = render_bev(
        scene.cloud_hash or scene.gaussians.content_hash,
        renderer,
        bounds,
        max(scale, (x1 - x0) / 4096, (y1 - y0) / 4096),
        cut_height,
        background=(PAPER[0] / 255, PAPER[1] / 255, PAPER[2] / 255),
    )
    size = (width * _SCALE, height * _SCALE)
    picture = Image.fromarray(np.ascontiguousarray(bev.rgb)).resize(size).convert("RGBA")

    def place(points: NDArray[np.floating]) -> list[tuple[float, float]]:
        p = np.asarray(points, np.float64).reshape(-1, 2)
        return [((x - x0) / scale, (y1 - y) / scale) for x, y in p.tolist()]

    picture.alpha_composite(_map_layer(scene, size, (x0, y0, x1, y1)))
    pen = ImageDraw.Draw(picture)
    if rooms:
        for room in scene.rooms:
            outline = place(np.array(room.polygon))
            pen.line([*outline, outline[0]], fill=(255, 255, 255, 255), width=2 * _SCALE)
    single = len(episodes) == 1
    # missions share paths
    distinct = {(e.start, e.path, e.goal, e.people): e for e in episodes}.values()
    if coverage:
        paths = [np.array([e.start[:2], *e.path, e.goal], np.float64) for e in distinct]
        counts = count_paths(scene.grid, paths)
        picture.alpha_composite(tint_coverage(counts, scene.grid, size, (x0, y0, x1, y1)))
        caption = [
            f"{covered_share(counts):.0%} of the free ground is passed, a spot by up to "
            f"{int(counts.max())} paths: blue few, red many, pale none",
        ]
    for episode in () if coverage else distinct:
        _draw_episode(pen, scene, episode, place, bold=single)
    lines = [*_caption(episodes), *caption]
    bold = len(_wrap(lines[:1], width))  # lines of what is drawn; what is said of it is paler
    text = Image.new("RGB", (width, height + 2 * _GAP + _LINE * len(_wrap(lines, width))), PAPER)
    text.paste(picture.convert("RGB").resize((width, height), Image.Resampling.LANCZOS), (0, 0))
    writer = ImageDraw.Draw(text)
    for number, line in enumerate(_wrap(lines, width)):
        writer.text(
            (_GAP, height + _GAP + number * _LINE),
            line,
            font=font(17),
            fill=INK if number < bold else MUTED,
        )
    return text


def _map_layer(
    scene: Scene, size: tuple[int, int], window: tuple[float, float, float, float]
) -> Image.Image:
    """Occupied and unknown cells as a tint, in the picture's frame."""
    x0, y0, x1, y1 = window
    colours = np.zeros((3, 4), np.uint8)
    colours[OCCUPIED], colours[UNKNOWN] = _WALL, _DARK
    s = scene.grid.resolution
    columns = np.floor((np.linspace(x0, x1, size[0], False) - scene.grid.origin[0]) / s)
    rows = np.floor((np.linspace(y1, y0, size[1], False) - scene.grid.origin[1]) / s)
    h, w = scene.grid.shape
    inside = ((rows >= 0) & (rows < h))[:, None] & ((columns >= 0) & (columns < w))[None]
    cells = scene.grid.cells[
        np.clip(rows, 0, h - 1).astype(np.int64)[:, None],
        np.clip(columns, 0, w - 1).astype(np.int64)[None],
    ]
    layer = colours[cells]
    layer[~inside] = 0
    return Image.fromarray(layer, "RGBA")


def _draw_episode(pen: ImageDraw.ImageDraw, scene: Scene, episode: Episode, place, *, bold: bool):  # type: ignore[no-untyped-def]
    thick = (4 if bold else 2) * _SCALE
    _draw_people(pen, episode, place, 4 if bold else 3)
    end = () if isinstance(episode.mission, MissionFollow) else (episode.goal,)  # it is not gone to
    points = np.array([episode.start[:2], *episode.path, *end], np.float64)
    for a, b in pairwise(points):
        parts = max(1, int(np.ceil(np.hypot(*(b - a)) / (scene.grid.resolution / 2))))
        t = np.linspace(0.0, 1.0, parts + 1)[:, None]
        line = a + (b - a) * t
        free = np.array([scene.grid.is_free(float(x), float(y)) for x, y in line])
        spots = place(line)
        for i in range(parts):
            colour = PATH if free[i] and free[i + 1] else BLOCKED_PATH
            pen.line([spots[i], spots[i + 1]], fill=colour, width=thick)
    (sx, sy), (gx, gy) = place(np.array([episode.start[:2], episode.goal]))
    r = (9 if bold else 4) * _SCALE
    pen.ellipse((sx - r, sy - r, sx + r, sy + r), fill=START, outline=PAPER, width=_SCALE)
    if bold:
        dx, dy = np.cos(episode.start[2]), -np.sin(episode.start[2])
        tip = (sx + dx * 3.2 * r, sy + dy * 3.2 * r)
        pen.line([(sx, sy), tip], fill=START, width=3 * _SCALE)
        pen.polygon(
            [
                (tip[0] + dx * r, tip[1] + dy * r),
                (tip[0] - dy * r * 0.6, tip[1] + dx * r * 0.6),
                (tip[0] + dy * r * 0.6, tip[1] - dx * r * 0.6),
            ],
            fill=START,
        )
    star = [
        (
            gx + (1.6 * r if k % 2 == 0 else 0.65 * r) * np.sin(k * np.pi / 5),
            gy - (1.6 * r if k % 2 == 0 else 0.65 * r) * np.cos(k * np.pi / 5),
        )
        for k in range(10)
    ]
    pen.polygon(star, fill=GOAL, outline=PAPER)


def _draw_people(pen: ImageDraw.ImageDraw, episode: Episode, place, thick: int) -> None:  # type: ignore[no-untyped-def]
    """The ways of people, and their discs where they begin; the one to follow in colour."""
    for person in episode.people:
        colour = GOAL if person == episode.followed else OTHERS
        spots = place(np.array(person.path))
        if len(spots) > 1:
            pen.line(spots, fill=colour, width=thick)
        x, y = person.spot
        (x, y), (edge, _) = place(np.array([(x, y), (x + RADIUS, y)]))
        r = edge - x
        pen.ellipse((x - r, y - r, x + r, y + r), outline=colour, width=thick)


def _caption(episodes: Sequence[Episode]) -> list[str]:
    if len(episodes) == 1:
        episode = episodes[0]
        return [f"{episode.id}: “{episode.instruction.strip()}”"]
    if not episodes:
        return ["no episode"]
    paths = len({(e.start, e.path, e.goal) for e in episodes})
    along = f" along {counted(paths, 'path')}" if paths < len(episodes) else ""
    return [f"{counted(len(episodes), 'episode')} of {episodes[0].scene_id}{along}"]


def _wrap(lines: Sequence[str], width: int) -> list[str]:
    import textwrap

    letters = max(20, int((width - 2 * _GAP) / 8.6))
    return [part for line in lines for part in textwrap.wrap(line, letters)[:4] or [""]]


def render_paths(paths: Sequence[NDArray[np.floating]], *, width: int = 900) -> Image.Image:
    """Paths [N, 2] m of a scene that is not here, on white: what a set tells without a map."""
    points = np.concatenate([np.asarray(p, np.float64).reshape(-1, 2) for p in paths] or
                            [np.zeros((1, 2))])  # fmt: skip
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    scale = max(float((high - low).max()) / (width * _SCALE), 1e-6)
    size = [max(1, round(v / scale)) for v in (high - low).tolist()]
    picture = Image.new("RGB", (size[0], size[1]), PAPER)
    pen = ImageDraw.Draw(picture)
    for path in paths:
        spots = [
            ((x - low[0]) / scale, (high[1] - y) / scale)
            for x, y in np.asarray(path, np.float64).reshape(-1, 2).tolist()
        ]
        if len(spots) > 1:
            pen.line(spots, fill=PATH, width=2 * _SCALE)
        r = 4 * _SCALE
        for (x, y), colour in ((spots[0], START), (spots[-1], GOAL)):
            pen.ellipse((x - r, y - r, x + r, y + r), fill=colour)
    return picture.resize(
        (max(1, size[0] // _SCALE), max(1, size[1] // _SCALE)), Image.Resampling.LANCZOS
    )
