"""A scene as somebody's scan: bare splats in one file, in an arbitrary frame.

What a phone and a trainer leave: no labels, no light, no map, an origin somewhere in the middle, up
along some axis and a little off it, lengths in units of their own. The pages on captures are
written with such files, and the truth about them is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gn0.config import Config, check_config
from gn0.errors import ConfigError, StorageError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.ply import save_ply
from gn0.gaussians.ply_packed import save_ply_packed
from gn0.gaussians.transform import transform_cloud
from gn0.geometry import F64
from gn0.scenes.capture.gravity import plane_axes
from gn0.scenes.capture.settings import read_up
from gn0.seeds import random_stream
from gn0.storage import check_writable, write_bytes
from gn0.testing.splat_writers import (
    build_gltf,
    build_ksplat,
    build_sog,
    build_splat,
    build_spz,
)

_BYTES: dict[str, Callable[[GaussianCloud], bytes]] = {
    ".splat": build_splat,
    ".ksplat": build_ksplat,
    ".spz": build_spz,
    ".sog": build_sog,
    ".glb": lambda cloud: build_gltf(cloud)["splats.glb"],
}
FORMATS = (".ply", ".compressed.ply", *_BYTES)


class BareSettings(Config, frozen=True):
    """How the scene lies in the file.

    Attributes:
        up: the axis of the file that up is near, or a direction "x,y,z".
        tilt: by how much up is off it [degrees], to a side that the seed draws.
        scale: metres that one unit of the file stands for.
        seed: seed of the side to which it leans, and of the heading.
    """

    up: str = "-y"
    tilt: Annotated[float, msgspec.Meta(ge=0, le=45)] = 8.0
    scale: Annotated[float, msgspec.Meta(gt=0, le=1e6)] = 1.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class BareFrame:
    """Where the scene lies: x_file = rotation · x_scene / scale + shift.

    Attributes:
        rotation: proper [3, 3]; its last column is up in the file.
        scale: metres per unit of the file.
        shift: [3] in units of the file.
    """

    rotation: F64
    scale: float
    shift: F64


def check_capture_file(path: Path, *, overwrite: bool = False) -> None:
    """Whether a capture can be written there, said before any work.

    Raises:
        ConfigError: the name ends like no format that can be written.
        StorageError: the file exists already.
    """
    if not path.name.lower().endswith(FORMATS):
        raise ConfigError(
            f"{path.name!r} is not a splat file",
            where="--out",
            remedy=f"end it with one of {', '.join(FORMATS)}",
        )
    check_writable(path)
    if path.is_dir() or (path.exists() and not overwrite):
        raise StorageError(
            "the file exists already", where=path, remedy="choose another name, or --overwrite"
        )


def check_bare_settings(settings: BareSettings) -> BareSettings:
    """The settings, when they make sense.

    Raises:
        ConfigError: a number is out of range, or `up` is no direction.
    """
    if read_up(settings.up, "--capture-up") is None:
        raise ConfigError(
            "up must be given, because the file is made here",
            where="--capture-up",
            remedy="use x, -x, y, -y, z, -z or three numbers",
        )
    return check_config(settings)


def bare(cloud: GaussianCloud) -> GaussianCloud:
    """The splats without labels, albedo, light and normals."""
    return replace(cloud, label=None, albedo=None, irradiance=None, normal=None)


def draw_frame(cloud: GaussianCloud, settings: BareSettings) -> BareFrame:
    """The frame of a file: leaning as told, turned by chance, its origin amid the splats.

    Raises:
        ConfigError: a setting does not make sense.
    """
    axis = read_up(check_bare_settings(settings).up)
    assert axis is not None
    side, heading = random_stream(settings.seed, "bare capture").uniform(0, 2 * math.pi, 2)
    a, b = plane_axes(axis)
    lean = math.radians(settings.tilt)
    away = math.cos(side) * a + math.sin(side) * b
    up = math.cos(lean) * axis + math.sin(lean) * away
    a, b = plane_axes(up)
    ahead = math.cos(heading) * a + math.sin(heading) * b
    rotation = np.stack([ahead, np.cross(up, ahead), up], axis=1)
    middle = cloud.means.astype(np.float64).mean(axis=0)
    return BareFrame(rotation, settings.scale, -(rotation @ middle) / settings.scale)


def save_bare_capture(
    cloud: GaussianCloud, path: Path | str, settings: BareSettings, *, overwrite: bool = False
) -> BareFrame:
    """Write the splats of a scene as a capture, in the format that the name ends with.

    Returns:
        Where the scene lies in the file: what an importer has to find.

    Raises:
        ConfigError, StorageError: as `check_capture_file`; the file cannot be written.
    """
    path = Path(path)
    check_capture_file(path, overwrite=overwrite)
    frame = draw_frame(cloud, settings)
    moved = transform_cloud(
        bare(cloud), rotation=frame.rotation, scale=1 / frame.scale, shift=frame.shift
    )
    name = path.name.lower()
    if name.endswith(".compressed.ply"):
        save_ply_packed(moved, path)
    elif name.endswith(".ply"):
        save_ply(moved, path)
    else:
        write_bytes(path, _BYTES[path.suffix.lower()](moved))
    return frame
