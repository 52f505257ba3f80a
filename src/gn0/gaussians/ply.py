"""3DGS PLY: splats as Kerbl et al. (2023) store them, read in every dialect met and written back.

Properties are found by name, never by place: x y z, f_dc_0..2, optional f_rest_*, opacity (a
logit), scale_0..2 (logs), rot_0..3 (w, x, y, z, of any length). Conventions for the edges, shared
with splat-transform: opacity ±inf means opaque or invisible, scale −inf a flat Gaussian; every
other non-finite value, and a zero quaternion, drops its Gaussian.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.cloud_file import CloudBuilder, CloudFile, logit, sigmoid
from gn0.gaussians.ply_header import PlyElement, PlyHeader
from gn0.gaussians.ply_rows import PlySource, iterate_rows, note_trailing_bytes
from gn0.gaussians.sh import MAX_DEGREE, degree_of_rest, rest_columns
from gn0.geometry import F32
from gn0.storage import plain_path, write_atomic

_MEANS = ("x", "y", "z")
_SCALES = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_REQUIRED = (*_MEANS, *_SCALES, *_ROTATION, "opacity", *_DC)
_REST = re.compile(r"f_rest_(0|[1-9][0-9]{0,4})\Z")
ENCODINGS = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}
_WRITE_ROWS = 1 << 14
MIN_LOG_SCALE = -80.0  # e^-80 m: what a scale of exactly zero is written as


def decode_ply(source: PlySource, limit_bytes: int | None = None) -> CloudFile:
    """Decode an open 3DGS PLY.

    SH of a degree above 3 is cut to 3, and a note says so.

    Args:
        source: the open file.
        limit_bytes: the largest decoded size allowed, if any.

    Raises:
        FormatError: not a splat file (it says what it is instead), or broken.
    """
    vertex = source.header.find("vertex")
    if vertex is None or not set(_REQUIRED) <= set(vertex.names):
        vertex = _require_splats(source, vertex)
    if vertex.has_lists:
        name = next(p.name for p in vertex.properties if p.count_type)
        raise FormatError(
            "a vertex property is a list; splat rows have a fixed size",
            file=source.file,
            offset=vertex.offset,
            field=name,
            remedy="export the splats again as a plain 3DGS PLY",
        )
    degree = _sh_degree(source.file, vertex)
    kept = min(degree, MAX_DEGREE)
    flat = "scale_2" not in vertex.names
    rest = [f"f_rest_{i}" for i in rest_columns(degree, kept)]
    scales = _SCALES[:2] if flat else _SCALES
    names = (*_MEANS, *_ROTATION, *scales, "opacity", *_DC)
    builder = CloudBuilder(source.file, vertex.count, kept, limit_bytes, vertex.offset)
    a = 7 + len(scales)
    for start, rows in iterate_rows(source, vertex, (*names, *rest), np.float32):
        linear = np.zeros((len(rows), 3), np.float32)
        with np.errstate(over="ignore", invalid="ignore"):
            np.exp(rows[:, 7:a], out=linear[:, : len(scales)])
            opacities = sigmoid(rows[:, a])
        builder.put(start, rows[:, 0:3], rows[:, 3:7], linear, opacities, rows[:, a + 1 :])
    cloud, dropped = builder.build()
    notes = list(note_trailing_bytes(source))
    if degree > kept:
        notes.append(f"SH degree {degree} cut to {kept}")
    if flat:
        notes.append("two scales a splat (2D Gaussians): the third is 0")
    return CloudFile(
        cloud=cloud,
        path=source.file,
        format="ply",
        stored=vertex.count,
        dropped=dropped,
        sh_degree=degree,
        encoding=ENCODINGS[source.header.byte_order],
        comments=source.header.comments,
        extra_properties=unused_properties(vertex, {*names, *_rest_names(degree)}),
        extra_elements=unused_elements(source.header, {"vertex"}),
        notes=tuple(notes),
    )


def unused_properties(element: PlyElement, used: set[str]) -> tuple[str, ...]:
    """Property names of an element that decoding did not use."""
    return tuple(name for name in element.names if name not in used)


def unused_elements(header: PlyHeader, used: set[str]) -> tuple[tuple[str, int], ...]:
    """(name, rows) of elements that decoding did not use."""
    return tuple((e.name, e.count) for e in header.elements if e.name not in used)


def save_ply(cloud: GaussianCloud, path: Path | str, *, comments: Sequence[str] = ()) -> None:
    """Write a cloud as binary little-endian 3DGS PLY, in its own order, atomically.

    Opacities of exactly 0 and 1 and scales of 0 are written as finite values that decode to the
    same.

    Args:
        cloud: the Gaussians.
        path: the file to write.
        comments: comment lines for the header.

    Raises:
        FormatError: the cloud is empty or holds values that no reader would keep.
        StorageError: the file cannot be written.
    """
    path = plain_path(path)
    check_writable(cloud, path)
    rest = _rest_names(cloud.sh_degree)
    names = (*_MEANS, *_DC, *rest, "opacity", *_SCALES, *_ROTATION)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *comment_lines(comments),
        f"element vertex {len(cloud)}",
        *(f"property float {name}" for name in names),
        "end_header",
    ]

    def write(stream: IO[bytes]) -> None:
        stream.write(("\n".join(header) + "\n").encode("utf-8"))
        r = len(rest)
        for start in range(0, len(cloud), _WRITE_ROWS):
            span = slice(start, start + _WRITE_ROWS)
            rows = np.empty((len(cloud.means[span]), len(names)), "<f4")
            rows[:, 0:3] = cloud.means[span]
            rows[:, 3:6] = cloud.sh[span, 0]
            # channel-last to channel by channel
            rows[:, 6 : 6 + r] = cloud.sh[span, 1:].transpose(0, 2, 1).reshape(len(rows), r)
            rows[:, 6 + r] = logit(cloud.opacities[span])
            rows[:, 7 + r : 10 + r] = log_scales(cloud.scales[span])
            rows[:, 10 + r :] = cloud.quats[span]
            stream.write(rows.data.cast("B"))

    write_atomic(path, write)


def log_scales(scales: F32) -> F32:
    """Logs of linear scales [N, 3], exact zeros as `MIN_LOG_SCALE`."""
    with np.errstate(divide="ignore"):
        return np.maximum(np.log(scales.astype(np.float64)), MIN_LOG_SCALE).astype(np.float32)


def comment_lines(comments: Sequence[str]) -> list[str]:
    """Header lines for comments; a line break within one starts another line."""
    return [f"comment {line.strip()}" for text in comments for line in text.splitlines()]


def check_writable(cloud: GaussianCloud, path: Path) -> None:
    """Refuse to write what our own reader would refuse or drop.

    Raises:
        FormatError: empty, non-finite values, zero quaternions, negative scales, or opacities
            outside 0..1.
    """
    if not len(cloud):
        raise FormatError("the cloud holds no Gaussians", file=path, remedy="nothing was written")
    checks: dict[str, Callable[[F32], NDArray[np.bool_]]] = {
        "means": np.isfinite,
        "quats": lambda q: np.isfinite(q) & (q != 0).any(axis=-1, keepdims=True),
        "scales": lambda s: np.isfinite(s) & (s >= 0),
        "opacities": lambda o: (o >= 0) & (o <= 1),
        "sh": np.isfinite,
    }
    for name, check in checks.items():
        with np.errstate(invalid="ignore"):
            good = check(getattr(cloud, name))
        if not good.all():
            row = int(np.argmin(good.reshape(len(cloud), -1).all(axis=1)))
            raise FormatError(
                f"Gaussian {row} of the cloud has {name} out of range; nothing was written",
                file=path,
                field=name,
                remedy="drop such Gaussians first",
            )


def _rest_names(degree: int) -> list[str]:
    return [f"f_rest_{i}" for i in range(3 * (degree + 1) ** 2 - 3)]


def _sh_degree(file: Path, vertex: PlyElement) -> int:
    """SH degree of the f_rest properties, which must be 0..N−1 for a whole degree."""
    found: set[int] = set()
    for name in vertex.names:
        if not name.startswith("f_rest_"):
            continue
        match = _REST.match(name)
        if match is None:
            raise FormatError(
                "bad SH property name: f_rest_ is followed by a plain number",
                file=file,
                offset=vertex.offset,
                field=name,
                remedy="export the splats again",
            )
        found.add(int(match[1]))
    degree = degree_of_rest(len(found))
    missing = set(range(len(found))) - found
    if degree is not None and not missing:
        return degree
    if missing:
        what = f"SH properties have a gap: f_rest_{min(missing)} is missing"
    else:
        what = f"{len(found)} f_rest properties fit no SH degree (0, 9, 24, 45, 72 do)"
    raise FormatError(
        what,
        file=file,
        offset=vertex.offset,
        field="f_rest",
        remedy="export the splats again",
    )


def _require_splats(source: PlySource, vertex: PlyElement | None) -> PlyElement:
    """The vertex element if it is a dialect of splats; else an error that says what it is."""
    names = set(vertex.names) if vertex is not None else set()
    missing = [name for name in _REQUIRED if name not in names]
    if vertex is not None and missing == ["scale_2"]:
        return vertex  # 2D Gaussian Splatting: two scales, a flat disc
    has_faces = any(e.name in ("face", "tristrips", "edge") for e in source.header.elements)
    splatty = any(n.startswith(("scale_", "rot_", "f_dc_", "f_rest_", "packed_")) for n in names)
    remedy = "pass a 3DGS splat file; a point cloud or mesh must first be trained or sampled"
    if vertex is None:
        found = ", ".join(e.name for e in source.header.elements[:5]) or "none"
        what = f"this PLY has no vertex element (elements: {found})"
    elif splatty:
        what = f"splat properties are missing: {', '.join(missing)}"
        remedy = "export the splats again with all properties"
    elif has_faces and set(_MEANS) <= names:
        what = "this is a mesh, not a splat file: it has faces and no scales or rotations"
    elif set(_MEANS) <= names:
        what = "this is a point cloud, not a splat file: no scales, rotations or opacities"
    else:
        what = f"this PLY is not a splat file: vertex lacks {', '.join(missing[:4])} and more"
    raise FormatError(
        what,
        file=source.file,
        offset=vertex.offset if vertex is not None else 0,
        field=missing[0] if vertex is not None else "vertex",
        remedy=remedy,
    )
