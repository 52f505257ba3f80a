"""The bird's-eye view of a scene: a metric, north-up, orthographic picture without its ceiling.

Rendered once and kept in the cache folder by content hash; a cache file that is damaged or cannot
be written costs one rendering and nothing else.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.errors import RenderError, StorageError
from gn0.geometry import F64, U8, view_from_above
from gn0.render.camera import Camera
from gn0.render.renderer import DrawnScene, Renderer, Traits
from gn0.storage import cache_dir, content_hash, read_bytes, write_bytes

BEV_LIMIT = 4096  # px a side
_FORMAT = 1  # raise when the bytes of a picture change for another reason than its inputs
_FAR = 1e4  # m
_MAGIC = b"GN0BEV1\n"
_FILE_LIMIT = 2**27  # bytes
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class BevPicture:
    """A map picture: right is world +x, top is world +y.

    Attributes:
        rgb: uint8 [H, W, 3].
        metres_per_pixel: scale [m].
        origin: world x, y [m] of the picture's lower left corner.
    """

    rgb: U8
    metres_per_pixel: float
    origin: tuple[float, float]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.rgb.shape[1], self.rgb.shape[0]

    def pixel_from_world(self, xy: NDArray[np.floating]) -> F64:
        """Picture coordinates [..., 2] (column, row) of world points [..., 2] m.

        Pixel i covers i to i + 1, so a pixel's centre is at i + 0.5 and `floor` names the pixel.
        """
        point = np.asarray(xy, np.float64)
        column = (point[..., 0] - self.origin[0]) / self.metres_per_pixel
        row = self.rgb.shape[0] - (point[..., 1] - self.origin[1]) / self.metres_per_pixel
        return np.stack([column, row], axis=-1)

    def world_from_pixel(self, pixel: NDArray[np.floating]) -> F64:
        """World points [..., 2] m of picture coordinates [..., 2] (column, row)."""
        point = np.asarray(pixel, np.float64)
        x = self.origin[0] + point[..., 0] * self.metres_per_pixel
        y = self.origin[1] + (self.rgb.shape[0] - point[..., 1]) * self.metres_per_pixel
        return np.stack([x, y], axis=-1)


def bev_camera(
    bounds: NDArray[np.floating], metres_per_pixel: float, cut_height: float
) -> tuple[Camera, F64]:
    """Camera and view of the map picture of `bounds` [2, 2] or [2, 3] m.

    The picture's lower left corner is at the lower bounds; its size is rounded up to whole
    pixels. The eye is at `cut_height` [m] and near is 0, so what lies above is not drawn.

    Raises:
        RenderError: bounds, scale or height without meaning, or more than `BEV_LIMIT` pixels.
    """
    box = np.asarray(bounds, np.float64)
    if box.ndim != 2 or len(box) != 2 or box.shape[1] < 2 or not np.isfinite(box[:, :2]).all():
        raise RenderError("bounds are not two finite corners", where="bounds")
    if not (math.isfinite(metres_per_pixel) and metres_per_pixel > 0):
        raise RenderError(f"metres_per_pixel is {metres_per_pixel}, expected > 0")
    if not math.isfinite(cut_height):
        raise RenderError("cut_height is not finite", where="cut_height")
    extent = box[1, :2] - box[0, :2]
    if not (extent > 0).all():
        raise RenderError(f"bounds have extent {extent.tolist()} m, expected > 0", where="bounds")
    # 1e-6 px of slack: 10 m at 0.05 m is 200 pixels, whatever the division says
    pixels = np.ceil(extent / metres_per_pixel - 1e-6)
    if pixels.max() > BEV_LIMIT:
        raise RenderError(
            f"map picture of {pixels[0]:.0f}x{pixels[1]:.0f} pixels, more than {BEV_LIMIT}",
            where="bounds",
            remedy=f"use at least {extent.max() / BEV_LIMIT:.3g} m a pixel",
        )
    width, height = int(max(pixels[0], 1)), int(max(pixels[1], 1))
    camera = Camera.orthographic(width, height, metres_per_pixel, near=0.0, far=_FAR)
    x, y = box[0, :2] + np.array([width, height]) * metres_per_pixel / 2
    return camera, view_from_above(float(x), float(y), cut_height)


def render_bev(
    cloud_hash: str,
    renderer: Renderer | DrawnScene,
    bounds: NDArray[np.floating],
    metres_per_pixel: float = 0.02,
    cut_height: float = 2.3,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    cache: bool = True,
) -> BevPicture:
    """The map picture of a scene, from the cache when it is there.

    Args:
        cloud_hash: content hash of the cloud that `renderer` was built for.
        renderer: draws it when the cache has nothing.
        bounds: [2, 2] or [2, 3] m, lower and upper corner.
        metres_per_pixel: scale [m].
        cut_height: splats whose centre lies above this height [m] are left out.
        background: colour where there is nothing, 0..1.
        cache: read and write the cache folder.

    Raises:
        RenderError: see `bev_camera`.
    """
    camera, view = bev_camera(bounds, metres_per_pixel, cut_height)
    corner = np.asarray(bounds, np.float64)[0, :2]
    origin = (float(corner[0]), float(corner[1]))
    path = bev_file(
        cloud_hash, renderer.traits, bounds, metres_per_pixel, cut_height, background=background
    )
    shape = (camera.height, camera.width, 3)
    rgb = _load(path, shape) if cache else None
    if rgb is None:
        picture = renderer.render(camera, view, outputs=("rgb",), background=background).rgb
        assert picture is not None
        rgb = _as_u8(picture[0])
        if cache:
            _save(path, rgb)
    rgb.setflags(write=False)
    return BevPicture(rgb, float(metres_per_pixel), origin)


def bev_file(
    cloud_hash: str,
    traits: Traits,
    bounds: NDArray[np.floating],
    metres_per_pixel: float = 0.02,
    cut_height: float = 2.3,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Path:
    """Where the cache keeps a map picture, drawn or not; arguments as of `render_bev`.

    Raises:
        RenderError: see `bev_camera`.
    """
    camera, _ = bev_camera(bounds, metres_per_pixel, cut_height)
    origin = map(float, np.asarray(bounds, np.float64)[0, :2])
    key = content_hash(
        *(_FORMAT, cloud_hash, traits.drawn_by, int(traits.antialiased)),
        *(camera.width, camera.height),
        *(float(metres_per_pixel), float(cut_height), *origin, *map(float, background)),
    )
    return cache_dir() / "bev" / f"{key}.bev"


def _as_u8(picture: NDArray[np.generic]) -> U8:
    if picture.dtype == np.uint8:
        return np.array(picture)
    return (np.clip(picture, 0, 1) * np.float32(255) + np.float32(0.5)).astype(np.uint8)


def _save(path: Path, rgb: U8) -> None:
    body = zlib.compress(rgb.tobytes(), 1)
    head = {"shape": rgb.shape, "digest": hashlib.blake2b(body, digest_size=16).hexdigest()}
    try:
        write_bytes(path, _MAGIC + json.dumps(head).encode() + b"\n" + body)
    except StorageError as error:
        _log.warning("the map picture is not cached: %s", error)


def _load(path: Path, shape: tuple[int, int, int]) -> U8 | None:
    """The cached picture, or None when it is absent, damaged or of another shape."""
    if not path.exists():
        return None
    try:
        magic, head, body = read_bytes(path, _FILE_LIMIT).split(b"\n", 2)
        fields = json.loads(head)
        digest = hashlib.blake2b(body, digest_size=16).hexdigest()
        if magic + b"\n" != _MAGIC or fields["digest"] != digest or fields["shape"] != [*shape]:
            raise ValueError("digest or shape differs")
        data = zlib.decompress(body)
        return np.frombuffer(data, np.uint8).reshape(shape).copy()
    except (StorageError, ValueError, KeyError, TypeError, zlib.error) as error:
        _log.warning("%s: damaged map picture is rendered again: %s", path, error)
        return None
