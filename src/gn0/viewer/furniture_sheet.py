"""A sheet of the catalogue of furniture: each thing by itself, traced, with its name and size."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gn0.gaussians.film import encode_srgb
from gn0.geometry import U8
from gn0.progress import Progress, no_progress
from gn0.scenes.procedural.assembly import Assembly, Item, Placed
from gn0.scenes.procedural.catalogue.table import Thing
from gn0.scenes.procedural.surface import ProceduralSurface
from gn0.scenes.rays import RayCaster

TILE, FOOT, COLUMNS = 168, 36, 8  # px; px; things a row
AZIMUTH, ELEVATION = math.radians(32), math.radians(24)  # of the eye, from the thing's front
LIGHT = np.array([0.35, -0.55, 0.75])  # towards the light; the front is −y
AMBIENT = 0.45
INK, SOFT, PAPER = (24, 26, 30), (110, 114, 122), (244, 244, 242)
_FINER = 2  # rays a pixel and direction


def draw_catalogue(
    things: Sequence[Thing], *, seed: int = 0, progress: Progress = no_progress
) -> Image.Image:
    """A tile a thing, in the order given.

    Args:
        things: what is drawn.
        seed: which of the many of each.
        progress: progress sink.
    """
    columns = min(COLUMNS, max(len(things), 1))
    rows = -(-len(things) // columns)
    sheet = Image.new("RGB", (columns * TILE, max(rows, 1) * (TILE + FOOT)), PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(11)
    for number, thing in enumerate(things):
        progress("drawing", number, len(things))
        item = thing.build(seed)
        left, top = number % columns * TILE, number // columns * (TILE + FOOT)
        sheet.paste(Image.fromarray(draw_item(item)), (left, top))
        low, high = item.full_extent()
        size = " x ".join(f"{float(side):.2f}" for side in high - low)
        draw.text((left + 6, top + TILE + 2), thing.name, INK, font)
        draw.text((left + 6, top + TILE + 16), f"{size} m", SOFT, font)
    progress("drawing", len(things), len(things))
    return sheet


def draw_item(item: Item, size: int = TILE) -> U8:
    """An item [size, size, 3] from its front, a little from the side and from above.

    The projection is parallel, and the item fills the picture.
    """
    assembly = Assembly()
    assembly.add_item(Placed(item, 0.0, 0.0), None)
    mesh, materials = assembly.finish()
    low, high = item.full_extent()
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    corners = low + corners * (high - low)
    c, s = math.cos(ELEVATION), math.sin(ELEVATION)
    forward = np.array([-math.sin(AZIMUTH) * c, math.cos(AZIMUTH) * c, -s])
    right = np.array([math.cos(AZIMUTH), math.sin(AZIMUTH), 0.0])
    up = np.cross(right, forward)
    middle = (low + high) / 2
    across, upward = (corners - middle) @ right, (corners - middle) @ up
    half = 1.06 * max(np.ptp(across), np.ptp(upward)) / 2
    steps = (np.arange(size * _FINER) + 0.5) / (size * _FINER) * 2 - 1
    u, v = np.meshgrid(steps * half, -steps * half)
    far = float(np.linalg.norm(high - low)) + 1.0
    origins = middle - far * forward + u[..., None] * right + v[..., None] * up
    rays = origins.reshape(-1, 3)
    face, _, uv = RayCaster(mesh).cast(rays, np.broadcast_to(forward, rays.shape))
    hit = np.flatnonzero(face >= 0)
    bary = np.column_stack([1 - uv[hit].sum(axis=1), uv[hit]])
    surface = ProceduralSurface(mesh, materials, footprint=2 * half / size)
    albedo, glow = surface.reflect(face[hit], bary)
    normal = mesh.normals()[face[hit]].astype(np.float64)
    normal *= np.where(normal @ forward > 0, -1.0, 1.0)[:, None]  # sheets are seen from both sides
    lit = AMBIENT + (1 - AMBIENT) * np.maximum(normal @ (LIGHT / np.linalg.norm(LIGHT)), 0.0)
    picture = np.tile(np.array(PAPER, np.float64) / 255, (len(rays), 1))
    picture[hit] = encode_srgb(np.clip(albedo * lit[:, None] + glow, 0.0, 1.0))
    fine = picture.reshape(size, _FINER, size, _FINER, 3).mean(axis=(1, 3))
    return np.asarray(np.round(fine * 255), np.uint8)
