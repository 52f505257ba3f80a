"""Wavefront meshes of MakeHuman: vertices, faces of three or four corners, groups."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.geometry import F64
from gn0.storage import read_bytes

_BYTES_MOST = 64 * 2**20


@dataclass(frozen=True, eq=False)
class QuadMesh:
    """A mesh of quads, as MakeHuman has them.

    Attributes:
        vertices: [V, 3], in the file's unit.
        faces: corners [F, 4] int32; a triangle repeats its last one.
        uv: texture coordinates of the corners [F, 4, 2] float64, zeros where there are none.
        group: number of each face's group [F] int32.
        groups: names of groups, in the order in which they begin.
    """

    vertices: F64
    faces: NDArray[np.int32]
    uv: F64
    group: NDArray[np.int32]
    groups: tuple[str, ...]

    def group_faces(self, name: str) -> NDArray[np.int32]:
        """Corners [F, 4] of the faces of a group; none where there is no such group."""
        return self.faces[self.group == (self.groups.index(name) if name in self.groups else -1)]


def load_obj(path: Path | str) -> QuadMesh:
    """A mesh of triangles and quads from an `.obj` file; materials and normals are passed over.

    Raises:
        StorageError: the file cannot be read.
        FormatError: a line is not what the format says, or names a vertex that there is not.
    """
    name = str(path)
    lines = read_bytes(path, _BYTES_MOST).decode("utf-8", "replace").splitlines()
    points: list[list[float]] = []
    textures: list[list[float]] = []
    faces: list[list[int]] = []
    corners: list[list[int]] = []
    group: list[int] = []
    groups: dict[str, int] = {}
    for row, line in enumerate(lines, 1):
        words = line.split()
        if not words:
            continue
        key = words[0]
        try:
            if key == "v":
                points.append([float(word) for word in words[1:4]])
                if len(points[-1]) < 3:
                    raise ValueError("fewer than three coordinates")
            elif key == "vt":
                textures.append([float(word) for word in words[1:3]])
                if len(textures[-1]) < 2:
                    raise ValueError("fewer than two coordinates")
            elif key == "g":
                groups.setdefault(" ".join(words[1:]), len(groups))
                current = groups[" ".join(words[1:])]
            elif key == "f":
                if not 4 <= len(words) <= 5:
                    raise ValueError(f"a face of {len(words) - 1} corners")
                pairs = [[*word.split("/"), ""][:2] for word in words[1:]]
                face = [int(pair[0]) for pair in pairs]
                corner = [int(pair[1]) if pair[1] else 0 for pair in pairs]
                if max(map(abs, face + corner)) >= 2**31:
                    raise ValueError("a number too large for a vertex")
                faces.append(face + face[-1:] * (4 - len(face)))
                corners.append(corner + corner[-1:] * (4 - len(corner)))
                group.append(current if groups else 0)
        except ValueError as error:
            raise FormatError(
                f"line {row} is not valid: {error}",
                file=name,
                field=key,
                remedy="export triangles and quads only",
            ) from None
    vertices = np.array(points, np.float64).reshape(-1, 3)
    corner_index = np.array(faces, np.int64).reshape(-1, 4) - 1
    texture = np.array(textures, np.float64).reshape(-1, 2)
    texture_index = np.array(corners, np.int64).reshape(-1, 4) - 1
    if not np.isfinite(vertices).all() or not np.isfinite(texture).all():
        raise FormatError(
            "a coordinate is not finite", file=name, field="v", remedy="export the mesh again"
        )
    for index, size, field in (
        (corner_index, len(vertices), "f"),
        (texture_index + 1, len(texture) + 1, "f (vt)"),
    ):
        if len(index) and (index.min() < 0 or index.max() >= size):
            bad = int(np.flatnonzero(((index < 0) | (index >= size)).any(axis=1))[0])
            raise FormatError(
                f"face {bad} names a vertex that there is not (of {size})",
                file=name,
                field=field,
                remedy="indices count from 1; relative ones are not read",
            )
    uv = np.concatenate([np.zeros((1, 2)), texture])[texture_index + 1]
    return QuadMesh(
        vertices,
        corner_index.astype(np.int32),
        uv,
        np.array(group, np.int32),
        tuple(groups) or ("",),
    )


def triangles_of(faces: NDArray[np.integer]) -> NDArray[np.int32]:
    """Triangles [T, 3] of quads [F, 4], two each, or one where the last corner is repeated.

    The triangles of a face follow each other.
    """
    both = np.stack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]], axis=1)
    keep = np.ones((len(faces), 2), bool)
    keep[:, 1] = faces[:, 2] != faces[:, 3]
    return np.ascontiguousarray(both[keep], np.int32)
