"""A sample sheet: a few steps of an episode for a person to judge, with labels drawn in."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gn0.counted import counted
from gn0.data.dataset import Dataset
from gn0.data.episode_frames import read_frames
from gn0.data.sample_table import EpisodeRows
from gn0.data.step_people import SeenPerson
from gn0.errors import DataError
from gn0.geometry import F32, F64, U8
from gn0.sim.presets import find_preset
from gn0.sim.sensors import MapFrame

HEIGHT = 240  # px of every picture
GAP, HEAD, FOOT = 8, 62, 52
WORDS = ("STOP", "FWD", "LEFT", "RIGHT")
INK, PAPER, SOFT = (20, 22, 26), (255, 255, 255), (100, 104, 112)
WAY, AGENT, ENDED = (0, 114, 178), (213, 94, 0), (160, 164, 172)
REACH = 4.0  # m of map shown around the agent
CAPTIONS = {
    "rgb": "view",
    "depth": "depth: white is near, black {far:g} m or nothing",
    "history": "history: the last 16 views",
    "bev": "BEV, the next 3 m",
    "occupancy": "occupancy, the next 3 m",
}
TRACKING = {
    "history": "history: black in TRACKING samples",
    "bev": "BEV, the next 1.5 m",
    "occupancy": "occupancy, the next 1.5 m",
}


def draw_sheet(dataset: Dataset, episode_id: str = "", steps: int = 4) -> Image.Image:
    """Steps of an episode, one a line: view, history, BEV and occupancy with waypoints.

    A dataset that stores depth shows it beside the view.

    Args:
        dataset: a dataset.
        episode_id: by default the episode of the first samples.
        steps: how many, evenly spread, the first and the last included.

    Raises:
        DataError: the dataset has no samples, or no such episode.
    """
    if not dataset.sampled:
        raise DataError(
            "the dataset has no samples", where=dataset.folder, remedy="see skipped in dataset.json"
        )
    rows = dataset.rows(episode_id or dataset.sampled[0])
    episode = dataset.episode(rows.episode_id)
    chosen = sorted({round(t) for t in np.linspace(0, len(rows) - 1, max(steps, 1))})
    frame = MapFrame.of_grid(dataset.navigation(episode.scene_id).grid)
    shown = [name for name in CAPTIONS if name != "depth" or dataset.about.stores_depth]
    preset = find_preset(dataset.about.camera)
    far, box_scale = preset.depth_range[1], preset.picture_size[0] / preset.rgb.width
    lines = []
    for t, pictures in enumerate(read_frames(dataset, rows.episode_id, shown)):
        if t in chosen:
            seen = rows.seen_person(t, episode)
            if seen is not None and seen.box is not None:
                pictures["rgb"] = _draw_box(pictures["rgb"], seen, box_scale)
            lines.append(_draw_line(pictures, rows, t, frame, far, seen))
    width = max(line.width for line in lines)
    sheet = Image.new("RGB", (width + 2 * GAP, HEAD + sum(line.height for line in lines)), PAPER)
    draw = ImageDraw.Draw(sheet)
    light = f" · light: {episode.light.name}" if episode.light is not None else ""
    title = (
        f"{episode.id} · {episode.scene_id} · {episode.split}{light} · {counted(len(rows), 'step')}"
    )
    draw.text((GAP, 8), title, SOFT, ImageFont.load_default(13))
    words = textwrap.shorten(episode.instruction, max(40, width // 9), placeholder=" …")
    draw.text((GAP, 30), words, INK, ImageFont.load_default(18))
    top = HEAD
    for line in lines:
        sheet.paste(line, (GAP, top))
        top += line.height
    return sheet


def _draw_line(
    pictures: dict[str, NDArray[Any]],
    rows: EpisodeRows,
    t: int,
    frame: MapFrame,
    far: float,
    seen: SeenPerson | None,
) -> Image.Image:
    tiles = []
    points = _world_points(rows, t)
    for name in (name for name in CAPTIONS if name in pictures):
        if name in ("bev", "occupancy"):
            arrow = name == "bev"  # the occupancy picture has its own dots
            tiles.append(_draw_map(pictures[name], rows, t, points, frame, arrow=arrow))
        elif name == "depth":
            tiles.append(_fit(_paint_depth(pictures[name], far)))
        else:
            tiles.append(_fit(Image.fromarray(pictures[name])))
    width = sum(tile.width for tile in tiles) + GAP * (len(tiles) - 1)
    line = Image.new("RGB", (width, HEIGHT + FOOT), PAPER)
    x = 0
    for tile in tiles:
        line.paste(tile, (x, 0))
        x += tile.width + GAP
    draw = ImageDraw.Draw(line)
    x = 0
    known = CAPTIONS | TRACKING if rows.person else CAPTIONS
    captions = [text for name, text in known.items() if name in pictures]
    for tile, caption in zip(tiles, captions, strict=True):
        draw.text((x, HEIGHT + 4), caption.format(far=far), SOFT, ImageFont.load_default(12))
        x += tile.width + GAP
    ahead = " ".join(WORDS[code] for code in rows.actions[t].tolist())
    text = (
        f"step {t} · next six: {ahead} · {min(int(rows.valid[t]), rows.points)} of {rows.points} "
        f"points · {float(rows.distance[t]):.2f} m to {'the person' if rows.person else 'go'}"
    )
    if seen is not None:
        text += f" · person {seen.number}: {100 * seen.share:.0f} % seen"
    if rows.policy_actions:
        said = " ".join(WORDS[code] for code in rows.policy_actions[t])
        text += f" · policy said {said}"
    draw.text((0, HEIGHT + 20), text, INK, ImageFont.load_default(14))
    return line


def _draw_box(rgb: U8, seen: SeenPerson, scale: float) -> U8:
    """The view with the box of the person in it, `scale` pixels of it one of the camera's."""
    assert seen.box is not None
    image = Image.fromarray(np.array(rgb))
    left, top, right, bottom = (scale * edge for edge in seen.box)
    draw = ImageDraw.Draw(image)
    for grown, colour in ((1, PAPER), (0, AGENT)):
        box = (
            left - grown,
            top - grown,
            max(right - 1, left) + grown,
            max(bottom - 1, top) + grown,
        )
        draw.rectangle(box, outline=colour, width=2 - grown)
    return np.asarray(image)


def _paint_depth(depth: F32, far: float) -> Image.Image:
    """Depth [H, W] m as grey that halves about every sixth of the range: most of a room is near."""
    grey = 255 * np.exp(-4 * depth / far)
    return Image.fromarray(grey.round().astype(np.uint8)).convert("RGB")


def _fit(image: Image.Image) -> Image.Image:
    return image.resize((round(image.width * HEIGHT / image.height), HEIGHT), Image.Resampling.BOX)


def _world_points(rows: EpisodeRows, t: int) -> F64:
    """The waypoints of a step [13, 2] m in the world; [7, 2] of a TRACKING sample."""
    x, y, yaw = map(float, rows.poses[t])
    c, s = np.cos(yaw), np.sin(yaw)
    way = rows.waypoints[t, : rows.points].astype(np.float64)
    return np.column_stack([x + c * way[:, 0] - s * way[:, 1], y + s * way[:, 0] + c * way[:, 1]])


def _draw_map(
    picture: U8, rows: EpisodeRows, t: int, points: F64, frame: MapFrame, *, arrow: bool
) -> Image.Image:
    """The map around the agent, enlarged, with the way ahead and where the agent looks."""
    x, y, yaw = map(float, rows.poses[t])
    side = min(round(2 * REACH / frame.metres_per_pixel), max(frame.height, frame.width))
    row, column = frame.pixel_of(x, y)
    top, left = _window(row, side, frame.height), _window(column, side, frame.width)
    padded = np.full((side, side, 3), 235, np.uint8)
    r0, c0 = max(top, 0), max(left, 0)
    r1, c1 = min(top + side, frame.height), min(left + side, frame.width)
    padded[r0 - top : r1 - top, c0 - left : c1 - left] = picture[r0:r1, c0:c1]
    scale = HEIGHT / side
    image = Image.fromarray(padded).resize((HEIGHT, HEIGHT), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(image)

    def place(px: float, py: float) -> tuple[float, float]:
        u = (px - frame.x_min) / frame.metres_per_pixel - left
        v = frame.height - (py - frame.y_min) / frame.metres_per_pixel - top
        return u * scale, v * scale

    spots = [place(*point) for point in points]
    draw.line(spots[1:], fill=WAY, width=2)
    for index, (u, v) in list(enumerate(spots))[1:]:
        colour = WAY if index < int(rows.valid[t]) else ENDED
        draw.ellipse((u - 2.5, v - 2.5, u + 2.5, v + 2.5), fill=colour)
    if arrow:
        u, v = place(x, y)
        turn = -yaw + np.array([0.0, 2.5, -2.5])
        corners = [
            (u + r * float(np.cos(a)), v + r * float(np.sin(a)))
            for a, r in zip(turn, (10, 7, 7), strict=True)
        ]
        draw.polygon(corners, fill=AGENT, outline=PAPER)
    return image


def _window(middle: int, side: int, size: int) -> int:
    """Where a window [px] begins that holds the middle and stays on the picture if it can."""
    if size <= side:
        return (size - side) // 2
    return min(max(middle - side // 2, 0), size - side)
