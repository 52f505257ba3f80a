"""PLY splat files in every dialect that writers are known to produce, built in memory.

The dialects follow the property orders, types and extras of real exporters; the values come from
one small seeded cloud, so that every dialect can be compared with the same truth.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.cloud_file import CloudFile, logit
from gn0.gaussians.ply import log_scales
from gn0.gaussians.ply_packed import save_ply_packed
from gn0.gaussians.splat_files import load_cloud
from gn0.seeds import random_stream
from gn0_trials.fuzz import FuzzTarget

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
DC = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALE = ("scale_0", "scale_1", "scale_2")
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
_TYPES = {"float": "f4", "float32": "f4", "double": "f8", "uchar": "u1", "int": "i4", "short": "i2"}
_TOKENS = (
    b"ply", b"format", b"ascii", b"binary_little_endian", b"binary_big_endian", b"1.0", b"comment",
    b"obj_info", b"element", b"vertex", b"chunk", b"sh", b"face", b"property", b"list", b"char",
    b"uchar", b"short", b"ushort", b"int", b"uint", b"float", b"double", b"float64", b"uint8",
    b"end_header", b"x", b"rot_0", b"scale_2", b"opacity", b"f_dc_0", b"f_rest_0", b"f_rest_44",
    b"packed_position", b"packed_color", b"min_x", b"max_b", b"end_header\r",
)  # fmt: skip


def rest(degree: int) -> tuple[str, ...]:
    """f_rest names of an SH degree, in order."""
    return tuple(f"f_rest_{i}" for i in range(3 * (degree + 1) ** 2 - 3))


@dataclass(frozen=True)
class PlyDialect:
    """How one kind of writer lays a splat PLY out.

    Attributes:
        order: vertex properties in file order; names unknown to splats are filled with numbers.
        encoding: ascii, binary_little_endian or binary_big_endian.
        types: type word by property; float where absent.
        line_end: line end of the header (and of ascii data).
        head: header lines after the format line, before the vertex element.
        before: (header lines, data) of an element before the vertices.
        after: (header lines, data) of an element after them.
        trailing: bytes after all data.
    """

    order: Sequence[str]
    encoding: str = "binary_little_endian"
    types: dict[str, str] = field(default_factory=dict)
    line_end: str = "\n"
    head: Sequence[str] = ()
    before: tuple[Sequence[str], bytes] = ((), b"")
    after: tuple[Sequence[str], bytes] = ((), b"")
    trailing: bytes = b""


def small_cloud(count: int = 5, degree: int = 3, seed: int = 0) -> GaussianCloud:
    """A seeded cloud of sound Gaussians."""
    rng = random_stream(seed, "splat corpus", count, degree)
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return GaussianCloud(
        means=rng.normal(0, 3, (count, 3)).astype(np.float32),
        quats=quats.astype(np.float32),
        scales=np.exp(rng.normal(-4, 1, (count, 3))).astype(np.float32),
        opacities=rng.uniform(0.02, 0.98, count).astype(np.float32),
        sh=rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def ply_columns(cloud: GaussianCloud) -> dict[str, NDArray[np.float32]]:
    """Stored values of a cloud by 3DGS PLY property name."""
    columns: dict[str, NDArray[np.float32]] = {"opacity": logit(cloud.opacities)}
    logs = log_scales(cloud.scales)
    for i in range(3):
        columns[POSITION[i]] = cloud.means[:, i]
        columns[SCALE[i]] = logs[:, i]
        columns[DC[i]] = cloud.sh[:, 0, i]
        columns[NORMAL[i]] = np.zeros(len(cloud), np.float32)
    for i in range(4):
        columns[ROTATION[i]] = cloud.quats[:, i]
    per_channel = cloud.sh.shape[1] - 1
    for channel in range(3):
        for k in range(per_channel):
            columns[f"f_rest_{channel * per_channel + k}"] = cloud.sh[:, 1 + k, channel]
    return columns


def build_ply(dialect: PlyDialect, columns: dict[str, NDArray[Any]]) -> bytes:
    """A PLY file of a dialect; columns that the dialect names but that are not given get filler."""
    count = len(next(iter(columns.values())))
    values = {n: columns.get(n, np.arange(count) % 100) for n in dialect.order}
    lines = ["ply", f"format {dialect.encoding} 1.0", *dialect.head, *dialect.before[0]]
    lines += [f"element vertex {count}"]
    lines += [f"property {dialect.types.get(n, 'float')} {n}" for n in dialect.order]
    lines += [*dialect.after[0], "end_header", ""]
    header = dialect.line_end.join(lines).encode("utf-8")
    if dialect.encoding == "ascii":
        rows = [" ".join(f"{values[n][i]:.9g}" for n in dialect.order) for i in range(count)]
        body = (dialect.line_end.join(rows) + dialect.line_end).encode()
    else:
        order = ">" if "big" in dialect.encoding else "<"
        kinds = [(n, order + _TYPES[dialect.types.get(n, "float")]) for n in dialect.order]
        table = np.empty(count, np.dtype(kinds))
        for n in dialect.order:
            table[n] = values[n]
        body = table.tobytes()
    return header + dialect.before[1] + body + dialect.after[1] + dialect.trailing


_INRIA = (*POSITION, *NORMAL, *DC, *rest(3), "opacity", *SCALE, *ROTATION)
_BRUSH = (*DC, *sorted(rest(3)), "opacity", *ROTATION, *SCALE, *POSITION)
_PLAIN = (*POSITION, *DC, "opacity", *SCALE, *ROTATION)
_FACES = (
    ["element face 2", "property list uchar int vertex_indices"],
    b"\x03" + np.array([0, 1, 2], "<i4").tobytes() + b"\x01" + np.array([0], "<i4").tobytes(),
)
_CAMERA = (["element camera 1", "property float fx", "property double t"], b"\0" * 12)

DIALECTS: dict[str, PlyDialect] = {
    "inria-sh3": PlyDialect(_INRIA),
    "inria-sh2": PlyDialect((*POSITION, *NORMAL, *DC, *rest(2), "opacity", *SCALE, *ROTATION)),
    "inria-sh1": PlyDialect((*POSITION, *NORMAL, *DC, *rest(1), "opacity", *SCALE, *ROTATION)),
    "inria-sh0": PlyDialect((*POSITION, *NORMAL, *DC, "opacity", *SCALE, *ROTATION)),
    "brush": PlyDialect(_BRUSH, head=["comment Exported from Brush", "comment Vertical axis: y"]),
    "no-normals": PlyDialect((*POSITION, *DC, *rest(3), "opacity", *SCALE, *ROTATION)),
    "supersplat": PlyDialect(
        (*POSITION, *DC, "opacity", *ROTATION, *SCALE, *rest(3)),
        head=["comment Generated by SuperSplat 2.7.1"],
    ),
    "nerfstudio": PlyDialect(
        _INRIA, head=["comment Generated by Nerfstudio 1.1.5", "comment Vertical Axis: z"]
    ),
    "rotation-first": PlyDialect((*ROTATION, *SCALE, "opacity", *DC, *POSITION)),
    "reversed": PlyDialect(tuple(reversed(_INRIA))),
    "rest-before-dc": PlyDialect((*POSITION, *rest(1), *DC, "opacity", *SCALE, *ROTATION)),
    "interleaved-rest": PlyDialect(
        (*POSITION, *DC, *[f"f_rest_{c * 3 + k}" for k in range(3) for c in range(3)],
         "opacity", *SCALE, *ROTATION)
    ),
    "ascii": PlyDialect(_PLAIN, "ascii"),
    "ascii-sh3": PlyDialect(_INRIA, "ascii"),
    "ascii-crlf": PlyDialect(_PLAIN, "ascii", line_end="\r\n"),
    "ascii-cr": PlyDialect(_PLAIN, "ascii", line_end="\r"),
    "ascii-face-first": PlyDialect(
        _PLAIN, "ascii",
        before=(["element face 2", "property list uchar int vertex_indices"], b"3 0 1 2\n1 0\n"),
    ),
    "big-endian": PlyDialect(_INRIA, "binary_big_endian"),
    "big-endian-sh0": PlyDialect(_PLAIN, "binary_big_endian"),
    "crlf": PlyDialect(_PLAIN, line_end="\r\n"),
    "cr": PlyDialect(_PLAIN, line_end="\r"),
    "comments": PlyDialect(
        _PLAIN, head=["comment", "comment element vertex 9", "comment größe end_header",
                      "obj_info num_cols 5", "comment  spaced  out "]
    ),
    "double": PlyDialect(_PLAIN, types=dict.fromkeys(_PLAIN, "double")),
    "double-position": PlyDialect(_PLAIN, types=dict.fromkeys(POSITION, "double")),
    "float32-names": PlyDialect(_PLAIN, types=dict.fromkeys(_PLAIN, "float32")),
    "big-endian-mixed": PlyDialect(
        (*_PLAIN, "label"), "binary_big_endian", types={"x": "double", "label": "short"}
    ),
    "with-rgb": PlyDialect(
        (*POSITION, "red", "green", "blue", *DC, "opacity", *SCALE, *ROTATION),
        types=dict.fromkeys(("red", "green", "blue"), "uchar"),
    ),
    "extra-floats": PlyDialect((*_PLAIN, "filter_3D", "semantic_0", "confidence")),
    "extra-int-first": PlyDialect(("id", *_PLAIN), types={"id": "int"}),
    "camera-before": PlyDialect(_PLAIN, before=_CAMERA),
    "faces-before": PlyDialect(_PLAIN, before=_FACES),
    "faces-after": PlyDialect(_PLAIN, after=_FACES),
    "empty-element": PlyDialect(_PLAIN, before=(["element nothing 0"], b"")),
    "no-property-element": PlyDialect(_PLAIN, before=(["element blank 4"], b"")),
    "trailing-bytes": PlyDialect(_PLAIN, trailing=b"\0\0\0"),
    "padded-header": PlyDialect(_PLAIN, head=["comment x", "", "  comment indented"]),
}  # fmt: skip


def dialect_degree(dialect: PlyDialect) -> int:
    """SH degree that a dialect carries."""
    count = sum(name.startswith("f_rest_") for name in dialect.order)
    return {0: 0, 9: 1, 24: 2, 45: 3}[count]


def check_cloud_file(file: CloudFile) -> None:
    """Assert what every accepted file promises: finite, normalised, in range, counted.

    Raises:
        AssertionError: it does not.
    """
    cloud = file.cloud
    assert 0 < len(cloud) == file.stored - file.dropped
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert np.isfinite(getattr(cloud, name)).all(), f"{name} not finite"
    norms = np.linalg.norm(cloud.quats.astype(np.float64), axis=1)
    assert np.abs(norms - 1).max() < 1e-5, "quaternions not normalised"
    assert (cloud.scales >= 0).all(), "negative scale"
    assert ((cloud.opacities >= 0) & (cloud.opacities <= 1)).all(), "opacity out of range"


def ply_target() -> FuzzTarget:
    """Fuzz target: all dialects of 3DGS PLY."""
    corpus = {
        name: build_ply(dialect, ply_columns(small_cloud(5, dialect_degree(dialect))))
        for name, dialect in DIALECTS.items()
    }
    return FuzzTarget("ply", load_cloud, corpus, check_cloud_file, _TOKENS, ".ply")


def packed_file(cloud: GaussianCloud) -> bytes:
    """The bytes of a cloud as compressed PLY."""
    return _saved(lambda path: save_ply_packed(cloud, path))


def ply_packed_target() -> FuzzTarget:
    """Fuzz target: compressed PLY with 12- and 18-field chunks, with and without SH."""
    corpus = {
        f"sh{degree}-{count}": packed_file(small_cloud(count, degree))
        for degree, count in ((0, 5), (1, 5), (2, 3), (3, 2), (0, 257))
    }
    corpus["sh0-12-fields"] = without_colour_bounds(corpus["sh0-5"])
    return FuzzTarget("ply-packed", load_cloud, corpus, check_cloud_file, _TOKENS, ".ply")


def without_colour_bounds(packed: bytes) -> bytes:
    """The same compressed PLY with 12-field chunks, as older writers made them."""
    head, _, data = packed.partition(b"end_header\n")
    lines = [s for s in head.split(b"\n") if not s.endswith(tuple(b"_r _g _b".split()))]
    chunks = int(next(s for s in lines if s.startswith(b"element chunk")).split()[2])
    table = np.frombuffer(data[: chunks * 72], "<f4").reshape(chunks, 18)
    return b"\n".join(lines) + b"end_header\n" + table[:, :12].tobytes() + data[chunks * 72 :]


def _saved(save: Callable[[Path], Any]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.ply"
        save(path)
        return path.read_bytes()
