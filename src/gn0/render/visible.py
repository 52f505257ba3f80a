"""Visible sets: for each cell of the floor, the splats that can be seen from it.

An agent's eye stays at one height and the scene stands still, so most splats can never show from
where it stands: they are behind walls, inside furniture, under others. A set holds the splats that
weigh more than 1/255 in some pixel of pictures taken all round from a few free places in the cell;
a picture drawn from the set alone is nearly the picture of all splats, and quicker.

A set depends on the cloud, the free cells of the map and the settings, on nothing else: not on the
order in which sets are built, nor on the number of threads. Sets are kept in the cache folder.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64
from gn0.maps.grid import OccupancyGrid
from gn0.progress import Progress, no_progress
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cpu_pack import CHUNK, FIELDS, REACH, PackedCloud
from gn0.render.cpu_posed import PosedPacked
from gn0.render.instance import Parts
from gn0.render.renderer import OUTPUTS, VISIBLE, Output, RenderResult, check_views
from gn0.render.visible_files import VisibleFiles
from gn0.render.visible_mark import gather_chunks
from gn0.render.visible_places import MEMORY, VisibleOptions, key_of_sets
from gn0.render.who import WhoPictures

_PER_SPLAT = (FIELDS + 1) * 4  # bytes of a packed splat


@dataclass(frozen=True, eq=False)
class VisibleSet:
    """The splats that can be seen from a cell, packed for the renderer."""

    cloud: PackedCloud
    size: int

    @property
    def nbytes(self) -> int:
        """Memory of the packed copy."""
        return self.cloud.chunks * CHUNK * _PER_SPLAT


class RendererVisible:
    """A `RendererCpu` that draws from visible sets where it can.

    Views of a pinhole camera whose eye is at `eye_height` over a cell of `floor` use that cell's
    set; it is read from the cache or found the first time. All other views, and orthographic
    ones, use the full set. `extra` splats and `parts` are in no set: they are always drawn.

    Args:
        renderer: draws; holds all splats.
        cloud_hash: content hash of its cloud.
        floor: where eyes can be: free cells, inflated for the agent.
        eye_height: eye height of the cameras [m].
        options: how sets are found.
        cache: read and write the cache folder.
    """

    name = VISIBLE

    def __init__(
        self,
        renderer: RendererCpu,
        cloud_hash: str,
        floor: OccupancyGrid,
        eye_height: float,
        options: VisibleOptions | None = None,
        *,
        cache: bool = True,
    ) -> None:
        self.full = renderer
        self.options = options or VisibleOptions()
        self.floor = floor
        self.eye_height = float(eye_height)
        settings = self.options
        self._places = settings.places_of(floor)
        self._sets: OrderedDict[tuple[int, int], VisibleSet] = OrderedDict()
        self._held = 0
        reach = renderer.cloud.pack.reshape(-1, FIELDS, CHUNK)[-1:, REACH]
        self._alive = renderer.cloud.chunks * CHUNK - int((reach < 0).sum())
        self.built = 0  # sets found by looking, for figures
        self.key = key_of_sets(
            cloud_hash, floor, self.eye_height, renderer.options.antialiased, settings
        )
        self.files = VisibleFiles(self.key, renderer.size, settings.disk) if cache else None

    @property
    def cells(self) -> list[tuple[int, int]]:
        """Cells (column, row) that have a free place, in order."""
        return sorted(self._places)

    def cell_of(self, x: float, y: float) -> tuple[int, int]:
        """The cell that holds a point [m]."""
        return math.floor(x / self.options.cell), math.floor(y / self.options.cell)

    def name_cloud(self, name: str, cloud: GaussianCloud) -> None:
        """Make a cloud known by a name, for instances of it; see `RendererCpu.name_cloud`.

        Raises:
            RenderError: see `RendererCpu.name_cloud`.
        """
        self.full.name_cloud(name, cloud)

    def name_packed(self, name: str, posed: PosedPacked) -> None:
        """Make a posed cloud known by a name; see `RendererCpu.name_packed`."""
        self.full.name_packed(name, posed)

    def render_who(
        self, camera: Camera, views: NDArray[np.floating], *, parts: Parts
    ) -> WhoPictures:
        """Which instance each pixel shows; of the whole scene, see `RendererCpu.render_who`."""
        return self.full.render_who(camera, views, parts=parts)

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
            RenderError: see `RendererCpu.render`.
        """
        matrices = check_views(views)
        clouds = (self._cloud_for(camera, matrix) for matrix in matrices)
        return self.full.render_clouds(
            camera,
            matrices,
            clouds,
            extra=extra,
            parts=parts,
            outputs=outputs,
            background=background,
        )

    def _cloud_for(self, camera: Camera, matrix: F64) -> PackedCloud:
        if camera.model != "pinhole":
            return self.full.cloud
        x, y, z = -matrix[:3, :3].T @ matrix[:3, 3]
        if abs(z - self.eye_height) > self.options.height_tolerance:
            return self.full.cloud
        cell = self.cell_of(x, y)
        if cell not in self._places:
            return self.full.cloud
        return self.open(cell).cloud

    def open(self, cell: tuple[int, int]) -> VisibleSet:
        """The set of a cell: held, read from the cache, or found now.

        Raises:
            RenderError: the cell has no free place.
        """
        held = self._sets.get(cell)
        if held is not None:
            self._sets.move_to_end(cell)
            return held
        if cell not in self._places:
            raise RenderError(f"cell {cell} has no free place", remedy="see RendererVisible.cells")
        marks = self.files.load(cell) if self.files is not None else None
        if marks is None:
            marks = self.find(cell)
            if self.files is not None:
                self.files.save(cell, marks)
        found = self._pack(marks)
        self._sets[cell] = found
        self._held += found.nbytes
        memory = MEMORY if self.options.memory is None else self.options.memory
        while self._held > memory and len(self._sets) > 1:
            self._held -= self._sets.popitem(last=False)[1].nbytes
        return found

    def size_of(self, cell: tuple[int, int]) -> int:
        """Splats of a cell's set.

        Raises:
            RenderError: the cell has no free place.
        """
        return self.open(cell).size

    def build(
        self, progress: Progress = no_progress, *, most: int | None = None
    ) -> Iterator[tuple[int, int]]:
        """Find the sets of all cells (or the first `most`) that the cache does not hold yet.

        Raises:
            RenderError: there is no cache to keep them in.
            StorageError: the cache cannot be written.
        """
        if self.files is None:
            raise RenderError("visible sets need the cache", remedy="leave cache=True")
        cells = self.cells[:most]
        for done, cell in enumerate(cells):
            progress("visible sets", done, len(cells))
            if self.files.load(cell) is None:
                self.files.save(cell, self.find(cell), strict=True)
            yield cell
        progress("visible sets", len(cells), len(cells))

    def find(self, cell: tuple[int, int]) -> NDArray[np.uint8]:
        """Which splats show from a cell: uint8 [N], 1 for those that do."""
        places = self._places[cell]
        marks = np.zeros(self.full.size, np.uint8)
        for camera, views in self.options.looks_from(places, self.eye_height):
            self.full.mark_visible(camera, views, self.options.threshold, marks)
        self._mark_near(places, marks)
        self.built += 1
        return marks

    def _mark_near(self, places: F64, marks: NDArray[np.uint8]) -> None:
        """Mark what a picture's `near` may have cut off: a cube's corner is at √3 near."""
        cloud, reach = self.full.cloud, self.options.near * math.sqrt(3)
        boxes = cloud.boxes
        for x, y in places:
            eye = np.array([x, y, self.eye_height], np.float32)
            gap = np.maximum(np.maximum(boxes[:, :3] - eye, eye - boxes[:, 3:6]), 0)
            for c in np.flatnonzero((gap**2).sum(axis=1) <= reach**2):
                means = cloud.pack[c].reshape(FIELDS, CHUNK)[:3].T
                lanes = np.flatnonzero(
                    (((means - eye) ** 2).sum(axis=1) <= reach**2)
                    & (cloud.pack[c].reshape(FIELDS, CHUNK)[REACH] >= 0)
                )
                marks[cloud.order[c * CHUNK + lanes]] = 1

    def _pack(self, marks: NDArray[np.uint8]) -> VisibleSet:
        """A contiguous copy of the marked splats, in packed order."""
        full = self.full.cloud
        lanes = np.flatnonzero(marks[full.order[: self._alive]])  # padding is at the end
        chunks = -(-len(lanes) // CHUNK)
        pack = np.empty((chunks, FIELDS * CHUNK), np.float32)
        boxes = np.empty((chunks, 7), np.float32)
        gather_chunks(full.pack, REACH, lanes, pack, boxes)
        order = np.zeros(chunks * CHUNK, np.int32)
        order[: len(lanes)] = full.order[lanes]
        return VisibleSet(
            PackedCloud(pack, boxes, order, full.sh, full.degree, full.ordered), len(lanes)
        )
