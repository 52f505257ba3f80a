"""The light that a scene throws on people, as the colour gain that an instance takes.

A grid of probes in the free space of a scene, found once from its splats. Where they keep albedo
and irradiance, light that surfaces send each other is gathered from them, and what comes straight
from lamps and windows from sources whose strength fits the irradiance; elsewhere their colours are
taken for light. A probe knows the light on a grey surface for many normals. A gain is the best
constant and linear function of the normal for what the scene's film makes of it: a grey person
looks as grey furniture would there.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gn0.avatars.light_sources import find_glow, find_sources, judge_sources
from gn0.avatars.light_voxels import fill_voxels, spread_directions
from gn0.avatars.npz_arrays import ArrayFile, write_arrays
from gn0.errors import FormatError, SceneError, StorageError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.film import decode_srgb, develop_film, encode_srgb, expose_film
from gn0.geometry import F32, F64
from gn0.maps.grid import FREE, OccupancyGrid
from gn0.render.light import POWER, LightCondition, light_gain
from gn0.storage import cache_dir, content_hash, write_atomic

CELL = 0.5  # of the grid of probes [m]
HEIGHTS = (0.25, 0.75, 1.25, 1.75)  # of probes [m]
NORMALS = spread_directions(32)  # for which a probe knows the light
NORMALS.setflags(write=False)
_VERSION = 1
_RAYS = 512
_ROUND, _ABOVE, _CEILING = 0.5, 0.3, 12.0  # of the box round the free space [m]
_BODY = (0.2, 0.4, 0.3, 0.1)  # what each height counts for somebody who stands
_REMEDY = "give a scene with free floor"
_GREYS = np.array([0.08, 0.2, 0.45])  # albedos for which a gain is to be right
_UPRIGHT = 0.75  # how much less a normal counts that points up or down: people are upright
# the exposure of a generated scene adapts to each place, and so evens out its bright and dark sides
_SIDES = 1.12
_LUMA = np.array([0.2126, 0.7152, 0.0722])
_NO_CHANGE = LightCondition()


@dataclass(frozen=True, eq=False)
class LightProbes:
    """Light in the free space of a scene; see `find_probes`.

    Attributes:
        grid: where the space is free.
        places: (x, y) of each column of probes [C, 2] m.
        column: of each cell of `CELL` along x and y from the grid's corner [X, Y], -1 without.
        light: exposed irradiance / π on each of `NORMALS` at each of `HEIGHTS` [C, 4, 32, 3].
        film: whether the scene's colours went through the film curve; else the sRGB curve alone.
        digest: of all that it depends on.
    """

    grid: OccupancyGrid
    places: F64
    column: NDArray[np.int32]
    light: F32
    film: bool
    digest: str
    _gains: dict[LightCondition, F32] = field(default_factory=dict, repr=False)

    def gain_at(self, x: float, y: float, condition: LightCondition = _NO_CHANGE) -> F32:
        """Colour gain [4, 3] of a person who stands at (x, y) [m]; rows as in `Instance.gain`.

        Blended between the columns of probes round it that no wall hides from it.

        Args:
            x: where the person stands [m].
            y: likewise.
            condition: the light of the episode, see `relight_cloud`.
        """
        columns, shares = self._columns_round(x, y)
        gains = self.gains(condition)[columns]
        return np.einsum("c,cab->ab", shares, gains).astype(np.float32)

    def gains(self, condition: LightCondition = _NO_CHANGE) -> F32:
        """Colour gains of all columns [C, 4, 3]; kept for the last few conditions."""
        if condition not in self._gains:
            while len(self._gains) >= 8:
                self._gains.pop(next(iter(self._gains)))
            body = np.einsum("h,chnk->cnk", np.array(_BODY), self.light.astype(np.float64))
            gains = fit_gains(body, condition, film=self.film)
            if self.film:
                gains[:, 1:] *= _SIDES
            self._gains[condition] = gains
        return self._gains[condition]

    def _columns_round(self, x: float, y: float) -> tuple[NDArray[np.int64], F64]:
        """Columns that speak for a place, and their shares."""
        ox, oy = self.grid.origin
        u, v = (x - ox) / CELL - 0.5, (y - oy) / CELL - 0.5
        i, j = int(np.floor(u)), int(np.floor(v))
        found: dict[int, float] = {}
        for a, b in ((i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)):
            if 0 <= a < self.column.shape[0] and 0 <= b < self.column.shape[1]:
                number = int(self.column[a, b])
                share = (1.0 - abs(u - a)) * (1.0 - abs(v - b))
                if number >= 0 and share > 1e-6 and self._sees(x, y, *self.places[number]):
                    found[number] = share
        if not found:
            nearest = int(np.argmin(((self.places - (x, y)) ** 2).sum(axis=1)))
            found[nearest] = 1.0
        shares = np.array(list(found.values()))
        return np.array(list(found)), shares / shares.sum()

    def _sees(self, x: float, y: float, to_x: float, to_y: float) -> bool:
        """Whether no blocked cell lies between two places."""
        steps = int(max(abs(to_x - x), abs(to_y - y)) / self.grid.resolution) + 1
        t = np.linspace(0.0, 1.0, steps + 1)[1:]
        cells = self.grid.cells_of(np.column_stack([x + t * (to_x - x), y + t * (to_y - y)]))
        rows = np.clip(cells[:, 0], 0, self.grid.shape[0] - 1)
        columns = np.clip(cells[:, 1], 0, self.grid.shape[1] - 1)
        return not bool(self.grid.blocked[rows, columns].any())


def find_probes(cloud: GaussianCloud, grid: OccupancyGrid, *, cache: bool = True) -> LightProbes:
    """The probes of a scene, from the cache where they were found before.

    Args:
        cloud: its splats, as they are lit at first: conditions come later.
        grid: its free cells; floor at z = 0.
        cache: keep them on disk, and look there first.

    Raises:
        SceneError: nothing is free.
    """
    digest = _digest(cloud, grid)
    path = cache_dir() / "people_light" / f"{digest}.npz"
    places, column = place_probes(grid)
    if cache:
        with contextlib.suppress(StorageError, FormatError):
            return _load(path, grid, places, column, digest)
    light, film = _find_light(cloud, grid, places)
    probes = LightProbes(grid, places, column, light, film, digest)
    if cache:
        arrays = {"light": light, "film": np.array([film])}
        with contextlib.suppress(StorageError):  # found again next time
            write_atomic(path, lambda stream: write_arrays(stream, arrays))
    return probes


def place_probes(grid: OccupancyGrid) -> tuple[F64, NDArray[np.int32]]:
    """Columns of probes, one in each cell of `CELL` with free floor, at a free place.

    Returns:
        places [C, 2] m, and the number of the column of each cell [X, Y], -1 where there is none.

    Raises:
        SceneError: nothing is free.
    """
    free = np.argwhere(grid.cells == FREE)
    if not len(free):
        raise SceneError("no cell of the map is free: no probes of light", remedy=_REMEDY)
    at = grid.centres_of(free)
    cell = np.floor((at - grid.origin) / CELL).astype(np.int64)
    shape = np.ceil(np.array(grid.shape[::-1]) * grid.resolution / CELL).astype(np.int64) + 1
    flat = cell[:, 0] * shape[1] + cell[:, 1]
    away = ((at - ((cell + 0.5) * CELL + grid.origin)) ** 2).sum(axis=1)
    order = np.lexsort((np.arange(len(flat)), away, flat))  # the free place nearest to the middle
    first = order[np.unique(flat[order], return_index=True)[1]]
    column = np.full(int(np.prod(shape)), -1, np.int32)
    column[flat[first]] = np.arange(len(first))
    return at[first], column.reshape(tuple(shape))


def fit_gains(
    light: NDArray[np.floating], condition: LightCondition = _NO_CHANGE, *, film: bool = True
) -> F32:
    """Colour gains [C, 4, 3] of exposed light / π on each of `NORMALS` [C, 32, 3].

    The display colour of plain albedo times the gain is to be what the film makes of lit albedo.
    Least squares over normals, and over greys: what is dark is lifted by the film's toe, what is
    bright is held back.

    Args:
        light: exposed irradiance / π.
        condition: change of the light.
        film: whether colours go through the film curve; else through the sRGB curve alone.
    """
    exposed = np.maximum(np.asarray(light, np.float64), 0.0)
    change = light_gain(condition) if not condition.is_neutral else np.ones(3)
    if condition.contrast != 1.0:
        level = np.maximum(exposed.mean(axis=1) @ _LUMA, 1e-6)
        usual = np.exp(np.log(level).mean())
        exposed = exposed * ((usual / level) ** (1.0 - condition.contrast))[:, None, None]
    plain = encode_srgb(_GREYS).astype(np.float64)
    shown = np.zeros_like(exposed)
    for grey, own in zip(_GREYS, plain, strict=True):
        if film:
            lit = develop_film(grey * change * exposed).astype(np.float64)
        else:  # as `relight_cloud` changes colours of which nothing is known
            lit = encode_srgb(grey * exposed) * change ** (1.0 / POWER)
        shown += own * lit
    shown /= float(plain @ plain)
    if condition.saturation != 1.0:
        own = (shown @ _LUMA)[..., None]
        shown = own + condition.saturation * (shown - own)
    return np.einsum("an,cnk->cak", _fit_matrix(), shown).astype(np.float32)


@lru_cache(1)
def _fit_matrix() -> F64:
    """What makes constant and linear terms [4, 32] of values on `NORMALS`."""
    terms = np.concatenate([np.ones((len(NORMALS), 1)), NORMALS], axis=1)
    weight = np.sqrt(1.0 - _UPRIGHT * np.abs(NORMALS[:, 2]))[:, None]
    return np.asarray(np.linalg.pinv(weight * terms) * weight.T)


def _find_light(cloud: GaussianCloud, grid: OccupancyGrid, places: F64) -> tuple[F32, bool]:
    x0, y0, x1, y1 = grid.bounds
    top = float(np.quantile(cloud.means[:, 2], 0.999)) + _ABOVE if len(cloud) else 0.0
    box = np.array(
        [
            (x0 - _ROUND, y0 - _ROUND, -_ABOVE),
            (x1 + _ROUND, y1 + _ROUND, np.clip(top, 2.2, _CEILING)),
        ]
    )
    points = np.concatenate(
        [np.column_stack([places, np.full(len(places), height)]) for height in HEIGHTS]
    )
    colour = np.clip(cloud.rgb(), 0.0, 1.0)
    cosine = np.maximum(NORMALS @ spread_directions(_RAYS).T, 0.0)
    cosine /= cosine.sum(axis=1, keepdims=True)
    baked = cloud.albedo is not None and cloud.irradiance is not None and cloud.normal is not None
    film = False
    if baked:
        assert cloud.albedo is not None and cloud.irradiance is not None
        reflected = cloud.albedo.astype(np.float64) * cloud.irradiance
        off = np.abs(develop_film(reflected) - colour).mean()
        film = bool(off <= np.abs(encode_srgb(reflected) - colour).mean())
        exposed = expose_film(colour) if film else decode_srgb(colour).astype(np.float64)
        glows = find_glow(cloud, exposed, reflected)
        voxels = fill_voxels(cloud, reflected.astype(np.float32), ~glows, box)
        sources = judge_sources(find_sources(cloud, glows, box), cloud, glows, voxels)
        every = np.broadcast_to(NORMALS, (len(points), *NORMALS.shape))
        light = sources.reach(points, every, voxels) @ sources.strength
        sky = sources.sky
    else:
        voxels = fill_voxels(cloud, decode_srgb(colour), np.ones(len(cloud), bool), box)
        light, sky = np.zeros((len(points), len(NORMALS), 3)), np.zeros(3)
    bounced, outside = voxels.gather(points, None, _RAYS)
    light = light + np.einsum("mr,prk->pmk", cosine, bounced + outside[:, :, None] * sky)
    whole = light.reshape(len(HEIGHTS), len(places), len(NORMALS), 3).swapaxes(0, 1)
    return np.ascontiguousarray(whole, np.float32), film


def _digest(cloud: GaussianCloud, grid: OccupancyGrid) -> str:
    none = np.zeros(0, np.float32)
    kept = (none if a is None else a for a in (cloud.albedo, cloud.irradiance, cloud.normal))
    return content_hash("people light", _VERSION, cloud.content_hash, grid.content_hash, *kept)


def _load(
    path: Path, grid: OccupancyGrid, places: F64, column: NDArray[np.int32], digest: str
) -> LightProbes:
    arrays = ArrayFile(path)
    shape = (len(places), len(HEIGHTS), len(NORMALS), 3)
    light = arrays.read_floats("light", shape).astype(np.float32)
    film = bool(arrays.read("film")[0])
    return LightProbes(grid, places, column, light, film, digest)
