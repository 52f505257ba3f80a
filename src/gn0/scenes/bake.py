"""Baked light: lamps, windows, sun and their bounces, stored on surfaces.

Light that comes straight from a source is sampled on a fine set of lumels, so that shadows stay
crisp; light that has bounced is gathered on a coarse one: cosine-distributed rays are cast once,
each remembers the lumel that it met, and every bounce is then a mean over that table
(Goral et al., SIGGRAPH 1984, solved by gathering). Values are irradiance / π: the radiance of a
matt surface is albedo times that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.config import Config
from gn0.geometry import F32
from gn0.jit import njit, prange
from gn0.progress import Progress, no_progress, told_parts
from gn0.scenes.charts import Charts, charts_of
from gn0.scenes.light_field import LightField
from gn0.scenes.lumels import Lumels, build_lumels
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.procedural.draft import Lamp, Sky, Sun
from gn0.scenes.rays import STACK, RayCaster, caster_of, closest_hit
from gn0.scenes.shading import Surface
from gn0.scenes.sky import gather_sky
from gn0.seeds import derive_seed

_LIFT = 2e-3  # rays start this far above their surface [m]
_SUN_SPREAD = 0.012  # tangent of the half angle of the sun's soft edge (the true sun: 0.0047)
_KINDS = {"rectangle": 0, "sphere": 1, "window": 0}
_PART = 32_768  # lumels lit by lamps between two words on progress
_RAYS = 1_000_000  # at a time


class BakeSettings(Config, frozen=True):
    """How carefully light is computed.

    Attributes:
        coarse: spacing of the samples of bounced light [m].
        fine: spacing of the samples of direct light [m].
        rays: rays a coarse sample.
        samples: shadow rays a lamp on a fine sample, at most.
        bounces: how often light is reflected.
        two_sided: light whichever side of a face is open; for meshes of unknown orientation.
        glow: let emission of surfaces light the scene (off where lamps stand for it).
        across: cells of the search for samples along their reach, see `build_lumels`.
    """

    coarse: float = 0.11
    fine: float = 0.05
    rays: int = 64
    samples: int = 12
    bounces: int = 4
    two_sided: bool = False
    glow: bool = False
    across: int = 1


DRAFT = BakeSettings(coarse=0.22, fine=0.14, rays=16, samples=4, bounces=3, across=2)


def bake_light(
    mesh: SceneMesh,
    surface: Surface,
    lamps: Sequence[Lamp],
    sun: Sun | None = None,
    *,
    sky: Sky | None = None,
    settings: BakeSettings | None = None,
    opaque: NDArray[np.bool_] | None = None,
    seed: int = 0,
    charts: Charts | None = None,
    progress: Progress = no_progress,
) -> LightField:
    """Compute the light in a scene.

    Args:
        mesh: the surfaces.
        surface: albedo and emission of the surfaces.
        lamps: light sources; none of them needs a surface of its own.
        sun: parallel light, stopped by whatever is opaque.
        sky: light from all round above; the mesh must leave its vault out.
        settings: care taken.
        opaque: faces that stop light from lamps and sun [F]; panes and lampshades do not.
        seed: root of the sampling patterns.
        charts: charts of the mesh, to save building them again.
        progress: progress sink.
    """
    options = settings or BakeSettings()
    progress("light", 0, 7)
    charts = charts or charts_of(mesh)
    caster = caster_of(mesh)
    blocker = caster
    if opaque is not None and not opaque.all() and opaque.any():
        blocker = RayCaster(_faces_of(mesh, opaque))
    progress("light", 1, 7)

    def sample(spacing: float) -> Lumels:
        return build_lumels(
            *(mesh, charts, spacing),
            two_sided=options.two_sided,
            across=options.across,
            caster=caster,
        )

    coarse = sample(options.coarse)
    progress("light", 2, 7)
    fine = sample(options.fine)
    if options.two_sided:
        coarse, fine = _turn_outward(coarse, caster, seed), _turn_outward(fine, caster, seed)
    progress("light", 3, 7)
    direct = _direct_light(fine, blocker, lamps, sun, options, seed, progress)
    progress("light", 4, 7)
    direct = _smooth(fine, direct)
    progress("light", 5, 7)
    albedo, emission = surface.reflect(coarse.face, coarse.bary)
    albedo = _mean_albedo(surface, coarse, mesh)
    table = _gather_table(coarse, caster, mesh, options.rays, derive_seed(seed, "bounce"), progress)
    progress("light", 6, 7)
    straight = fine.lookup(direct, coarse.point, coarse.normal)
    # the insides of cupboards and walls see nothing that is lit
    open_share = (table >= 0).mean(axis=1)
    from_sky = np.zeros_like(straight)
    if sky is not None:
        from_sky, share = gather_sky(
            coarse, blocker, sky, options.rays, derive_seed(seed, "sky"), progress
        )
        straight = straight + from_sky
        open_share = np.minimum(open_share + share, 1.0)
    glow = np.asarray(emission, np.float32) if options.glow else np.zeros_like(straight)
    bounced = np.zeros_like(straight)
    for _ in range(options.bounces):
        bounced = _gather(table, glow + albedo * (straight + bounced))
    bounced = _smooth(coarse, bounced if sky is None else bounced + from_sky)
    progress("light", 7, 7)
    return LightField(
        direct=fine,
        direct_value=direct,
        bounced=coarse,
        bounced_value=bounced,
        albedo=albedo,
        open_area=coarse.area * np.square(open_share).astype(np.float32),
    )


def _faces_of(mesh: SceneMesh, mask: NDArray[np.bool_]) -> SceneMesh:
    return SceneMesh(
        vertices=mesh.vertices,
        faces=mesh.faces[mask],
        uv=mesh.uv[mask],
        material=mesh.material[mask],
        instance=mesh.instance[mask],
    )


def _mean_albedo(surface: Surface, lumels: Lumels, mesh: SceneMesh) -> F32:
    """Albedo over a few points round each lumel: one point of a pattern is not its mean."""
    total = np.zeros((len(lumels), 3), np.float32)
    for blend in ((1.0, 0.0), (0.55, 0.15), (0.55, 0.30), (0.4, 0.05)):
        keep, skew = blend
        middle = np.array([1 - 2 * skew, skew, skew], np.float32)
        bary = keep * lumels.bary + (1 - keep) * middle
        total += np.asarray(surface.reflect(lumels.face, bary)[0], np.float32)
    return np.asarray(total / 4, np.float32)


def _smooth(lumels: Lumels, values: F32) -> F32:
    """Each lumel replaced by the field at its place: a mean over its own plane only."""
    return lumels.lookup(values, lumels.point, lumels.normal)


def _turn_outward(lumels: Lumels, caster: RayCaster, seed: int) -> Lumels:
    """Normals turned to the side on which rays fly further."""
    front = _openness(
        lumels.point, lumels.normal, caster.boxes, caster.links, caster.corners, seed & 0x7FFFFFFF
    )
    back = _openness(
        lumels.point, -lumels.normal, caster.boxes, caster.links, caster.corners, seed & 0x7FFFFFFF
    )
    normal = np.where((back > front * 1.02)[:, None], -lumels.normal, lumels.normal)
    return Lumels(**{**vars(lumels), "normal": np.ascontiguousarray(normal, np.float32)})


def _direct_light(
    lumels: Lumels,
    caster: RayCaster,
    lamps: Sequence[Lamp],
    sun: Sun | None,
    options: BakeSettings,
    seed: int,
    progress: Progress,
) -> F32:
    table = np.zeros((len(lamps), 16))
    for row, lamp in zip(table, lamps, strict=True):
        d = np.asarray(lamp.direction, np.float64)
        d /= max(float(np.linalg.norm(d)), 1e-12)
        side = np.array([1.0, 0, 0]) if abs(d[2]) > 0.9 else np.cross([0, 0, 1.0], d)
        side /= np.linalg.norm(side)
        row[:] = (
            _KINDS[lamp.shape], *lamp.centre, *d,
            *(side * lamp.size[0] / 2), *(np.cross(d, side) * lamp.size[1] / 2),
            *lamp.colour,
        )  # fmt: skip
    sun_table = np.zeros(6)
    if sun is not None:
        d = np.asarray(sun.direction, np.float64)
        sun_table[:3] = d / np.linalg.norm(d)
        sun_table[3:] = sun.colour
    out = np.zeros((len(lumels), 3), np.float32)
    for part in told_parts("light of lamps", len(lumels), _PART, progress):
        _direct_kernel(
            lumels.point, lumels.normal, caster.boxes, caster.links, caster.corners,
            table, sun_table, options.samples, derive_seed(seed, "direct") & 0x7FFFFFFF,
            out, part.start, part.stop,
        )  # fmt: skip
    return out


def _gather_table(
    lumels: Lumels,
    caster: RayCaster,
    mesh: SceneMesh,
    rays: int,
    seed: int,
    progress: Progress,
) -> NDArray[np.int32]:
    """The lumel that each ray of each lumel meets [L, rays]; −1 for none."""
    table = np.empty((len(lumels), rays), np.int32)
    normals = mesh.normals()
    step = max(1, _RAYS // rays)
    for part in told_parts("light between surfaces", len(lumels), step, progress):
        face, point = _hemisphere_hits(
            lumels.point[part], lumels.normal[part], caster.boxes, caster.links, caster.order,
            caster.corners, rays, part.start, seed & 0x7FFFFFFF, normals, lumels.two_sided,
        )  # fmt: skip
        hit = np.flatnonzero(face >= 0)
        found = np.full(len(face), -1, np.int32)
        found[hit] = lumels.nearest(point[hit], normals[face[hit]].astype(np.float32))
        table[part] = found.reshape(-1, rays)
    return table


@njit(inline="always")
def _rand(a, b, c):  # type: ignore[no-untyped-def]
    """Two uniform numbers from an integer key (lowbias32 rounds)."""
    h = np.uint32(a) * np.uint32(0x9E3779B1) ^ np.uint32(b)
    h ^= h >> np.uint32(16)
    h = np.uint32(h * np.uint32(0x7FEB352D)) + np.uint32(c)
    h ^= h >> np.uint32(15)
    h = np.uint32(h * np.uint32(0x846CA68B))
    h ^= h >> np.uint32(16)
    g = np.uint32(h * np.uint32(0x9E3779B1))
    g ^= g >> np.uint32(15)
    return h / 4294967296.0, g / 4294967296.0


@njit(inline="always")
def _frame(nx, ny, nz):  # type: ignore[no-untyped-def]
    """Two tangents of a unit normal (Duff et al., JCGT 2017)."""
    s = 1.0 if nz >= 0.0 else -1.0
    a = -1.0 / (s + nz)
    b = nx * ny * a
    return 1.0 + s * nx * nx * a, s * b, -s * nx, b, s + ny * ny * a, -ny


@njit(inline="always")
def _cosine_ray(nx, ny, nz, k, count, shift_u, shift_v):  # type: ignore[no-untyped-def]
    """Ray k of `count`, cosine-distributed: a rank-1 lattice turned by a random shift."""
    u = (k + 0.5) / count + shift_u
    v = k * 0.6180339887498949 + shift_v
    u, v = u - np.floor(u), v - np.floor(v)
    r, phi = np.sqrt(u), 2.0 * np.pi * v
    x, y, z = r * np.cos(phi), r * np.sin(phi), np.sqrt(max(0.0, 1.0 - u))
    ax, ay, az, bx, by, bz = _frame(nx, ny, nz)
    return x * ax + y * bx + z * nx, x * ay + y * by + z * ny, x * az + y * bz + z * nz


@njit(parallel=True, error_model="numpy")
def _hemisphere_hits(  # type: ignore[no-untyped-def]
    point, normal, boxes, links, order, corners, rays, base, seed, normals, two_sided
):
    n = len(point)
    face = np.full(n * rays, -1, np.int32)
    where = np.zeros((n * rays, 3), np.float32)
    for i in prange(n):
        stack = np.empty(STACK, np.int32)
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        ox, oy, oz = point[i, 0] + _LIFT * nx, point[i, 1] + _LIFT * ny, point[i, 2] + _LIFT * nz
        su, sv = _rand(base + i, 1, seed)
        for k in range(rays):
            dx, dy, dz = _cosine_ray(nx, ny, nz, k, rays, su, sv)
            hit, t, _, _ = closest_hit(
                boxes, links, corners, ox, oy, oz, dx, dy, dz, np.inf, np.bool_(False), stack
            )
            if hit < 0:
                continue
            f = order[hit]
            facing = dx * normals[f, 0] + dy * normals[f, 1] + dz * normals[f, 2]
            if facing > 0.0 and not two_sided:
                continue  # the inside of a solid is dark
            r = i * rays + k
            face[r] = f
            where[r, 0], where[r, 1], where[r, 2] = ox + t * dx, oy + t * dy, oz + t * dz
    return face, where


@njit(parallel=True)
def _gather(table, radiance):  # type: ignore[no-untyped-def]
    out = np.zeros((len(table), 3), np.float32)
    rays = table.shape[1]
    for i in prange(len(table)):
        red = green = blue = 0.0
        for k in range(rays):
            j = table[i, k]
            if j >= 0:
                red += radiance[j, 0]
                green += radiance[j, 1]
                blue += radiance[j, 2]
        out[i, 0], out[i, 1], out[i, 2] = red / rays, green / rays, blue / rays
    return out


@njit(parallel=True, error_model="numpy")
def _openness(point, normal, boxes, links, corners, seed):  # type: ignore[no-untyped-def]
    """Mean length of eight rays over each point, each at most 3 m; none where they leave."""
    out = np.zeros(len(point))
    for i in prange(len(point)):
        stack = np.empty(STACK, np.int32)
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        ox, oy, oz = point[i, 0] + _LIFT * nx, point[i, 1] + _LIFT * ny, point[i, 2] + _LIFT * nz
        su, sv = _rand(i, 2, seed)
        for k in range(8):
            dx, dy, dz = _cosine_ray(nx, ny, nz, k, 8, su, sv)
            hit, t, _, _ = closest_hit(
                boxes, links, corners, ox, oy, oz, dx, dy, dz, np.inf, np.bool_(False), stack
            )
            if hit >= 0:
                out[i] += min(t, 3.0) / 8
    return out


@njit(parallel=True, error_model="numpy")
def _direct_kernel(  # type: ignore[no-untyped-def]
    point, normal, boxes, links, corners, lamps, sun, samples, seed, out, first, end
):
    """Irradiance / π from lamps and sun [L, 3] at the points from `first` until `end`."""
    has_sun = sun[3] + sun[4] + sun[5] > 0.0
    for i in prange(first, end):
        stack = np.empty(STACK, np.int32)
        nx, ny, nz = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        ox, oy, oz = point[i, 0] + _LIFT * nx, point[i, 1] + _LIFT * ny, point[i, 2] + _LIFT * nz
        red = green = blue = 0.0
        for m in range(len(lamps)):
            cx, cy, cz = lamps[m, 1] - ox, lamps[m, 2] - oy, lamps[m, 3] - oz
            lx, ly, lz = lamps[m, 4], lamps[m, 5], lamps[m, 6]
            half_u = np.sqrt(lamps[m, 7] ** 2 + lamps[m, 8] ** 2 + lamps[m, 9] ** 2)
            half_v = np.sqrt(lamps[m, 10] ** 2 + lamps[m, 11] ** 2 + lamps[m, 12] ** 2)
            reach = half_u + half_v
            if cx * nx + cy * ny + cz * nz < -reach:
                continue
            ball = lamps[m, 0] == 1.0
            area = np.pi * half_u * half_u if ball else 4.0 * half_u * half_v
            d2 = cx * cx + cy * cy + cz * cz
            power = area * max(lamps[m, 13], max(lamps[m, 14], lamps[m, 15]))
            bound = power / (np.pi * max(d2, 0.04))
            if bound < 2e-4:
                continue
            side = max(1, min(int(np.sqrt(samples)), 1 + int(4.0 * np.sqrt(bound))))
            count = side * side
            weight = 0.0
            ux, uy, uz = lamps[m, 7], lamps[m, 8], lamps[m, 9]
            vx, vy, vz = lamps[m, 10], lamps[m, 11], lamps[m, 12]
            if ball:  # the disc that the ball shows to this point
                d = np.sqrt(max(d2, 1e-8))
                ax, ay, az, bx, by, bz = _frame(cx / d, cy / d, cz / d)
                ux, uy, uz = ax * half_u, ay * half_u, az * half_u
                vx, vy, vz = bx * half_u, by * half_u, bz * half_u
            for k in range(count):
                r1, r2 = _rand(i, m * 64 + k + 16, seed)
                s = (k % side + r1) / side * 2.0 - 1.0
                t = (k // side + r2) / side * 2.0 - 1.0
                if ball:
                    s, t = s * 0.886, t * 0.886  # a square of the disc's area
                dx, dy, dz = cx + s * ux + t * vx, cy + s * uy + t * vy, cz + s * uz + t * vz
                r = np.sqrt(dx * dx + dy * dy + dz * dz)
                if r < 1e-4:
                    continue
                dx, dy, dz = dx / r, dy / r, dz / r
                cosine = dx * nx + dy * ny + dz * nz
                shown = 1.0 if ball else -(dx * lx + dy * ly + dz * lz)
                if cosine <= 0.0 or shown <= 0.0:
                    continue
                far = r - 0.5 * half_u - 0.01 if ball else r - 0.012
                hit = -1
                if far > 0.0:
                    hit, _, _, _ = closest_hit(
                        boxes, links, corners, ox, oy, oz, dx, dy, dz, far, np.bool_(True), stack
                    )
                if hit < 0:
                    # close to a source the sampled form factor is kept finite
                    weight += cosine * shown / max(r * r, 0.01)
            e = weight * area / (np.pi * count)
            red += e * lamps[m, 13]
            green += e * lamps[m, 14]
            blue += e * lamps[m, 15]
        if has_sun:
            cosine = -(nx * sun[0] + ny * sun[1] + nz * sun[2])
            if cosine > 0.0:
                ax, ay, az, bx, by, bz = _frame(-sun[0], -sun[1], -sun[2])
                lit = 0
                for k in range(4):
                    r1, r2 = _rand(i, k + 3, seed + 1)
                    s = ((k % 2) + r1 - 1.0) * _SUN_SPREAD
                    t = ((k // 2) + r2 - 1.0) * _SUN_SPREAD
                    dx = -sun[0] + s * ax + t * bx
                    dy = -sun[1] + s * ay + t * by
                    dz = -sun[2] + s * az + t * bz
                    hit, _, _, _ = closest_hit(
                        boxes, links, corners, ox, oy, oz, dx, dy, dz, 1e4, np.bool_(True), stack
                    )
                    lit += hit < 0
                e = cosine * lit / (4.0 * np.pi)
                red += e * sun[3]
                green += e * sun[4]
                blue += e * sun[5]
        out[i, 0], out[i, 1], out[i, 2] = red, green, blue
