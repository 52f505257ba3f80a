"""The JSON of a glTF as far as splats need it, and its accessors as rows of floats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.gaussians.cloud_source import CloudSource
from gn0.gaussians.gltf_buffers import GltfBuffer
from gn0.geometry import F32, F64

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_DEPTH_LIMIT = 1000


class GltfPrimitive(msgspec.Struct, frozen=True):
    """A set of points or triangles."""

    attributes: dict[str, int] = {}
    mode: int = 4
    extensions: dict[str, msgspec.Raw] = {}


class GltfMesh(msgspec.Struct, frozen=True):
    """A list of primitives."""

    primitives: list[GltfPrimitive]


class GltfNode(msgspec.Struct, frozen=True):
    """A place in the scene."""

    mesh: int | None = None
    children: list[int] = []
    matrix: list[float] | None = None
    translation: list[float] | None = None
    rotation: list[float] | None = None
    scale: list[float] | None = None


class GltfScene(msgspec.Struct, frozen=True):
    """Roots of a scene."""

    nodes: list[int] = []


class GltfBufferEntry(msgspec.Struct, frozen=True):
    """Where bytes are."""

    byteLength: int  # noqa: N815 (the format's names, here and below)
    uri: msgspec.Raw = msgspec.Raw()


class GltfView(msgspec.Struct, frozen=True):
    """A range of a buffer."""

    buffer: int
    byteLength: int  # noqa: N815
    byteOffset: int = 0  # noqa: N815
    byteStride: int | None = None  # noqa: N815


class GltfAccessor(msgspec.Struct, frozen=True):
    """Typed rows in a view."""

    componentType: int  # noqa: N815
    count: int
    type: str
    bufferView: int | None = None  # noqa: N815
    byteOffset: int = 0  # noqa: N815
    normalized: bool = False
    sparse: msgspec.Raw = msgspec.Raw()


class GltfDocument(msgspec.Struct, frozen=True):
    """A whole glTF, but for what has nothing to do with splats."""

    asset: dict[str, Any]
    scene: int | None = None
    scenes: list[GltfScene] = []
    nodes: list[GltfNode] = []
    meshes: list[GltfMesh] = []
    buffers: list[GltfBufferEntry] = []
    bufferViews: list[GltfView] = []  # noqa: N815
    accessors: list[GltfAccessor] = []
    extensionsRequired: list[str] = []  # noqa: N815


def placed_meshes(document: GltfDocument, source: CloudSource) -> list[tuple[int, F64]]:
    """(mesh, its matrix [4, 4] to the scene) of all nodes of the scene that is shown.

    Raises:
        FormatError: a node that is not there, is its own ancestor, or has no sound matrix.
    """
    nodes = document.nodes
    if document.scenes:
        number = document.scene or 0
        if not 0 <= number < len(document.scenes):
            raise source.refuse(f"there is no scene {number}", field="scene")
        roots = document.scenes[number].nodes
    else:
        inner = {child for node in nodes for child in node.children}
        roots = [i for i in range(len(nodes)) if i not in inner]
    placed: list[tuple[int, F64]] = []
    seen: set[int] = set()
    waiting = [(root, np.eye(4), 0) for root in reversed(roots)]
    while waiting:
        index, above, depth = waiting.pop()
        if not 0 <= index < len(nodes) or index in seen or depth > _DEPTH_LIMIT:
            raise source.refuse(f"node {index} is missing, or used twice", field="nodes")
        seen.add(index)
        node = nodes[index]
        with np.errstate(all="ignore"):
            matrix = above @ _local_matrix(node, index, source)
        if not np.isfinite(matrix).all():
            raise source.refuse(f"node {index} is placed by no finite matrix", field="nodes")
        if node.mesh is not None:
            if not 0 <= node.mesh < len(document.meshes):
                raise source.refuse(f"there is no mesh {node.mesh}", field="nodes.mesh")
            placed.append((node.mesh, matrix))
        waiting += [(child, matrix, depth + 1) for child in reversed(node.children)]
    return placed


def _local_matrix(node: GltfNode, index: int, source: CloudSource) -> F64:
    """Matrix [4, 4] of one node."""

    def values(name: str, count: int) -> F64:
        given = getattr(node, name)
        if len(given) != count:
            raise source.refuse(f"node {index} has {len(given)} values, not {count}", field=name)
        return np.array(given, np.float64)

    if node.matrix is not None:
        return values("matrix", 16).reshape(4, 4).T
    matrix = np.eye(4)
    if node.rotation is not None:
        x, y, z, w = values("rotation", 4)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    if node.scale is not None:
        matrix[:3, :3] *= values("scale", 3)
    if node.translation is not None:
        matrix[:3, 3] = values("translation", 3)
    return matrix


@dataclass(frozen=True)
class GltfRows:
    """Rows of one accessor, its place checked against the buffer.

    Attributes:
        buffer: where the bytes are.
        start: byte of the first row.
        stride: bytes from row to row.
        count: rows.
        width: values a row.
        dtype: type of a value.
        normalized: whether integers stand for fractions.
    """

    buffer: GltfBuffer
    start: int
    stride: int
    count: int
    width: int
    dtype: np.dtype[Any]
    normalized: bool

    def read(self, first: int, last: int) -> F32:
        """Rows [last − first, width] as float32."""
        row = self.width * self.dtype.itemsize
        data = self.buffer.read(
            self.start + first * self.stride, (last - first - 1) * self.stride + row
        )
        rows: NDArray[Any] = np.ndarray(
            (last - first, self.width), self.dtype, data, strides=(self.stride, self.dtype.itemsize)
        )
        values = rows.astype(np.float32)
        if self.normalized and self.dtype.kind in "iu":
            values /= np.float32(np.iinfo(self.dtype).max)
            np.maximum(values, np.float32(-1), out=values)
        return values


def find_rows(
    document: GltfDocument,
    buffers: list[GltfBuffer],
    number: int,
    widths: tuple[int, ...],
    name: str,
    source: CloudSource,
) -> GltfRows:
    """The rows of accessor `number`.

    Args:
        document: the glTF.
        buffers: its buffers.
        number: the accessor.
        widths: values a row that are allowed.
        name: the attribute, for messages.
        source: the file, for messages.

    Raises:
        FormatError: missing, of another type, sparse, or outside its view or buffer.
    """

    def refuse(what: str) -> FormatError:
        return source.refuse(f"accessor {number}: {what}", field=name)

    if not 0 <= number < len(document.accessors):
        raise refuse("there is none")
    accessor = document.accessors[number]
    if bytes(accessor.sparse) not in (b"", b"null") or accessor.bufferView is None:
        raise refuse("sparse accessors, and those without a bufferView, are not read for splats")
    if accessor.componentType not in _COMPONENTS or accessor.type not in _WIDTHS:
        raise refuse(f"unknown type {accessor.componentType} {accessor.type[:20]!r}")
    width, dtype = _WIDTHS[accessor.type], np.dtype(_COMPONENTS[accessor.componentType])
    if width not in widths:
        raise refuse(f"has {width} values a row, not {' or '.join(map(str, widths))}")
    if not 0 <= accessor.bufferView < len(document.bufferViews):
        raise refuse(f"there is no bufferView {accessor.bufferView}")
    view = document.bufferViews[accessor.bufferView]
    if not 0 <= view.buffer < len(buffers):
        raise refuse(f"there is no buffer {view.buffer}")
    buffer = buffers[view.buffer]
    row = width * dtype.itemsize
    stride = view.byteStride or row
    if not row <= stride <= 1 << 16 or accessor.count < 1:
        raise refuse(f"{accessor.count} rows {stride} bytes apart, of {row} bytes each")
    need = accessor.byteOffset + (accessor.count - 1) * stride + row
    places = (accessor.byteOffset, view.byteOffset, view.byteLength)
    if (
        min(places) < 0
        or need > view.byteLength
        or (view.byteOffset + view.byteLength > buffer.length)
    ):
        raise refuse(
            f"{accessor.count} rows need {need} bytes of a view of {view.byteLength} at byte "
            f"{view.byteOffset} of a buffer of {buffer.length}: truncated or forged"
        )
    start = view.byteOffset + accessor.byteOffset
    return GltfRows(buffer, start, stride, accessor.count, width, dtype, accessor.normalized)
