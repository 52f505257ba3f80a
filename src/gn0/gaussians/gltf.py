"""glTF with KHR_gaussian_splatting: .glb, and .gltf with its buffers inside or beside it.

Opacities are 0..1, quaternions x y z w, SH as in 3DGS. Scales are linear since the extension was
ratified; drafts (and splat-transform 2.6 and before) stored logs. Linear scales are never negative,
so one negative scale anywhere gives a draft away.

glTF has x left, y up, z forward; its writers turn splats into it by 180° about z. They are turned
back here, so that a cloud comes out as from the PLY it was made of.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.cloud_file import CloudBuilder, CloudFile
from gn0.gaussians.cloud_source import REFETCH, CloudSource, decode_json, little
from gn0.gaussians.gltf_buffers import FileBuffer, GltfBuffer, open_buffer
from gn0.gaussians.gltf_document import (
    GltfDocument,
    GltfPrimitive,
    GltfRows,
    find_rows,
    placed_meshes,
)
from gn0.gaussians.sh import MAX_DEGREE, sh_rotation
from gn0.gaussians.transform import transform_cloud
from gn0.geometry import F32, F64

EXTENSION = "KHR_gaussian_splatting"
FRAME = "as in the PLY it was made of, usually x right, y down, z forward (glTF: x left, y up)"
_TO_PLY = np.diag([-1.0, -1.0, 1.0, 1.0])
_SIGNS: F32 = np.diag(_TO_PLY)[:3].astype(np.float32)
_SH_SIGNS: F32 = np.rint(np.diag(sh_rotation(_TO_PLY[:3, :3], MAX_DEGREE))).astype("f4")[:, None]
_JSON_CHUNK, _BIN_CHUNK = b"JSON", b"BIN\0"
_CHUNK_LIMIT = 1 << 25
_TEXT_LIMIT = 1 << 30
_INSTANCES = 16  # one set of splats may be placed so often before it looks like a bomb
_PLACED_LIMIT = 4096  # primitives in a scene; real files have a handful
_BLOCK = 1 << 15  # Gaussians


class _Splatting(msgspec.Struct, frozen=True):
    """The extension's own object."""

    kernel: str = "ellipse"
    colorSpace: str = "srgb_rec709_display"  # noqa: N815 (the format's name)
    extensions: dict[str, msgspec.Raw] = {}


@dataclass(frozen=True)
class _Splats:
    """The rows of one primitive, and where they are placed."""

    means: GltfRows
    quats: GltfRows
    scales: GltfRows
    opacities: GltfRows
    sh: tuple[GltfRows, ...]
    colours: GltfRows | None  # instead of SH
    matrix: F64

    @property
    def degree(self) -> int:
        """SH degree."""
        return {0: 0, 1: 0, 4: 1, 9: 2, 16: 3}[len(self.sh)]


def decode_gltf(source: CloudSource) -> CloudFile:
    """Decode an open .gltf.

    Raises:
        FormatError: no splats inside, broken, or a buffer missing, cut off or unsafe.
    """
    if source.size > _TEXT_LIMIT:
        raise source.refuse(
            f"a .gltf of {source.size} bytes is text that must be read whole",
            remedy="write it as .glb, which is read piece by piece",
        )
    text = source.read(0, source.size, "the JSON")
    document = decode_json(text, GltfDocument, source.file, "glTF")
    return _decode(document, source, None, "text")


def decode_glb(source: CloudSource) -> CloudFile:
    """Decode an open .glb.

    Raises:
        FormatError: as `decode_gltf`, or the chunks do not fit the file.
    """
    header = source.read(0, 20, "the glTF header")
    version, total, length = little(header, 4, 4), little(header, 8, 4), little(header, 12, 4)
    if version != 2:
        raise source.refuse(f"binary glTF version {version} is not read (2 is)", 4)
    if total > source.size:
        raise source.refuse(
            f"file is truncated: it should have {total} bytes and has {source.size}",
            8,
            remedy=REFETCH,
        )
    if header[16:20] != _JSON_CHUNK or length > _CHUNK_LIMIT:
        raise source.refuse(f"the first chunk is not JSON of up to {_CHUNK_LIMIT} bytes", 12)
    text = source.read(20, length, "the JSON chunk")
    document = decode_json(text, GltfDocument, source.file, "glTF", offset=20)
    at = 20 + length
    binary = None
    if at + 8 <= total:
        chunk = source.read(at, 8, "a chunk header")
        held = little(chunk, 0, 4)
        if chunk[4:8] == _BIN_CHUNK:
            if at + 8 + held > source.size:
                raise source.refuse("the binary chunk runs past the file", at, remedy=REFETCH)
            binary = FileBuffer(source, at + 8, held)
    return _decode(document, source, binary, "binary")


def _decode(
    document: GltfDocument, source: CloudSource, binary: FileBuffer | None, encoding: str
) -> CloudFile:
    """The cloud of all splats that the scene places."""
    with ExitStack() as stack:
        buffers, size = _open_buffers(document, source, binary, stack)
        placed, notes = _find_splats(document, buffers, source)
        degree = max(splats.degree for splats in placed)
        total = sum(splats.means.count for splats in placed)
        builder = CloudBuilder(source.file, total, degree, source.limit_bytes, 0)
        logs = _scales_are_logs(placed)
        if logs:
            notes.append("scales are logs, as in drafts of the extension; they were taken as such")
        start = 0
        for splats in placed:
            for first in range(0, splats.means.count, _BLOCK):
                last = min(first + _BLOCK, splats.means.count)
                _put(builder, start + first, splats, first, last, logs, source)
            start += splats.means.count
    cloud, dropped = builder.build()
    return CloudFile(
        cloud=cloud,
        path=source.file,
        format="gltf",
        stored=total,
        dropped=dropped,
        sh_degree=degree,
        encoding=encoding,
        notes=tuple(notes),
        frame=FRAME,
        size=source.size + size,
    )


def _open_buffers(
    document: GltfDocument, source: CloudSource, binary: FileBuffer | None, stack: ExitStack
) -> tuple[list[GltfBuffer], int]:
    """All buffers, and the bytes of files beside the glTF."""
    buffers: list[GltfBuffer] = []
    size = 0
    for number, entry in enumerate(document.buffers):
        if entry.byteLength < 0:
            raise source.refuse("a buffer of negative length", field="buffers.byteLength")
        if bytes(memoryview(entry.uri)[:5]) not in (b"", b"null"):
            buffer, more = open_buffer(source, entry.uri, entry.byteLength, stack)
            buffers.append(buffer)
            size += more
        elif binary is not None and number == 0 and entry.byteLength <= binary.length:
            buffers.append(FileBuffer(binary.source, binary.start, entry.byteLength))
        else:
            held = binary.length if binary is not None and number == 0 else 0
            raise source.refuse(
                f"buffer {number} should have {entry.byteLength} bytes, and {held} are there",
                field="buffers",
                remedy=REFETCH,
            )
    return buffers, size


def _find_splats(
    document: GltfDocument, buffers: list[GltfBuffer], source: CloudSource
) -> tuple[list[_Splats], list[str]]:
    """All placed splats, and notes on what is unusual about them."""
    placed: list[_Splats] = []
    found: dict[tuple[int, int], _Splats] = {}
    others = 0
    notes: dict[str, None] = {}  # in order, each once
    for mesh, matrix in placed_meshes(document, source):
        for number, primitive in enumerate(document.meshes[mesh].primitives):
            if len(placed) + others >= _PLACED_LIMIT:
                raise source.refuse(
                    f"the scene places more than {_PLACED_LIMIT} primitives",
                    field="nodes",
                    remedy="join its splats into one primitive",
                )
            if EXTENSION not in primitive.extensions:
                others += 1
                continue
            if (mesh, number) in found:
                placed.append(replace(found[mesh, number], matrix=_TO_PLY @ matrix))
                continue
            splatting = decode_json(
                primitive.extensions[EXTENSION], _Splatting, source.file, EXTENSION
            )
            packed = [name for name in splatting.extensions if "compression" in name.lower()]
            if packed:
                raise source.refuse(
                    f"splats packed with {packed[0][:60]!r} are not supported",
                    field="extensions",
                    remedy="write the glTF without compression, or as .spz",
                )
            if splatting.kernel != "ellipse":
                notes[f"kernel {splatting.kernel[:40]!r} was taken as plain ellipses"] = None
            if splatting.colorSpace != "srgb_rec709_display":
                space = splatting.colorSpace[:40]
                notes[f"colours are {space!r}, not sRGB, and were taken as they are"] = None
            splats = _primitive(document, buffers, primitive, matrix, source)
            found[mesh, number] = splats
            if splats.colours is not None:
                notes["no SH: colours were taken from COLOR_0"] = None
            placed.append(splats)
    if not placed:
        raise source.refuse(
            f"this glTF holds no Gaussian splats ({EXTENSION}), but {others} other primitives",
            field="meshes",
            remedy="pass a splat file; a mesh must first be sampled or trained",
        )
    distinct = sum(splats.means.count for splats in found.values())
    total = sum(splats.means.count for splats in placed)
    if total > _INSTANCES * distinct:
        raise source.refuse(
            f"{distinct} Gaussians are placed as {total}: more than {_INSTANCES} copies",
            field="nodes",
        )
    if others:
        notes[f"{others} primitives that are not splats were left out"] = None
    return placed, list(notes)


def _primitive(
    document: GltfDocument,
    buffers: list[GltfBuffer],
    primitive: GltfPrimitive,
    matrix: F64,
    source: CloudSource,
) -> _Splats:
    """The rows of one primitive, all of one length."""
    attributes = primitive.attributes

    def rows(name: str, *widths: int) -> GltfRows:
        if name not in attributes:
            raise source.refuse("a splat primitive lacks an attribute", field=name)
        found = find_rows(document, buffers, attributes[name], widths, name, source)
        if name != "POSITION" and found.count != means.count:
            raise source.refuse(
                f"{found.count} rows for {means.count} positions: forged or broken", field=name
            )
        return found

    if primitive.mode != 0:
        raise source.refuse(f"splats are points (mode 0), not mode {primitive.mode}", field="mode")
    means = rows("POSITION", 3)
    sh: list[GltfRows] = []
    colours = None
    if f"{EXTENSION}:SH_DEGREE_0_COEF_0" in attributes:
        for degree in range(MAX_DEGREE + 1):
            names = [f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{i}" for i in range(2 * degree + 1)]
            if not any(name in attributes for name in names):
                break
            sh += [rows(name, 3) for name in names]
    else:
        colours = rows("COLOR_0", 3, 4)
    return _Splats(
        means=means,
        quats=rows(f"{EXTENSION}:ROTATION", 4),
        scales=rows(f"{EXTENSION}:SCALE", 3),
        opacities=rows(f"{EXTENSION}:OPACITY", 1),
        sh=tuple(sh),
        colours=colours,
        matrix=_TO_PLY @ matrix,
    )


def _scales_are_logs(placed: list[_Splats]) -> bool:
    """Whether scales are logs: some are negative, or they would all be nothing."""
    most = 0.0
    for splats in placed:
        for first in range(0, splats.scales.count, _BLOCK):
            block = splats.scales.read(first, min(first + _BLOCK, splats.scales.count))
            if (block < 0).any():
                return True
            most = max(most, float(np.max(block, initial=0.0, where=np.isfinite(block))))
    return most == 0.0


def _put(
    builder: CloudBuilder,
    start: int,
    splats: _Splats,
    first: int,
    last: int,
    logs: bool,
    source: CloudSource,
) -> None:
    """Decode, place and store one block."""
    rows = last - first
    sh = np.zeros((rows, builder.sh.shape[1], 3), np.float32)
    for k, coefficient in enumerate(splats.sh):
        sh[:, k] = coefficient.read(first, last)
    if splats.colours is not None:
        colours = splats.colours.read(first, last)[:, :3]
        sh[:, 0] = (colours - np.float32(0.5)) / np.float32(SH_C0)
    scales = splats.scales.read(first, last)
    opacities = splats.opacities.read(first, last)[:, 0]
    with np.errstate(all="ignore"):
        if logs:
            scales = np.exp(scales)
        outside = ~((opacities >= 0) & (opacities <= 1 + 1e-6))
        opacities = np.where(outside, np.float32(np.nan), np.minimum(opacities, np.float32(1)))
        quats = splats.quats.read(first, last)[:, [3, 0, 1, 2]]
        cloud = GaussianCloud(splats.means.read(first, last), quats, scales, opacities, sh)
        cloud = _place(cloud, splats.matrix, source)
    builder.put(
        start, cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.sh.reshape(rows, -1)
    )


def _place(cloud: GaussianCloud, matrix: F64, source: CloudSource) -> GaussianCloud:
    """A block of splats where its node puts it."""
    if np.array_equal(matrix, _TO_PLY):  # no node in the way: nothing but signs
        w, x, y, z = cloud.quats.T
        return GaussianCloud(
            cloud.means * _SIGNS,
            np.stack([-z, -y, x, w], axis=1),
            cloud.scales,
            cloud.opacities,
            cloud.sh * _SH_SIGNS[: cloud.sh.shape[1]],
        )
    linear: F64 = matrix[:3, :3]
    scale = float(np.cbrt(np.linalg.det(linear)))
    rest = linear @ linear.T - np.eye(3) * scale**2
    if not scale > 1e-30 or not (np.abs(rest) <= 1e-4 * scale**2).all():
        raise source.refuse(
            "a node mirrors, flattens or stretches its splats unevenly",
            field="nodes",
            remedy="apply the node's scale in the exporter",
        )
    left, _, right = np.linalg.svd(linear)
    return transform_cloud(cloud, rotation=left @ right, scale=scale, shift=matrix[:3, 3])
