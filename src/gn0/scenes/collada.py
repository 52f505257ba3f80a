"""COLLADA meshes: triangles in metres with z up, texture coordinates, colour or texture name.

A thin use of pycollada behind our own guarded XML parser. The two traps of the format are handled
here: coordinates are multiplied by `<unit meter="…">` and turned by `<up_axis>`.
"""

from __future__ import annotations

import io
import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.geometry import F32, F64
from gn0.scenes.xml import check_xml
from gn0.storage import read_bytes

_SIZE_MAX = 256 * 2**20  # bytes
_FACES_MAX = 20_000_000
_UP = {  # rows: new x, y, z of the file's axes (COLLADA 1.4.1, up_axis)
    "Z_UP": np.eye(3),
    "Y_UP": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "X_UP": np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]),
}


@dataclass(frozen=True, eq=False)
class ColladaPart:
    """Triangles of one material.

    Attributes:
        vertices: [V, 3] m, z up.
        faces: [F, 3] int32.
        uv: texture coordinates per corner [F, 3, 2], v up; zeros where the file has none.
        colour: diffuse colour (r, g, b) in 0..1 as written, display values.
        texture: path of the diffuse texture as written, "" without one.
    """

    vertices: F64
    faces: NDArray[np.int32]
    uv: F32
    colour: tuple[float, float, float]
    texture: str


def load_collada(path: Path) -> list[ColladaPart]:
    """The parts of a COLLADA file, as its visual scene arranges them.

    Raises:
        StorageError: missing, unreadable or too large.
        FormatError: not COLLADA, or its arrays do not fit together.
    """
    import collada

    data = read_bytes(path, _SIZE_MAX)
    check_xml(data, path)
    skip = [collada.common.DaeUnsupportedError, collada.common.DaeBrokenRefError]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pycollada still uses numpy's matrix class
            document = collada.Collada(io.BytesIO(data), ignore=skip)
            given = document.assetInfo.unitmeter
            unit = 1.0 if given is None else float(given)
            if not (math.isfinite(unit) and 0 < unit <= 1e6):
                raise FormatError(f"unit meter={unit} is not a length", file=path, field="unit")
            turn = _UP[str(document.assetInfo.upaxis or "Y_UP")] * unit
            bound = list(document.scene.objects("geometry")) if document.scene is not None else []
            primitives = [primitive for item in bound for primitive in item.primitives()]
            parts = [_part(primitive, turn, path) for primitive in primitives]
    except FormatError:
        raise
    except Exception as error:  # pycollada lets numpy's and Python's own errors through
        raise FormatError(
            f"not a readable COLLADA file: {error}",
            file=path,
            remedy="export the mesh again as COLLADA 1.4",
        ) from None
    found = [part for part in parts if part is not None]
    if sum(len(part.faces) for part in found) > _FACES_MAX:
        raise FormatError(f"more than {_FACES_MAX} triangles", file=path)
    return found


def _part(primitive: Any, turn: F64, path: Path) -> ColladaPart | None:
    if type(primitive).__name__ == "BoundLineSet":
        return None
    triangles = primitive if hasattr(primitive, "normal") and _is_triangles(primitive) else None
    if triangles is None:
        triangles = primitive.triangleset()
    if triangles.vertex_index is None or not len(triangles.vertex_index):
        return None
    vertices = np.asarray(triangles.vertex, np.float64) @ turn.T
    faces = np.asarray(triangles.vertex_index, np.int64).reshape(-1, 3)
    if faces.min() < 0 or faces.max() >= len(vertices) or not np.isfinite(vertices).all():
        raise FormatError(
            "vertex indices or coordinates are out of range",
            file=path,
            remedy="export the mesh again",
        )
    uv = np.zeros((len(faces), 3, 2), np.float32)
    if triangles.texcoordset:
        table = np.asarray(triangles.texcoordset[0], np.float32)
        index = np.asarray(triangles.texcoord_indexset[0], np.int64).reshape(-1, 3)
        if index.min() < 0 or index.max() >= len(table) or table.shape[1] < 2:
            raise FormatError("texture coordinate indices are out of range", file=path)
        uv = np.nan_to_num(table[index][:, :, :2], nan=0.0, posinf=0.0, neginf=0.0)
    colour, texture = _diffuse(triangles.material)
    return ColladaPart(vertices, faces.astype(np.int32), uv, colour, texture)


def _is_triangles(primitive: Any) -> bool:
    return type(primitive).__name__ == "BoundTriangleSet"


def _diffuse(material: Any) -> tuple[tuple[float, float, float], str]:
    """Colour and texture path of a material; transparency is ignored."""
    effect = getattr(material, "effect", None)
    diffuse = getattr(effect, "diffuse", None)
    sampler = getattr(diffuse, "sampler", None)
    if sampler is not None:
        return (0.8, 0.8, 0.8), str(sampler.surface.image.path or "")
    if diffuse is None:
        return (0.8, 0.8, 0.8), ""
    r, g, b = (min(max(float(v), 0.0), 1.0) for v in tuple(diffuse)[:3])
    return (r, g, b), ""
