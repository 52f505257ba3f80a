"""The floor of a picture: the least time that its work can take on a card.

Counted with the CPU's lists, so that no renderer of ours judges itself. For views of one scene:

    splats read   chunks in sight of any view x 256 x 64 B, twice (count, emit)
    entries       one for each tile of 16x16 that a splat's rectangle touches: 8 B written, 8 B read
    reached       entries before all pixels of their tile have ended: 64 B gathered again, and the
                  spherical harmonics (2 B x 3 x coefficients above DC)
    pictures      7 B a pixel: RGB as bytes, depth as float
    operations    2 x (40 a splat and view in a chunk in sight + 100 a splat and view in sight)
                  + 150 an entry reached
                  + 32 lanes x 20 a splat that changes a pixel of an 8x4 part of a tile

Arranging (splats, entries written, the first two operations) and blending (the rest) each take the
longer of bytes / copy ceiling and operations / multiply-add ceiling, both measured in the same run;
the floor is their sum. It says nothing of launches or of waiting for memory, nor of sorting: the
entries of a tile can be put in order where they are blended, with no byte more. A renderer that
sorts all entries at once, as gsplat does, moves `sort_bytes` beside: five passes of a 32-bit key
and its entry, 8 B read and 8 B written each, and 8 B read to count the digits.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from gn0.geometry import F32, F64
from gn0.render import cpu_project as project
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu, view_parameters
from gn0.render.cpu_pack import CHUNK
from gn0.render.cpu_raster import TILE
from gn0.render.renderer import ALPHA_CAP, ALPHA_MIN, TRANSMITTANCE_STOP

SPLAT, ENTRY, PIXEL = 64, 8, 7  # bytes
TEST, PROJECT, STAGE, BLEND, LANES = 40, 100, 150, 20, 32  # operations
SORT_PASSES = 5  # of a radix sort in global memory; see `sort_bytes`
_BLOCK = 256  # entries blended at once while counting
_TILES = 48  # of a view that are counted out


@dataclass(frozen=True)
class Work:
    """What drawing takes: of a view, or of many.

    Attributes:
        chunks: chunks of 256 splats in sight of any view of the scene.
        tested: splats of chunks in sight, a view.
        visible: splats with a place in the picture, a view.
        entries: (splat, tile) pairs.
        reached: entries before their tile has ended.
        blended: (splat, 8x4 part of a tile) pairs that change a pixel.
        pixels: of all pictures.
    """

    chunks: float
    tested: float
    visible: float
    entries: float
    reached: float
    blended: float
    pixels: float

    def scaled(self, views: float, scenes: float = 1.0) -> Work:
        """The work of more views of as much work each, and of more scenes."""
        values = {f.name: getattr(self, f.name) * views for f in fields(self)}
        return Work(**{**values, "chunks": self.chunks * scenes})

    def bytes_of(self, sh_degree: int) -> tuple[float, float]:
        """Bytes moved by arranging and by blending."""
        arrange = 2 * self.chunks * CHUNK * SPLAT + self.entries * ENTRY
        harmonics = 2 * 3 * ((sh_degree + 1) ** 2 - 1)
        blend = self.entries * ENTRY + self.reached * (SPLAT + harmonics) + self.pixels * PIXEL
        return arrange, blend

    @property
    def sort_bytes(self) -> float:
        """Bytes moved by sorting all entries at once in global memory."""
        return self.entries * ENTRY * (2 * SORT_PASSES + 1)

    @property
    def operations(self) -> tuple[float, float]:
        """Lane-operations of arranging and of blending."""
        arrange = 2 * (self.tested * TEST + self.visible * PROJECT)
        return arrange, self.reached * STAGE + self.blended * LANES * BLEND

    def floor(self, sh_degree: int, copy: float, operations: float) -> float:
        """The least time [ms], for a copy ceiling [B/s] and an operation ceiling [1/s]."""
        pairs = zip(self.bytes_of(sh_degree), self.operations, strict=True)
        return sum(max(moved / copy, done / operations) for moved, done in pairs) * 1e3


def count_work(renderer: RendererCpu, camera: Camera, views: F64, *, sample: int = 2) -> Work:
    """The mean work of a view, from some tiles of some views; `chunks` are those of all together.

    Args:
        renderer: holds the splats.
        camera: of the views.
        views: world-to-camera [V, 4, 4], one at least.
        sample: views that are counted out.
    """
    seen_by_any = np.zeros(renderer.cloud.chunks, bool)
    tested = 0
    for view in views:
        seen = np.empty(renderer.cloud.chunks, np.int32)
        ortho = camera.model == "ortho"
        parameters = view_parameters(camera, view)
        count = project.cull_chunks(renderer.cloud.boxes, parameters, ortho, seen)
        seen_by_any[seen[:count]] = True
        tested += count * CHUNK
    counts = np.mean([_count_view(renderer, camera, view) for view in views[:sample]], axis=0)
    visible, entries, reached, blended = counts.tolist()
    return Work(
        chunks=float(seen_by_any.sum()),
        tested=tested / len(views),
        visible=visible,
        entries=entries,
        reached=reached,
        blended=blended,
        pixels=float(camera.width * camera.height),
    )


def _count_view(
    renderer: RendererCpu, camera: Camera, view: F64
) -> tuple[float, float, float, float]:
    """Visible splats, entries, reached entries and blended parts of a view."""
    lists = renderer.arrange(camera, view, [(renderer.cloud, 0)])
    records, indices, starts = lists.records, lists.indices, lists.starts
    rows, keys = lists.tile_rows, lists.tile_keys
    entries = int(starts[-1])
    visible = len(np.unique(rows[:entries]))
    tiles_x, tiles = -(-camera.width // TILE), len(starts) - 1
    chosen = np.unique(np.linspace(0, tiles - 1, min(_TILES, tiles)).astype(int))
    reached = blended = 0
    for t in chosen:
        mine = rows[starts[t] : starts[t + 1]]
        order = np.lexsort((indices[mine], keys[starts[t] : starts[t + 1]]))
        here = _count_tile(records[mine[order]], (t % tiles_x) * TILE, (t // tiles_x) * TILE)
        reached, blended = reached + here[0], blended + here[1]
    scale = tiles / max(len(chosen), 1)
    return visible, entries, reached * scale, blended * scale


def _count_tile(records: F32, x_px: int, y_px: int) -> tuple[int, int]:
    """Entries reached and (splat, 8x4 part) pairs blended in a tile; records in depth order."""
    across = np.arange(TILE, dtype=np.float32) + np.float32(0.5)
    x, y = (side.ravel() for side in np.meshgrid(x_px + across, y_px + across))
    through: NDArray[np.float32] = np.ones(TILE * TILE, np.float32)
    alive: NDArray[np.bool_] = np.ones(TILE * TILE, bool)
    reached = blended = 0
    for begin in range(0, len(records), _BLOCK):
        part = records[begin : begin + _BLOCK]
        column = {name: part[:, getattr(project, name), None] for name in ("U", "V", "QX", "QY")}
        dx, dy = x - column["U"], y - column["V"]
        q = column["QX"] * dx + column["QY"] * dy
        power = part[:, project.LOGO, None] - q * q - part[:, project.QK, None] * dy * dy
        alpha = np.minimum(np.exp(np.minimum(power, 0.0)), np.float32(ALPHA_CAP))
        alpha[alpha < np.float32(ALPHA_MIN)] = 0.0
        after = through * np.cumprod(1.0 - alpha, axis=0)
        live = alive & (after > TRANSMITTANCE_STOP)  # [entries, pixels]
        touched = (live & (alpha > 0)).reshape(len(part), 4, 4, 2, 8)
        blended += int(touched.any(axis=(2, 4)).sum())
        still = np.flatnonzero(~live.any(axis=1))
        if len(still):
            return reached + int(still[0]) + 1, blended
        reached, through, alive = reached + len(part), after[-1], live[-1]
    return reached, blended
