"""Clothes of MakeHuman: an `.obj` and an `.mhclo` that says how it hangs on hm08.

Rules as read from the files of `makehuman-assets` (CC0): each vertex of the `.obj` has a row of
three body vertices, their weights and an offset scaled along each axis by a length of the body, or
one body vertex alone. What the `.obj` itself has for positions is of no use.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.makehuman.hm08 import METRES, VERTEX_COUNT
from gn0.avatars.makehuman.mesh_obj import load_obj
from gn0.errors import FormatError
from gn0.geometry import F64
from gn0.storage import plain_path, read_bytes, safe_join

_BYTES_MOST = 64 * 2**20
_AXES = ("x_scale", "y_scale", "z_scale")
_REMEDY = "save it again for hm08 with MakeClothes"


@dataclass(frozen=True, eq=False)
class Binding:
    """How N points hang on a body of 19,158 vertices.

    Attributes:
        refs: body vertices of each point [N, 3] int32.
        shares: their weights [N, 3], which sum to 1; some are negative.
        offsets: what is added [N, 3], in units of the body's lengths.
        lengths: the two body vertices [3, 2] whose distance along x, y, z is the unit of offsets.
        units: that distance on the body that the garment was made on [3], in the unit of offsets.
    """

    refs: NDArray[np.int32]
    shares: F64
    offsets: F64
    lengths: NDArray[np.int32]
    units: F64

    def fit(self, body: F64) -> F64:
        """Points [N, 3] m on a body of vertices [V, 3] m in the sculpted pose."""
        ends = body[self.lengths]
        axes = np.arange(3)
        scale = np.abs(ends[axes, 0, axes] - ends[axes, 1, axes]) / self.units
        return np.einsum("nk,nka->na", self.shares, body[self.refs]) + self.offsets * scale

    def carry(self, dense: F64) -> F64:
        """Skin weights [N, J] of the points, of those of the body's vertices [V, J].

        A point that hangs beyond its triangle takes no negative weight.
        """
        shares = np.clip(self.shares, 0.0, None)
        shares /= np.maximum(shares.sum(axis=1, keepdims=True), 1e-12)
        return np.einsum("nk,nkj->nj", shares, dense[self.refs])


@dataclass(frozen=True, eq=False)
class Cloth:
    """A garment, hair, brows or lashes, before they are on a body.

    Attributes:
        name: what its file calls it.
        binding: how its vertices hang on the body.
        faces: quads [F, 4] int32.
        uv: texture coordinates of their corners [F, 4, 2].
        covers: body vertices that it hides [M] int32.
        depth: drawing order; what is worn over has more.
    """

    name: str
    binding: Binding
    faces: NDArray[np.int32]
    uv: F64
    covers: NDArray[np.int32]
    depth: int


def load_mhclo(path: Path | str) -> Cloth:
    """A garment from an `.mhclo` and the `.obj` that it names.

    Raises:
        StorageError: a file cannot be read.
        FormatError: it is for another base mesh, names vertices that there are not, or its rows
            and the mesh do not fit each other.
    """
    file = plain_path(path)
    heads: dict[str, list[str]] = {}
    rows: list[list[float]] = []
    covers = np.zeros(VERTEX_COUNT, np.bool_)  # ranges may overlap, and be many
    section = "head"
    for number, line in enumerate(
        read_bytes(file, _BYTES_MOST).decode("utf-8", "replace").splitlines(), 1
    ):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        key = words[0]
        if key in ("verts", "delete_verts"):
            section = key
        elif section == "verts" and _is_number(key):
            rows.append(_row(words, file, number))
        elif section == "delete_verts" and key.isdecimal():
            for first, last in _ranges(words, file, number):
                covers[first : last + 1] = True
        else:  # a key may come between `verts` and its rows
            heads[key] = words[1:]
    base = " ".join(heads.get("basemesh", ["nothing"]))
    if base != "hm08":
        raise FormatError(
            f"made for base mesh {base}, not hm08", file=file, field="basemesh", remedy=_REMEDY
        )
    if not rows:
        raise FormatError("no row follows `verts`", file=file, field="verts", remedy=_REMEDY)
    if not heads.get("obj_file"):
        raise FormatError("no mesh is named", file=file, field="obj_file", remedy=_REMEDY)
    mesh = load_obj(safe_join(file.parent, heads["obj_file"][0]))
    if len(mesh.vertices) != len(rows):
        raise FormatError(
            f"{len(rows)} rows for {len(mesh.vertices)} vertices of {heads['obj_file'][0]}",
            file=file,
            field="verts",
            remedy=_REMEDY,
        )
    return Cloth(
        name=" ".join(heads.get("name", [file.stem])),
        binding=_binding(np.array(rows), heads, file),
        faces=mesh.faces,
        uv=mesh.uv,
        covers=np.flatnonzero(covers).astype(np.int32),
        depth=_whole(heads.get("z_depth", ["50"]), file),
    )


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _row(words: list[str], file: Path, number: int) -> list[float]:
    try:
        values = [float(word) for word in words]
        if len(values) == 1:
            values = [values[0]] * 3 + [1.0, 0.0, 0.0] + [0.0] * 3
        if len(values) != 9 or not np.isfinite(values).all():
            raise ValueError(f"{len(words)} numbers")
        if any(not 0 <= v < VERTEX_COUNT or v != int(v) for v in values[:3]):
            raise ValueError(f"vertices {words[:3]} of {VERTEX_COUNT}")
    except ValueError as error:
        raise FormatError(
            f"line {number} is not a row of a garment: {error}",
            file=file,
            field="verts",
            remedy="a row is i j k wi wj wk dx dy dz, or i alone",
        ) from None
    return values


def _ranges(words: list[str], file: Path, number: int) -> list[tuple[int, int]]:
    """Numbers and ranges `a - b`, as first and last."""
    found: list[tuple[int, int]] = []
    at = 0
    try:
        while at < len(words):
            first = last = int(words[at])
            at += 1
            if at < len(words) and words[at] == "-":
                last, at = int(words[at + 1]), at + 2
            if not 0 <= first <= last < VERTEX_COUNT:
                raise ValueError(f"{first} - {last} of {VERTEX_COUNT} vertices")
            found.append((first, last))
    except (ValueError, IndexError) as error:
        raise FormatError(
            f"line {number} does not list body vertices: {error}",
            file=file,
            field="delete_verts",
            remedy="list numbers and ranges, as 3 - 5 9",
        ) from None
    return found


def _binding(rows: F64, heads: dict[str, list[str]], file: Path) -> Binding:
    lengths, units = np.zeros((3, 2), np.int32), np.ones(3)
    for axis, key in enumerate(_AXES):
        words = heads.get(key, [])
        try:
            lengths[axis] = int(words[0]), int(words[1])
            units[axis] = float(words[2])
            if not (
                lengths[axis].min() >= 0
                and lengths[axis].max() < VERTEX_COUNT
                and 0 < units[axis] < np.inf
            ):
                raise ValueError(" ".join(words))
        except (ValueError, IndexError, OverflowError) as error:
            raise FormatError(
                f"no length of the body: {error}",
                file=file,
                field=key,
                remedy="two vertices, and their distance",
            ) from None
    return Binding(
        refs=rows[:, :3].astype(np.int32),
        shares=rows[:, 3:6],
        offsets=rows[:, 6:9] * METRES,
        lengths=lengths,
        units=units * METRES,
    )


def _whole(words: list[str], file: Path) -> int:
    try:
        depth = int(float(words[0]))
        if abs(depth) >= 2**31:
            raise ValueError(words[0])
    except (ValueError, IndexError, OverflowError):
        raise FormatError(
            f"{' '.join(words)[:40]!r} is not a depth", file=file, field="z_depth",
            remedy="give a whole number, 50 for most clothes",
        ) from None  # fmt: skip
    return depth
