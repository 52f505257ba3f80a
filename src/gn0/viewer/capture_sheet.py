"""The evidence behind a capture's frame as one picture: side view, heights, map from above."""

from __future__ import annotations

import math
import textwrap

import numpy as np
from PIL import Image, ImageDraw

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64, U8
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN
from gn0.scenes.capture.capture_source import evidence_lines
from gn0.scenes.capture.disc_facing import disc_normals
from gn0.scenes.capture.extinction import solid_enough
from gn0.scenes.scene import Scene
from gn0.viewer.floor_plan import INK, MUTED, PAPER, font

WIDTH = 1500  # px
_GAP = 24
_MAP = (900, 620)  # px, at most
_SIDE = 300  # px high
_FLOOR = (34, 120, 200)
_BAND = (250, 226, 170)
_BAND_EDGE = (214, 150, 30)
_CEILING = (130, 90, 170)
_LEVEL = (70, 80, 96)
_OTHER = (190, 194, 200)
_WALK = (70, 190, 110)
_BLOCK = (214, 62, 50)
_CUT = 2.0  # m: the map shows nothing above


def render_capture(scene: Scene) -> Image.Image:
    """Side view with floor, band and ceiling, histogram of heights, map over colours, evidence.

    A capture that stands on its head, has its floor at a table top or is of the wrong size shows
    at a glance.
    """
    cloud = scene.gaussians.select(np.flatnonzero(solid_enough(scene.gaussians)))
    known = scene.source.settings
    band = (float(known.get("height_band_low") or 0), float(known.get("height_band_high") or 1.5))
    ceiling = known.get("ceiling")
    low, high = _heights(cloud, band)
    top = _map(scene, cloud)
    lines = [
        part
        for line in evidence_lines(scene.source)
        for part in textwrap.wrap(
            line.strip().replace("m²", "sq m"), 190, subsequent_indent="      "
        )
    ]
    text = 21 * len(lines) + 16
    height = 64 + _SIDE + 36 + top.height + 40 + text + _GAP
    sheet = Image.new("RGB", (WIDTH, height), PAPER)
    pen = ImageDraw.Draw(sheet)
    pen.text((_GAP, 16), f"{scene.id[:50]}: evidence for its frame", font=font(26), fill=INK)
    # side view and histogram share one scale of heights
    hist = 360
    side = WIDTH - 3 * _GAP - hist - 50
    box = (_GAP + 50, 64, _GAP + 50 + side, 64 + _SIDE)
    marks = [
        (0.0, "floor 0", _FLOOR),
        (band[0], f"{band[0]:g}", _BAND_EDGE),
        (band[1], f"{band[1]:g} m", _BAND_EDGE),
    ]
    if isinstance(ceiling, (int, float)) and ceiling < high:
        marks.append((float(ceiling), f"ceiling {ceiling:.2f}", _CEILING))
    picture = _side(cloud, scene.bounds, low, high, side, _SIDE)
    sheet.paste(picture, box[:2])
    histogram = _histogram(cloud, low, high, hist, _SIDE, band)
    left = box[2] + _GAP
    sheet.paste(histogram, (left, 64))
    for z, name, colour in marks:
        y = 64 + round((high - z) / (high - low) * _SIDE)
        pen.line((box[0], y, left + hist, y), fill=colour, width=1)
        pen.text((box[0] - 6, y), name.split()[0], font=font(12), fill=colour, anchor="rm")
        pen.text((left + hist - 4, y - 2), name, font=font(12), fill=colour, anchor="rs")
    below = 64 + _SIDE + 6
    pen.text((box[0], below), "side view, all depths", font=font(13), fill=MUTED)
    pen.text(
        (left, below), "heights: level surfaces dark, all else light", font=font(13), fill=MUTED
    )
    at = 64 + _SIDE + 36
    sheet.paste(top, ((WIDTH - top.width) // 2, at))
    _legend(pen, at + top.height + 10)
    y = at + top.height + 44
    for line in lines:
        colour = _BLOCK if line.startswith("doubtful") else INK
        pen.text((_GAP, y), line, font=font(14), fill=colour)
        y += 21
    return sheet


def _heights(cloud: GaussianCloud, band: tuple[float, float]) -> tuple[float, float]:
    z = np.quantile(cloud.means[:, 2], (0.002, 0.998))
    return min(float(z[0]), 0.0) - 0.15, max(float(z[1]), band[1]) + 0.15


def _side(
    cloud: GaussianCloud, bounds: F64, low: float, high: float, width: int, height: int
) -> Image.Image:
    """Mean colour of what lies at each x and height, fainter where there is little."""
    wide = float(bounds[1, 0] - bounds[0, 0]) * 1.04
    scale = min(width / wide, height / (high - low))
    stretch = width / wide / scale  # a broad scene keeps its aspect, a tall one fills the height
    centre = float(bounds[:, 0].mean())
    x = ((cloud.means[:, 0] - centre) * scale * min(stretch, 1.0)) + width / 2
    y = (high - cloud.means[:, 2]) / (high - low) * height
    return Image.fromarray(_splash(cloud, x, y, width, height))


def _splash(cloud: GaussianCloud, x: np.ndarray, y: np.ndarray, width: int, height: int) -> U8:
    """Colours averaged per pixel on paper [height, width, 3]."""
    col, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    keep = (col >= 0) & (col < width) & (row >= 0) & (row < height)
    pixel = row[keep] * width + col[keep]
    weight = cloud.opacities[keep].astype(np.float64)
    rgb = np.clip(cloud.rgb()[keep], 0, 1)
    total = np.bincount(pixel, weight, width * height)
    colour = (
        np.stack([np.bincount(pixel, weight * rgb[:, k], width * height) for k in range(3)], axis=1)
        / np.maximum(total, 1e-9)[:, None]
    )
    usual = np.median(total[total > 0]) if (total > 0).any() else 1.0
    alpha = np.clip(total / usual, 0, 1)[:, None] ** 0.5
    out = alpha * colour * 255 + (1 - alpha) * np.asarray(PAPER)
    return np.ascontiguousarray(out.reshape(height, width, 3).astype(np.uint8))


def _histogram(
    cloud: GaussianCloud,
    low: float,
    high: float,
    width: int,
    height: int,
    band: tuple[float, float],
) -> Image.Image:
    """Surface per height: level discs dark, the rest light; the agent's band behind them."""
    image = Image.new("RGB", (width, height), (255, 255, 255))
    pen = ImageDraw.Draw(image)

    def at(z: float) -> int:
        return round((high - z) / (high - low) * height)

    pen.rectangle((0, at(band[1]), width, at(band[0])), fill=_BAND)
    normal, flat = disc_normals(cloud)
    sizes = np.sort(cloud.scales.astype(np.float64), axis=1)
    area = sizes[:, 1] * sizes[:, 2] * cloud.opacities
    area = np.minimum(area, np.quantile(area, 0.95))
    level = flat & (np.abs(normal[:, 2]) > 0.9)
    bins = height // 3
    row = np.clip(((high - cloud.means[:, 2]) / (high - low) * bins).astype(int), 0, bins - 1)
    every = np.bincount(row, area, bins)
    flats = np.bincount(row[level], area[level], bins)
    most = max(float(every.max()), 1e-12)
    for index in range(bins):
        y0 = index * height // bins
        y1 = (index + 1) * height // bins - 1
        for mass, colour in ((every[index], _OTHER), (flats[index], _LEVEL)):
            length = round((width - 70) * (mass / most) ** 0.5)
            if length:
                pen.rectangle((0, y0, length, y1), fill=colour)
    pen.rectangle((0, 0, width - 1, height - 1), outline=(216, 214, 208))
    return image


def _map(scene: Scene, cloud: GaussianCloud) -> Image.Image:
    """Colours from above with the map over them: green walkable, red in the way, seed marked."""
    grid = scene.grid
    known = np.argwhere(grid.cells != UNKNOWN)
    h, w = grid.shape
    (r0, c0), (r1, c1) = ((0, 0), (h, w))
    if len(known):
        (r0, c0), (r1, c1) = np.maximum(known.min(axis=0) - 4, 0), known.max(axis=0) + 5
        r1, c1 = min(r1, h), min(c1, w)
    k = max(1, min(_MAP[0] // (c1 - c0), _MAP[1] // (r1 - r0), 16))
    step = grid.resolution / k
    x0, y1 = grid.origin[0] + c0 * grid.resolution, grid.origin[1] + r1 * grid.resolution
    low = cloud.select(np.flatnonzero(cloud.means[:, 2] < _CUT))
    # dots of half a cell leave gaps; what is drawn must only orient
    coarse = max(1, k // 2)
    width, height = (c1 - c0) * k // coarse, (r1 - r0) * k // coarse
    x, y = (low.means[:, 0] - x0) / step / coarse, (y1 - low.means[:, 1]) / step / coarse
    picture = _splash(low, x, y, width, height).astype(np.float64)
    picture = picture.repeat(coarse, 0).repeat(coarse, 1)
    cells = grid.cells[r0:r1, c0:c1][::-1].repeat(k, 0).repeat(k, 1)
    cells = cells[: picture.shape[0], : picture.shape[1]]
    for value, colour, share in ((FREE, _WALK, 0.35), (OCCUPIED, _BLOCK, 0.55)):
        mask = cells == value
        picture[mask] = (1 - share) * picture[mask] + share * np.asarray(colour)
    image = Image.fromarray(np.ascontiguousarray(picture.astype(np.uint8)))
    pen = ImageDraw.Draw(image)
    seed = scene.source.settings.get("seed_x"), scene.source.settings.get("seed_y")
    if isinstance(seed[0], (int, float)) and isinstance(seed[1], (int, float)):
        px, py = (seed[0] - x0) / step, (y1 - seed[1]) / step
        pen.ellipse((px - 6, py - 6, px + 6, py + 6), fill=(255, 255, 255), outline=INK, width=2)
    _ticks(pen, image.size, (x0, y1), step)
    bar = 1.0 / step
    pen.line((12, image.height - 12, 12 + bar, image.height - 12), fill=INK, width=4)
    pen.text((16 + bar, image.height - 12), "1 m", font=font(14), fill=INK, anchor="lm")
    return image


def _ticks(
    pen: ImageDraw.ImageDraw, size: tuple[int, int], corner: tuple[float, float], step: float
) -> None:
    """Coordinates of the scene along the left and the top, for `--seed-point`."""
    pace = next((p for p in (1, 2, 5, 10, 20, 50) if p / step >= 60), 100)
    width, height = size
    x0, y1 = corner
    for value in range(math.ceil(x0 / pace) * pace, math.floor(x0 + width * step) + 1, pace):
        px = (value - x0) / step
        pen.line((px, 0, px, 6), fill=INK)
        pen.text((px, 8), f"{value}", font=font(12), fill=INK, anchor="ma")
    for value in range(math.ceil((y1 - height * step) / pace) * pace, math.floor(y1) + 1, pace):
        py = (y1 - value) / step
        pen.line((0, py, 4, py), fill=INK)
        pen.text((14, py), f"{value}", font=font(12), fill=INK, anchor="lm")


def _legend(pen: ImageDraw.ImageDraw, y: int) -> None:
    x = _GAP + 200
    for colour, name in (
        (_WALK, "walkable"),
        (_BLOCK, "in the agent's way"),
        ((255, 255, 255), "dot: where the flood fill began"),
    ):
        pen.rectangle((x, y, x + 14, y + 14), fill=colour, outline=INK)
        pen.text((x + 22, y + 7), name, font=font(14), fill=INK, anchor="lm")
        x += 260
