"""Other light on the same splats: one recorded condition, the same for every view and the BEV.

Paper, "Visual-condition enhancement": illumination and colour change, geometry and meaning do not.
A condition is a few numbers; it is stored with the episode, so any picture can be made again. All
edits are per-splat functions of colour, so a point looks alike from everywhere. There is no mirror
image here: left and right would change places under the instruction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated

import msgspec
import numpy as np

from gn0.config import Config
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.film import decode_srgb, develop_film, encode_srgb, expose_film
from gn0.geometry import F32, F64
from gn0.seeds import random_stream

POWER = 2.2  # of display values over linear light, where nothing better is known of a scene
DAYLIGHT = 5500.0  # K: what scenes are balanced for
_LUMA = np.array([0.2126, 0.7152, 0.0722])
_CLIPPED = 0.995  # display values above have lost what they were
_ROWS = 8192  # splats at a time
_TRIED = 8192  # splats that tell which curve a scene was baked with


class LightCondition(Config, frozen=True):
    """How a scene is lit, relative to how it was made or captured; the default changes nothing.

    Attributes:
        name: what people call it: "evening", "overcast", …
        exposure: stops brighter or darker; +1 doubles the light.
        kelvin: colour temperature of the light [K]; 5500 leaves colours alone, less is warmer.
        tint: stops of green against magenta.
        contrast: of light and shadow: 1 as they are, 0 the same light everywhere. It acts on the
            baked irradiance, and only where albedo and irradiance are kept.
        saturation: saturation of colours: 1 as they are, 0 grey.
    """

    name: str = "as made"
    exposure: Annotated[float, msgspec.Meta(ge=-6, le=6)] = 0.0
    kelvin: Annotated[float, msgspec.Meta(ge=1500, le=20000)] = DAYLIGHT
    tint: Annotated[float, msgspec.Meta(ge=-2, le=2)] = 0.0
    contrast: Annotated[float, msgspec.Meta(ge=0, le=2)] = 1.0
    saturation: Annotated[float, msgspec.Meta(ge=0, le=2)] = 1.0

    @property
    def is_neutral(self) -> bool:
        """Whether it changes no picture."""
        return self == LightCondition(name=self.name)


# name: (exposure low, high), (kelvin low, high), (tint ±), (contrast low, high), (saturation …)
_MOODS: dict[str, tuple[tuple[float, float], ...]] = {
    "bright day": ((0.15, 0.45), (5200, 6000), (-0.03, 0.03), (0.95, 1.25), (1.0, 1.1)),
    "overcast": ((-0.35, 0.1), (6300, 7600), (-0.03, 0.05), (0.45, 0.75), (0.8, 0.95)),
    "warm lamps": ((-0.5, 0.0), (2900, 3900), (-0.04, 0.04), (0.9, 1.2), (0.95, 1.1)),
    "cool tubes": ((-0.2, 0.3), (6200, 8200), (0.02, 0.12), (0.7, 1.0), (0.85, 1.0)),
    "dusk": ((-1.6, -0.8), (3800, 5000), (-0.08, 0.0), (0.9, 1.2), (0.75, 0.95)),
    "night": ((-2.6, -1.8), (7500, 10500), (-0.04, 0.04), (0.8, 1.1), (0.45, 0.7)),
}


def condition_names() -> tuple[str, ...]:
    """Names of the moods that `draw_condition` knows."""
    return tuple(_MOODS)


def draw_condition(seed: int, *names: str | int, mood: str | None = None) -> LightCondition:
    """A condition drawn by a named stream: the same seed and names, the same light.

    Args:
        seed: root seed.
        names: names of the stream, such as the scene and the episode.
        mood: one of `condition_names`; drawn when None.
    """
    rng = random_stream(seed, "light", *names)
    drawn = list(_MOODS)[int(rng.integers(len(_MOODS)))]
    mood = drawn if mood is None else mood
    values = [float(rng.uniform(*bounds)) for bounds in _MOODS[mood]]
    return LightCondition(
        name=mood,
        exposure=round(values[0], 3),
        kelvin=round(values[1]),
        tint=round(values[2], 3),
        contrast=round(values[3], 3),
        saturation=round(values[4], 3),
    )


def light_gain(condition: LightCondition) -> F64:
    """Gain of linear light in each channel [3] of exposure, temperature and tint."""
    white = planck_colour(condition.kelvin) / planck_colour(DAYLIGHT)
    white = white * np.array([1.0, 2.0**condition.tint, 1.0])
    white = white / float(white @ _LUMA)  # a change of colour is no change of brightness
    return white * 2.0**condition.exposure


def planck_colour(kelvin: float) -> F64:
    """Linear sRGB [3] of a black body, unscaled.

    Chromaticity by the cubic fit of Kim et al. (US patent 7024034, 2006) to the Planckian locus,
    1667 to 25000 K.
    """
    t = min(max(kelvin, 1667.0), 25000.0)
    if t < 4000.0:
        x = -0.2661239e9 / t**3 - 0.2343589e6 / t**2 + 0.8776956e3 / t + 0.179910
    else:
        x = -3.0258469e9 / t**3 + 2.1070379e6 / t**2 + 0.2226347e3 / t + 0.240390
    if t < 2222.0:
        y = -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683
    elif t < 4000.0:
        y = -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867
    else:
        y = 3.0817580 * x**3 - 5.87338670 * x**2 + 3.75112997 * x - 0.37001483
    big = np.array([x / y, 1.0, (1.0 - x - y) / y])
    to_rgb = np.array([
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ])  # fmt: skip
    return np.maximum(to_rgb @ big, 1e-3)


def relight_cloud(cloud: GaussianCloud, condition: LightCondition) -> GaussianCloud:
    """The cloud under another light; geometry, opacity and labels are the same arrays.

    Where albedo and irradiance are kept, the exposed light is edited itself and goes through the
    film curve of the bake again: exact, up to what the curve had clipped. Elsewhere a gain g of
    linear light is the factor k = g^(1/2.2) on colour c = 0.5 + C0·dc + …, so dc' = k·dc +
    0.5·(k − 1)/C0 and k times every other coefficient: exact at every SH degree up to clipping,
    for display values that are a power of linear light.

    A neutral condition returns the same cloud.
    """
    if condition.is_neutral or not len(cloud):
        return cloud
    gain = light_gain(condition)
    if cloud.albedo is not None and cloud.irradiance is not None and not cloud.sh_degree:
        return _relight_baked(cloud, condition, gain)
    k = (gain ** (1.0 / POWER)).astype(np.float32)
    sh = cloud.sh * k
    sh[:, 0, :] += np.float32(0.5 / SH_C0) * (k - np.float32(1.0))
    if condition.saturation != 1.0:
        sh = _saturate(sh, condition.saturation)
    return replace(cloud, sh=np.ascontiguousarray(sh, np.float32))


def _relight_baked(cloud: GaussianCloud, condition: LightCondition, gain: F64) -> GaussianCloud:
    assert cloud.albedo is not None and cloud.irradiance is not None
    albedo, shown = cloud.albedo, cloud.rgb()
    light = np.maximum(cloud.irradiance.astype(np.float64), 1e-6)
    lift: F64 | None = None
    if condition.contrast != 1.0:
        # towards or away from the light that is usual here, in stops
        level = light @ _LUMA
        usual = math.exp(float(np.log(level).mean()))
        lift = (usual / level) ** (1.0 - condition.contrast)
    film = _is_film(shown, albedo, light)
    colour, new = (np.empty(light.shape, np.float32) for _ in range(2))
    for at in _cut(len(light)):
        change = gain if lift is None else gain * lift[at, None]
        own = shown[at].astype(np.float64)
        exposed = expose_film(own) if film else decode_srgb(own).astype(np.float64)
        # where the curve had clipped, the light is what fell on it
        reflected = albedo[at].astype(np.float64) * light[at]
        exposed = np.where(own >= _CLIPPED, np.maximum(exposed, reflected), exposed)
        colour[at] = develop_film(exposed * change) if film else encode_srgb(exposed * change)
        new[at] = light[at] * change
    sh = ((colour - np.float32(0.5)) / np.float32(SH_C0))[:, None, :]
    if condition.saturation != 1.0:
        sh = _saturate(sh, condition.saturation)
    return replace(cloud, sh=np.ascontiguousarray(sh, np.float32), irradiance=new)


def _is_film(shown: F32, albedo: F32, light: F64) -> bool:
    """Whether colours went through the film curve of the bake, rather than the sRGB curve alone.

    Some splats tell, evenly chosen, unless the two curves fit them almost alike.
    """
    film = plain = 0.0
    for step in dict.fromkeys((max(1, len(light) // _TRIED), 1)):
        film, plain = _misfits(shown[::step], albedo[::step], light[::step])
        if max(film, plain) > 2.0 * min(film, plain):
            break
    return film <= plain


def _misfits(shown: F32, albedo: F32, light: F64) -> tuple[float, float]:
    """How far colours lie from either curve on average: film, and sRGB alone."""
    film, plain = (np.empty(light.shape) for _ in range(2))
    for at in _cut(len(light)):
        reflected, own = albedo[at].astype(np.float64) * light[at], shown[at].astype(np.float64)
        film[at] = np.abs(develop_film(reflected) - own)
        plain[at] = np.abs(encode_srgb(reflected) - own)
    return float(film.mean()), float(plain.mean())


def _cut(count: int) -> Iterator[slice]:
    """Rows in pieces: what is computed of one stays in the cache, not in ever new memory."""
    return (slice(begin, begin + _ROWS) for begin in range(0, count, _ROWS))


def _saturate(sh: F32, amount: float) -> F32:
    """Colours [N, K, 3] pulled to or from their own grey; linear, so exact at every degree."""
    grey = (sh @ _LUMA.astype(np.float32))[..., None]
    return (grey + np.float32(amount) * (sh - grey)).astype(np.float32)
