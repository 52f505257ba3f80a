"""Scenes of the device's figures: the standard flat, an apartment of ours, a house of others.

`small_house` is an imported world; an apartment can be generated anywhere. Both may come ready in
the folder of `--scenes`, so that a machine with a GPU need not make them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F64, view_from_above, view_from_pose
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.render.camera import Camera
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0_figures.board import FigureContext, FigureSkipped
from gn0_figures.flat import EYE, build_flat, flat_bev, flat_floor, flat_views

BEV_CUT = 2.3  # m: under the ceilings
HOUSE_DENSITY = 6000.0  # splats a m² of surface, when it is imported here
APARTMENT = {"seed": 7, "size": "medium", "density": 10_000, "light": "draft"}


@dataclass(frozen=True)
class FigureScene:
    """A scene and where to stand in it.

    Attributes:
        name: in rows, such as "standard flat, 1 M, SH 0".
        cloud: its splats.
        floor: free cells for an agent's centre.
        eye: height [m].
        views: random free poses at eye height, for a count and a seed: [V, 4, 4].
        bev: a map camera of so many pixels, and its view.
        area: floor area [m²], for rows.
    """

    name: str
    cloud: GaussianCloud
    floor: OccupancyGrid
    eye: float
    views: Callable[[int, int], F64]
    bev: Callable[[int], tuple[Camera, F64]]
    area: float


def flat_scene(count: int, sh_degree: int = 0, *, seed: int = 0) -> FigureScene:
    """The standard synthetic flat; poses stand on its floor, so that visible sets know them."""
    floor = flat_floor()

    def views(wanted: int, stream: int) -> F64:
        found: list[F64] = []
        turn = 0
        while len(found) < wanted:
            tried = flat_views(max(2 * (wanted - len(found)), 16), seed=1000 * stream + turn)
            eyes = -np.einsum("vji,vj->vi", tried[:, :3, :3], tried[:, :3, 3])
            found += [v for v, (x, y, _) in zip(tried, eyes, strict=True) if floor.is_free(x, y)]
            turn += 1
        return np.stack(found[:wanted])

    return FigureScene(
        name=f"standard flat, {count / 1e6:g} M, SH {sh_degree}",
        cloud=build_flat(count, sh_degree=sh_degree, seed=seed),
        floor=floor,
        eye=EYE,
        views=views,
        bev=flat_bev,
        area=149.5,
    )


def scene_of(scene: Scene, name: str) -> FigureScene:
    """A scene of ours, seen by the default agent."""
    body = AgentSpec()
    navigation = NavigationMap(scene.grid, body.radius)
    free = np.argwhere(navigation.regions == 0)
    centres = navigation.grid.centres_of(free)
    low, high = centres.min(axis=0), centres.max(axis=0)

    def views(wanted: int, stream: int) -> F64:
        draw = random_stream(stream, "figure views", name)
        places = centres[draw.integers(len(centres), size=wanted)]
        yaws = draw.uniform(-np.pi, np.pi, wanted)
        return np.stack(
            [
                view_from_pose(float(x), float(y), body.camera_height, float(yaw))
                for (x, y), yaw in zip(places, yaws, strict=True)
            ]
        )

    def bev(pixels: int) -> tuple[Camera, F64]:
        span = float((high - low).max()) + 1.0
        middle = (low + high) / 2
        camera = Camera.orthographic(pixels, pixels, span / pixels, near=0.0)
        return camera, view_from_above(float(middle[0]), float(middle[1]), BEV_CUT)

    cloud = scene.gaussians
    return FigureScene(
        name=f"{name}, {len(cloud) / 1e6:.2f} M, SH {cloud.sh_degree}",
        cloud=cloud,
        floor=navigation.inflated,
        eye=body.camera_height,
        views=views,
        bev=bev,
        area=float(scene.grid.free_area),
    )


def apartment_scene(ctx: FigureContext, *, tiny: bool = False) -> FigureScene:
    """A generated apartment: the one in `--scenes`, else made now."""
    from gn0.scenes.folder import load_scene

    if ctx.scenes is not None and (ctx.scenes / "apartment").is_dir():
        return scene_of(load_scene(ctx.scenes / "apartment"), "generated apartment")
    if tiny:
        from gn0.testing.scenes import build_room_scene

        return scene_of(build_room_scene(), "a room for a dry run")
    from gn0.scenes.procedural.generate import GenerateSettings, build_generated

    settings = GenerateSettings(**APARTMENT)  # type: ignore[arg-type]
    return scene_of(build_generated(settings, "figure", ctx.progress), "generated apartment")


def house_scene(ctx: FigureContext, *, tiny: bool = False) -> FigureScene:
    """The house of others: the one in `--scenes`, else imported now.

    Raises:
        FigureSkipped: neither the scene nor the world is here.
    """
    from gn0.scenes.folder import load_scene
    from gn0.scenes.scene_sources import import_scene

    if ctx.scenes is not None and (ctx.scenes / "small_house").is_dir():
        return scene_of(load_scene(ctx.scenes / "small_house"), "small_house")
    if tiny:
        raise FigureSkipped("needs a small_house under --scenes: too much for a dry run")
    try:
        source = ctx.need_data("worlds/small_house")
    except FileNotFoundError as error:
        raise FigureSkipped(
            f"needs small_house under --scenes, or {error} under --data or $GN0_DATA"
        ) from None
    scene = import_scene(
        source, ctx.work / "small_house", density=HOUSE_DENSITY, light="flat", progress=ctx.progress
    )
    return scene_of(scene, "small_house")
