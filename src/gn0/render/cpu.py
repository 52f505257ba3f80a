"""RendererCpu: 3D Gaussian splatting on any CPU, the same bytes every time.

Depth order is (full float32 depth, index in the cloud), stable; splats of `extra` come after all
static ones at equal depth, and those of instances after both, in the order given. Nothing is
reduced across threads, so the thread count cannot show.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, cached_property

import numba
import numpy as np
from numpy.typing import NDArray

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64
from gn0.render import cpu_project as project
from gn0.render.camera import Camera
from gn0.render.cpu_bin import BLOCK_LEAST, BLOCKS, ArrangedView, fill_tiles, scan_tiles
from gn0.render.cpu_labels import SLOTS, label_tiles
from gn0.render.cpu_pack import CHUNK, PackedCloud, pack_cloud
from gn0.render.cpu_parts import NO_GAIN, NO_NORMALS, NamedClouds, PlacedPart
from gn0.render.cpu_posed import PosedPacked
from gn0.render.cpu_raster import TILE, raster_tiles
from gn0.render.instance import Parts, check_parts
from gn0.render.labels import U32, check_labelled, encode_labels, split_codes
from gn0.render.renderer import (
    LABELS,
    OUTPUTS,
    Output,
    RenderOptions,
    RenderResult,
    check_outputs,
    check_views,
)
from gn0.render.visible_mark import mark_tiles
from gn0.render.who import WhoPictures, judge_seen

STAGES = ("project", "bin", "raster")


class RendererCpu:
    """Renders one cloud with Numba. Buffers are kept between calls: one thread at a time."""

    name = "cpu"
    takes_packed = True  # `name_packed` is there
    label_slots = SLOTS  # labels that a tile has room for at a time; never changes a byte

    def __init__(
        self,
        cloud: GaussianCloud,
        options: RenderOptions | None = None,
        *,
        named: NamedClouds | None = None,
    ) -> None:
        """Pack the cloud.

        Args:
            cloud: the static splats.
            options: how pictures are formed.
            named: clouds of moving parts, if renderers of other scenes know the same.

        Raises:
            RenderError: the cloud holds values that are not finite.
        """
        self.options = options or RenderOptions()
        self.size = len(cloud)
        with _threads(self.options.threads):
            self.cloud = pack_cloud(cloud)
        self._named = NamedClouds() if named is None else named
        self._buffers = _Buffers()
        self._label, self._categories = cloud.label, cloud.categories
        self.stage_seconds = dict.fromkeys(STAGES, 0.0)  # spent so far, for figures

    def name_cloud(self, name: str, cloud: GaussianCloud) -> None:
        """Make a cloud known by a name, for instances of it; replaces what had the name before.

        It is packed once: the same cloud under the same name again costs nothing.

        Raises:
            RenderError: no name, too many splats, or values that are not finite.
        """
        with _threads(self.options.threads):
            self._named.hold(name, cloud)

    def name_packed(self, name: str, posed: PosedPacked) -> None:
        """Make a posed cloud known by a name, for instances of it, as long as somebody holds it.

        Raises:
            RenderError: no name.
        """
        self._named.hold_packed(name, posed)

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        *,
        extra: GaussianCloud | None = None,
        parts: Parts = (),
        outputs: tuple[Output, ...] = OUTPUTS,
        background: tuple[float, float, float] | None = None,
    ) -> RenderResult:
        """Render `views` (world-to-camera [4, 4] or [V, 4, 4]); see `Renderer.render`.

        Raises:
            RenderError: a view is not finite or not rigid, an output is unknown, a colour or
                a splat is not finite, or `parts` are wrong (see `check_parts`).
        """
        matrices = check_views(views)
        clouds = [self.cloud] * len(matrices)
        return self.render_clouds(
            camera,
            matrices,
            clouds,
            extra=extra,
            parts=parts,
            outputs=outputs,
            background=background,
        )

    def render_clouds(
        self,
        camera: Camera,
        matrices: F64,
        clouds: Iterable[PackedCloud],
        *,
        extra: GaussianCloud | None = None,
        parts: Parts = (),
        outputs: tuple[Output, ...] = OUTPUTS,
        background: tuple[float, float, float] | None = None,
    ) -> RenderResult:
        """Render each view [4, 4] of `matrices` from its own of `clouds`, pieces of the whole.

        A piece is asked for when its view is drawn, and let go of after.

        Raises:
            RenderError: an output is unknown, a colour or a splat is not finite, or `parts` are
                wrong (see `check_parts`).
        """
        check_outputs(outputs)
        check_labelled(self._label, self._categories, outputs)
        colour = np.array(self.options.background if background is None else background, np.float32)
        if colour.shape != (3,) or not np.isfinite(colour).all():
            raise RenderError("background is not three finite numbers", where="background")
        instances = check_parts(parts, len(matrices), self._named)
        shape = (len(matrices), camera.height, camera.width)
        as_float = self.options.rgb_float
        rgb_type = np.float32 if as_float else np.uint8
        rgb = np.empty((*shape, 3), rgb_type) if "rgb" in outputs else None
        depth = np.empty(shape, np.float32) if "depth" in outputs else None
        alpha = np.empty(shape, np.float32) if "alpha" in outputs else None
        wants = np.array(
            [
                rgb is not None and not as_float,
                rgb is not None and as_float,
                depth is not None,
                alpha is not None,
            ]
        )
        no_u8, no_f32 = np.empty((1, 1, 3), np.uint8), np.empty((1, 1, 3), np.float32)
        no_map = np.empty((1, 1), np.float32)
        shown = np.empty(shape, np.uint32) if set(outputs) & set(LABELS) else None
        with _threads(self.options.threads):
            moving, first = [], self.size
            if extra is not None and len(extra):
                moving.append((pack_cloud(extra, sort=False), first))
                first += len(extra)
            for v, (matrix, cloud) in enumerate(zip(matrices, clouds, strict=True)):
                placed = self._named.place(instances[v], first)
                view = self.arrange(camera, matrix, [(cloud, 0), *moving], placed)
                start = time.perf_counter()
                plain = bool(wants.any()) or shown is None
                if plain:
                    raster_tiles(
                        *view,
                        -(-camera.width // TILE),
                        camera.width,
                        camera.height,
                        colour,
                        wants,
                        no_u8 if rgb is None or as_float else rgb[v],
                        no_f32 if rgb is None or not as_float else rgb[v],
                        no_map if depth is None else depth[v],
                        no_map if alpha is None else alpha[v],
                    )
                if shown is not None:
                    label_tiles(
                        *view.unboxed,
                        -(-camera.width // TILE),
                        camera.width,
                        camera.height,
                        plain,
                        self._codes,
                        _codes_moving(extra, placed),
                        self.size,
                        self.label_slots,
                        shown[v],
                    )
                self.stage_seconds["raster"] += time.perf_counter() - start
        labels = {} if shown is None else split_codes(shown, outputs)
        return RenderResult(rgb, depth, alpha, **labels)

    def render_who(
        self, camera: Camera, views: NDArray[np.floating], *, parts: Parts
    ) -> WhoPictures:
        """Which instance each pixel of `views` shows, and how much of each is seen.

        The scene needs no labels. Each instance is also drawn alone: for measures and truth.

        Raises:
            RenderError: a view is not finite or not rigid, or `parts` are wrong.
        """
        matrices = check_views(views)
        instances = check_parts(parts, len(matrices), self._named)
        shape = (camera.height, camera.width)
        size = (-(-camera.width // TILE), camera.width, camera.height)
        numbers = np.zeros((len(matrices), *shape), np.uint32)
        nobody = np.zeros(self.size, np.uint32)
        wants = np.array([False, False, False, True])
        no_u8, no_f32 = np.empty((1, 1, 3), np.uint8), np.empty((1, 1, 3), np.float32)
        no_map, colour = np.empty((1, 1), np.float32), np.zeros(3, np.float32)
        seen = []
        with _threads(self.options.threads):
            for v, matrix in enumerate(matrices):
                placed = self._named.place(instances[v], self.size)
                view = self.arrange(camera, matrix, [(self.cloud, 0)], placed)
                codes = [np.full(len(p.codes), k, np.uint32) for k, p in enumerate(placed, 1)]
                moving = np.concatenate([nobody[:0], *codes])
                label_tiles(
                    *(*view.unboxed, *size, False, nobody, moving, self.size),
                    *(self.label_slots, numbers[v]),
                )
                alone = []
                for part in placed:
                    opacity = np.empty(shape, np.float32)
                    view = self.arrange(camera, matrix, [], [part])
                    raster_tiles(
                        *(*view, *size, colour, wants),
                        *(no_u8, no_f32, no_map, opacity),
                    )
                    alone.append(opacity)
                seen.append(judge_seen(numbers[v], alone))
        return WhoPictures(numbers, seen)

    @cached_property
    def _codes(self) -> U32:
        """What the scene's splats belong to [N]; kept once somebody wants labels."""
        assert self._label is not None
        return encode_labels(self._label, self._categories)

    def mark_visible(
        self, camera: Camera, matrices: F64, threshold: float, marks: NDArray[np.uint8]
    ) -> None:
        """Set `marks` [N] to 1 for splats that weigh more than `threshold` in some pixel."""
        with _threads(self.options.threads):
            for matrix in matrices:
                view = self.arrange(camera, matrix, [(self.cloud, 0)])
                tiles_x = -(-camera.width // TILE)
                mark_tiles(
                    *(*view.unboxed, tiles_x, camera.width, camera.height),
                    *(np.float32(threshold), marks),
                )

    def arrange(
        self,
        camera: Camera,
        matrix: F64,
        clouds: list[tuple[PackedCloud, int]],
        placed: Sequence[PlacedPart] = (),
    ) -> ArrangedView:
        """Project all clouds and list each tile's splats; what `raster_tiles` takes first.

        Args:
            camera: takes the picture.
            matrix: world-to-camera [4, 4] m.
            clouds: in the world, with what is added to their indices.
            placed: clouds that stand elsewhere; each is seen in its own frame.
        """
        view = view_parameters(camera, matrix)
        ortho = camera.model == "ortho"
        tiles_x, tiles_y = -(-camera.width // TILE), -(-camera.height // TILE)
        buffers = self._buffers
        marks = [time.perf_counter()]
        drawn = [_Drawn(cloud, first, view, ortho) for cloud, first in clouds]
        for part in placed:
            seen = view_parameters(camera, matrix @ part.pose, part.nearer)
            found = _Drawn(part.cloud, part.first, seen, ortho, part.gain, part.normals)
            if len(found.chunks):
                drawn.append(found)
        total = sum(len(each.chunks) for each in drawn)
        buffers.need_rows(total * CHUNK)
        shares = [min(BLOCKS, -(-len(each.chunks) // BLOCK_LEAST)) for each in drawn]
        histogram, starts = buffers.need_tiles(tiles_x * tiles_y, sum(shares))
        counts = np.zeros(total, np.int32)
        ranges = np.empty((len(histogram), 2), np.int64)
        done = first = 0
        for share, each in zip(shares, drawn, strict=True):
            cloud, chunks = each.cloud, each.chunks
            blocks = slice(first, first + share)
            project.project_chunks(
                *(cloud.pack, cloud.order, np.int32(each.first), cloud.sh, cloud.degree, chunks),
                *(each.view, ortho, self.options.antialiased, done * CHUNK, tiles_x),
                *(buffers.records, buffers.rects, buffers.keys, buffers.indices),
                *(counts[done : done + len(chunks)], histogram[blocks], each.gain, each.normals),
                *(cloud.still, cloud.floor, cloud.floor_at),
            )
            edges = done + np.arange(share + 1) * len(chunks) // max(share, 1)
            ranges[blocks, 0], ranges[blocks, 1] = edges[:-1], edges[1:]
            done += len(chunks)
            first += share
        marks.append(time.perf_counter())
        buffers.need_entries(int(scan_tiles(histogram, starts)))
        fill_tiles(
            *(ranges, spread_rows(len(ranges)), counts, buffers.rects, buffers.keys),
            *(tiles_x, histogram),
            *(buffers.tile_rows[0], buffers.tile_keys[0]),
        )
        marks.append(time.perf_counter())
        for stage, start, end in zip(STAGES, marks, marks[1:], strict=False):
            self.stage_seconds[stage] += end - start
        ordered = all(each.cloud.ordered for each in drawn)
        (rows, spare_rows), (keys, spare_keys) = buffers.tile_rows, buffers.tile_keys
        return ArrangedView(
            *(buffers.rects, buffers.records, buffers.indices, ordered),
            *(starts, rows, keys, spare_rows, spare_keys, spread_rows(tiles_y)),
        )


def _codes_moving(extra: GaussianCloud | None, placed: Sequence[PlacedPart]) -> U32:
    """What the splats belong to that are numbered behind those of the scene."""
    codes = [part.codes for part in placed]
    if extra is not None and len(extra):
        codes.insert(0, encode_labels(extra.label, extra.categories, len(extra)))
    return np.concatenate([np.zeros(0, np.uint32), *codes])


class _Drawn:
    """A cloud in one view: its view parameters, the chunks that may show, its gain."""

    def __init__(
        self,
        cloud: PackedCloud,
        first: int,
        view: F32,
        ortho: bool,
        gain: F32 = NO_GAIN,
        normals: F32 = NO_NORMALS,
    ) -> None:
        self.cloud, self.first, self.view = cloud, first, view
        self.gain, self.normals = gain, normals
        seen = np.empty(cloud.chunks, np.int32)
        self.chunks = seen[: project.cull_chunks(cloud.boxes, view, ortho, seen)]


class _Buffers:
    """Arrays kept between views; each grows when a view needs more."""

    def __init__(self) -> None:
        self.records = np.empty((0, project.RECORD), np.float32)
        self.rects = np.empty((0, 4), np.int16)
        self.keys = np.empty(0, np.uint32)
        self.indices = np.empty(0, np.uint32)
        self.histogram = np.empty(0, np.int32)
        self.tile_starts = np.empty(1, np.int32)
        self.tile_rows = (np.empty(0, np.int32), np.empty(0, np.int32))
        self.tile_keys = (np.empty(0, np.uint32), np.empty(0, np.uint32))

    def need_rows(self, rows: int) -> None:
        if rows > len(self.keys):
            rows = _grown(rows)
            self.records = np.empty((rows, project.RECORD), np.float32)
            self.rects = np.empty((rows, 4), np.int16)
            self.keys = np.empty(rows, np.uint32)
            self.indices = np.empty(rows, np.uint32)

    def need_tiles(self, tiles: int, blocks: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        if len(self.histogram) < blocks * tiles:
            self.histogram = np.empty(blocks * tiles, np.int32)
        if len(self.tile_starts) < tiles + 1:
            self.tile_starts = np.empty(tiles + 1, np.int32)
        histogram = self.histogram[: blocks * tiles].reshape(blocks, tiles)
        return histogram, self.tile_starts[: tiles + 1]

    def need_entries(self, entries: int) -> None:
        if entries > 2**31 - 1:
            raise RenderError(
                f"the picture needs {entries} tile entries, more than 2^31",
                remedy="render it in smaller pictures",
            )
        if entries > len(self.tile_rows[0]):
            n = _grown(entries)
            self.tile_rows = (np.empty(n, np.int32), np.empty(n, np.int32))
            self.tile_keys = (np.empty(n, np.uint32), np.empty(n, np.uint32))


@cache
def spread_rows(count: int) -> NDArray[np.int32]:
    """Numbers, of tile rows say, in bit-reversed order: any contiguous share holds some of all."""
    bits = max(count - 1, 1).bit_length()
    order = [int(f"{row:0{bits}b}"[::-1], 2) for row in range(1 << bits)]
    return np.array([row for row in order if row < count], np.int32)


def _grown(count: int) -> int:
    return count + count // 4 + CHUNK


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Run with `count` Numba threads (0: all), and restore what was set before."""
    before = numba.get_num_threads()
    wanted = before if count <= 0 else min(count, int(numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
    numba.set_num_threads(wanted)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def view_parameters(camera: Camera, matrix: F64, nearer: float = 0.0) -> F32:
    """What the kernels need of a view, float32 (fields named in `cpu_project`)."""
    view = np.zeros(project.VIEW_FIELDS, np.float32)
    rotation = matrix[:3, :3]
    view[:9] = rotation.ravel()
    view[9:12] = -rotation.T @ matrix[:3, 3]
    view[12:16] = camera.fx, camera.fy, camera.cx, camera.cy
    # a pinhole divides by z, so even near = 0 stays in front of the camera
    view[16:18] = max(camera.near, 1e-6) if camera.model == "pinhole" else camera.near, camera.far
    size = (camera.width, camera.height)
    focal, centre = (camera.fx, camera.fy), (camera.cx, camera.cy)
    for axis in range(2):
        widened = 0.3 * 0.5 * size[axis] / focal[axis]
        positive = (size[axis] - centre[axis]) / focal[axis] + widened
        negative = centre[axis] / focal[axis] + widened
        view[18 + 2 * axis], view[19 + 2 * axis] = positive, negative
        slope = max(abs(positive), abs(negative)) if camera.model == "pinhole" else 0.0
        view[22 + axis] = math.sqrt(1.0 + slope * slope)
    view[24:26], view[project.NEARER] = size, nearer
    return view
