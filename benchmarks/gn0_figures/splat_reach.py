"""Splats of generated and imported scenes: none too long, and floors as deep as rays say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64, rotation_from_quaternion
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.needles import find_needles
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.draft import SceneDraft
from gn0.scenes.procedural.finish import floor_area, place_draft
from gn0.scenes.procedural.kinds import KINDS, KindName, SizeName
from gn0.scenes.procedural.surface import ProceduralSurface
from gn0.scenes.rays import RayCaster
from gn0.scenes.sdf import find_world_file, load_sdf
from gn0.scenes.shading import SurfaceSample
from gn0.scenes.surfels import Placement, place_surfels, shade_surfels
from gn0.scenes.textures import TextureAlbedo
from gn0.scenes.world import place_on_floor
from gn0.scenes.world_light import ShaderFlat
from gn0.scenes.world_mesh import load_world_meshes
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_most
from gn0_figures.spread import spread
from gn0_figures.surfels import choose_views

FARTHEST, LONGEST = 0.10, 0.5  # m: as the issue asks, not as the code has it
LEAST = 0.002  # m: no splat is thinner than 1 mm, so spacings below this do not count
SLACK = 1e-4  # m: float32 positions of large scenes
WORLDS = ("worlds/small_house", "worlds/small_warehouse")
DEPTH_SCENES: tuple[tuple[KindName, int], ...] = (("apartment", 1), ("apartment", 7), ("office", 1))
DEPTH_SIZE: SizeName = "medium"
DEPTH_VIEWS = 6
_DIAGONAL = 0.5**0.5
_WAYS = [(1, 0), (-1, 0), (0, 1), (0, -1)] + [
    (a * _DIAGONAL, b * _DIAGONAL) for a in (1, -1) for b in (1, -1)
]


@dataclass(frozen=True)
class Unlit:
    """A draft in plain daylight: where splats lie hardly depends on light, which takes long."""

    surface: ProceduralSurface
    normals: F32

    def shade(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> SurfaceSample:
        """See `Shader.shade`."""
        albedo = np.asarray(self.surface.reflect(face, bary)[0], np.float32)
        colour = np.clip(albedo, 0, 1) ** np.float32(0.45)
        return SurfaceSample(albedo, np.ones_like(albedo), colour, self.normals[face])


def _place_world(folder: str, ctx: FigureContext) -> tuple[Placement, GaussianCloud]:
    file = find_world_file(ctx.need_data(folder))
    assert file is not None
    meshes, _ = place_on_floor(load_world_meshes(load_sdf(file), ctx.progress))
    mesh = meshes.visual
    shader = ShaderFlat(mesh, TextureAlbedo(mesh, meshes.paints, footprint=0.02))
    placement = place_surfels(mesh, shader, count=int(1000 * mesh.areas().sum()))
    return placement, shade_surfels(placement, shader)


def _place_draft(kind: KindName, seed: int, size: SizeName) -> tuple[Placement, GaussianCloud]:
    draft = KINDS[kind].draft(seed, size=size)
    shader = _unlit(draft)
    count = int(KINDS[kind].density * floor_area(draft))
    placement = place_draft(draft, shader, count, seed=seed)
    return placement, shade_surfels(placement, shader)


def _unlit(draft: SceneDraft) -> Unlit:
    surface = ProceduralSurface(draft.mesh, draft.materials)
    return Unlit(surface, draft.mesh.normals().astype(np.float32))


def _far_from(points: F64, triangles: F64) -> F64:
    """Distance of points [P, 2] to triangles [K, 3, 2]: 0 inside."""
    best = np.full(len(points), np.inf)
    for at in range(0, len(triangles), 64):
        a = triangles[at : at + 64]
        b = np.roll(a, -1, 1)
        edge = b - a
        to = points[:, None, None] - a  # [P, K, 3, 2]
        along = (to * edge).sum(3) / np.maximum((edge**2).sum(2), 1e-30)
        off = to - np.clip(along, 0, 1)[..., None] * edge
        side = edge[..., 0] * to[..., 1] - edge[..., 1] * to[..., 0]
        inside = (side >= 0).all(2) | (side <= 0).all(2)
        distance = np.sqrt((off**2).sum(3)).min(2)
        best = np.minimum(best, np.where(inside, 0.0, distance).min(1))
    return best


def count_overreach(placement: Placement, cloud: GaussianCloud) -> tuple[int, float, float]:
    """Splats that break the rule, the farthest reach beyond an outline, and the longest [m].

    The rule: two standard deviations reach at most one spacing of the splat's tile, and never
    more than 10 cm, beyond the outline of its piece of surface; no standard deviation over 0.5 m.
    """
    charts, chart = placement.charts, placement.cells.chart
    spacing = (placement.tiles.size / placement.tiles.cells).max(axis=1)[placement.cells.tile]
    limit = np.clip(spacing, LEAST, FARTHEST)
    frame = charts.axes[chart][:, :2]
    centre = np.einsum("nij,nj->ni", frame, cloud.means - charts.origin[chart])
    flat = np.einsum("nij,njk->nik", frame, rotation_from_quaternion(cloud.quats)[:, :, :2])
    broken = cloud.scales.max(axis=1) > LONGEST + SLACK
    farthest = 0.0
    order = np.argsort(chart, kind="stable")
    first = np.searchsorted(chart[order], np.arange(len(charts) + 1))
    for a, b in _WAYS:
        end = centre + np.einsum("nik,nk->ni", flat, 2.0 * cloud.scales[:, :2] * (a, b))
        # most ends lie within the bounds of a chart that is a whole rectangle
        low, high = charts.lower[chart], charts.upper[chart]
        whole = charts.area >= 0.999 * np.prod(charts.upper - charts.lower, axis=1)
        beyond = np.linalg.norm(np.maximum(0, np.maximum(low - end, end - high)), axis=1)
        for c in np.flatnonzero(~whole & (np.diff(first) > 0)):
            rows = order[first[c] : first[c + 1]]
            faces = charts.corners[charts.start[c] : charts.start[c + 1]]
            beyond[rows] = _far_from(end[rows], faces)
        broken |= beyond > limit + SLACK
        farthest = max(farthest, float(beyond.max(initial=0.0)))
    return int(broken.sum()), farthest, float(cloud.scales.max(initial=0.0))


def _reach_of(unit: tuple[KindName, int, SizeName]) -> tuple[int, int, int, float, float]:
    """Splats of a draft: breaking the rule, named by `scene check`, all; farthest, longest [m]."""
    placement, cloud = _place_draft(*unit)
    broken, reach, sigma = count_overreach(placement, cloud)
    needles = find_needles(cloud, build_occupancy(placement.mesh))  # as `check_scene` does
    return broken, len(np.union1d(needles.long, needles.bare)), len(cloud), reach, sigma


def measure_needles(ctx: FigureContext) -> list[FigureRow]:
    """Four small scenes of each kind, and two of the default size."""
    sizes: list[tuple[KindName, int, SizeName]] = [("office", 1, "medium")]
    sizes.append(("supermarket", 4, "medium"))
    for seed in range(4):
        sizes += [(kind, seed, "small") for kind in KINDS]
    found = np.array(list(spread(_reach_of, sizes, ctx, "scenes")))
    broken, named, splats = found[:, :3].sum(axis=0).astype(int).tolist()
    farthest, longest = found[:, 3:].max(axis=0).round(6).tolist()  # places are float32
    detail = f"{len(sizes)} scenes of {len(KINDS)} kinds, {splats:,} splats, unlit"
    return [
        row_at_most("splats that reach too far, generated", broken, 0, "", detail),
        row_at_most("splats that `scene check` names, generated", named, 0, "", detail),
        row_at_most("farthest beyond an outline, generated", 100 * farthest, 10.0, "cm", detail),
        row_at_most("longest standard deviation, generated", longest, LONGEST, "m", detail),
    ]


def measure_world_needles(ctx: FigureContext) -> list[FigureRow]:
    """Both worlds that nobody generated."""
    rows: list[FigureRow] = []
    for folder in WORLDS:
        placement, cloud = _place_world(folder, ctx)
        count, reach, sigma = count_overreach(placement, cloud)
        world = f"{folder.removeprefix('worlds/')}, {len(cloud):,} splats, unlit, "
        world += f"farthest {100 * reach:.1f} cm, longest {sigma:.2f} m"
        rows.append(row_at_most("splats that reach too far, imported", count, 0, "", world))
    return rows


def floor_error(
    mesh: SceneMesh, cloud: GaussianCloud, camera: Camera, views: list[F64]
) -> tuple[F64, F64]:
    """Depth over rays less one, of all floor pixels, and of all others."""
    caster = RayCaster(mesh)
    normals = mesh.normals()
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    grid = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], -1)
    shown = RendererCpu(cloud).render(camera, np.stack(views), outputs=("depth",)).depth
    assert shown is not None
    floor: list[F64] = []
    rest: list[F64] = []
    for view, depth in zip(views, shown, strict=True):
        ray = grid.reshape(-1, 3) @ view[:3, :3]
        eye = -view[:3, :3].T @ view[:3, 3]
        face, t, _ = caster.cast(np.broadcast_to(eye, ray.shape), ray)
        seen = (face >= 0) & np.isfinite(depth.ravel())
        error = depth.ravel().astype(np.float64)[seen] / t[seen] - 1
        height = (eye + ray[seen] * t[seen, None])[:, 2]
        level = (np.abs(height) < 0.005) & (normals[face[seen], 2] > 0.99)
        floor.append(error[level])
        rest.append(error[~level])
    return np.concatenate(floor), np.concatenate(rest)


def measure_floor_depth(ctx: FigureContext) -> list[FigureRow]:
    """Expected depth of floor pixels against rays, at eye height, in two sizes of picture."""
    cameras = {
        "640x480": Camera.from_hfov(640, 480, 79.0),
        "224x224": Camera.from_hfov(224, 224, 90.0),
    }
    errors: dict[tuple[KindName, str], list[tuple[F64, F64]]] = {}
    for number, (kind, seed) in enumerate(DEPTH_SCENES):
        ctx.progress("scenes", number, len(DEPTH_SCENES))
        draft = KINDS[kind].draft(seed, size=DEPTH_SIZE)
        shader = _unlit(draft)
        count = int(KINDS[kind].density * floor_area(draft))
        cloud = shade_surfels(place_draft(draft, shader, count, seed=seed), shader)
        views = choose_views(draft, RayCaster(draft.mesh), DEPTH_VIEWS, seed)
        for name, camera in cameras.items():
            found = floor_error(draft.mesh, cloud, camera, views)
            errors.setdefault((kind, name), []).append(found)
    rows = []
    for (kind, name), pairs in errors.items():
        on, off = (100 * np.concatenate(part) for part in zip(*pairs, strict=True))
        seeds = ", ".join(str(seed) for k, seed in DEPTH_SCENES if k == kind)
        detail = (
            f"{kind}, {DEPTH_SIZE}, seeds {seeds}, {KINDS[kind].density:,.0f} a m², "
            f"{DEPTH_VIEWS} views each, eye 1.25 m; with its sign {np.median(on):+.2f} %, "
            f"90 of 100 pixels within {np.quantile(np.abs(on), 0.9):.2f} %, "
            f"all that is no floor {np.median(np.abs(off)):.2f} %"
        )
        title, value = f"floor depth off rays, median, {kind}, {name}", float(np.median(np.abs(on)))
        if (kind, name) == ("apartment", "640x480"):
            rows.append(row_at_most(title, value, 0.5, "%", detail))
        else:  # coarser splats, or half a pixel that is centimetres of floor: docs/renderer.md
            rows.append(FigureRow(name=title, value=value, unit="%", detail=detail))
    return rows


FIGURES = [
    Figure("procedural.needles", "Splats that reach too far", measure_needles, 15.0),
    Figure("scenes.needles", "Splats that reach too far, in worlds", measure_world_needles, 3.0),
    Figure("procedural.floor_depth", "Depth of floors against rays", measure_floor_depth, 4.0),
]
