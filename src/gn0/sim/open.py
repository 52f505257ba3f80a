"""From a scene to a simulator that is ready to run, in one call."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from gn0.config import check_config, whole_number
from gn0.errors import ConfigError, SceneError, brief
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.paper import BEV_CUT
from gn0.people.person import RADIUS
from gn0.render.bev import BevPicture, render_bev
from gn0.render.light import LightCondition, relight_cloud
from gn0.render.open import build_renderer, name_drawing
from gn0.render.renderer import VISIBLE_BACKENDS, DrawnScene
from gn0.scenes.scene import Scene
from gn0.sim.ego_map import MapView, read_map_view
from gn0.sim.motion import Motion
from gn0.sim.noise import Noise
from gn0.sim.presets import CameraPreset, find_preset
from gn0.sim.sensor.table import carry_sensors
from gn0.sim.sensors import SensorConfig, check_map_mode
from gn0.sim.simulator import Simulator
from gn0.storage import content_hash

if TYPE_CHECKING:
    from gn0.avatars.bank import AvatarBank


def look_hash(scene: Scene, light: LightCondition | None = None) -> str:
    """Digest of a scene's splats under a light: what its pictures are made of."""
    plain = scene.cloud_hash or scene.gaussians.content_hash
    if light is None or light.is_neutral:
        return plain
    return content_hash(plain, msgspec.json.encode(light))


def name_look(episode: Episode) -> str:
    """The scene of an episode and its light in one name: equal names, one renderer."""
    if episode.light is None:
        return episode.scene_id
    return f"{episode.scene_id}\0{msgspec.json.encode(episode.light).decode()}"


def split_look(name: str) -> tuple[str, LightCondition | None]:
    """Scene id and light of a name that `name_look` made."""
    scene_id, _, light = name.partition("\0")
    return scene_id, msgspec.json.decode(light, type=LightCondition) if light else None


def open_simulator(
    scene: Scene | Path | str,
    preset: str | CameraPreset = "gn_bench",
    backend: str = "auto",
    sensors: Iterable[str] = frozenset(),
    agent: AgentSpec | None = None,
    max_steps: int = 500,
    *,
    cut_height: float = BEV_CUT,
    map_mode: str = "prior",
    map_view: MapView | Mapping[str, Any] | None = None,
    navigation: NavigationMap | None = None,
    light: LightCondition | None = None,
    renderer: DrawnScene | None = None,
    one_step_moves: bool = False,
    motion: Motion | None = None,
    noise: Noise | None = None,
    bank: AvatarBank | Path | str | None = None,
    person_radius: float = RADIUS,
) -> Simulator:
    """A simulator of a scene with its map, renderer and BEV, as far as `sensors` need them.

    Args:
        scene: a Scene, or the path of a scene folder.
        preset: cameras and body, by name or value.
        backend: renderer backend; "auto" takes the best that is here, "cpu-visible" and
            "cuda-visible" draw views from the splats that can be seen near each place (see
            `gn0.render.visible`).
        sensors: any of `gn0 list sensors`.
        agent: the body, instead of the preset's.
        max_steps: steps until an episode is truncated.
        cut_height: what lies higher [m] is left out of the BEV.
        map_mode: what bev and occupancy show: the whole scene (prior), what the agent has seen
            (explored), or nothing (none).
        map_view: squares of the sensor ego_map, and the arrow of the occupancy picture; see
            `gn0.sim.ego_map.MapView`, whose fields it may also be.
        navigation: the map that moves the agent; by default its radius decides.
        light: how the scene is lit, in views and BEV alike; as it was made when None.
        renderer: draws instead of one of `backend`; it must hold this scene in this light.
        one_step_moves: see `Simulator`.
        motion: what moves in the scene, see `gn0.sim.motion`.
        noise: what the body adds to depth, pose and moves; nothing when None.
        bank: of the people of episodes who have names in one; generated ones need none.
        person_radius: of people's discs [m].

    Raises:
        ConfigError: unknown preset, backend, sensor or map mode, a map in mode none, a renderer
            that cannot draw, or max_steps is not a whole number of at least 1.
        SceneError: nothing is walkable for this agent.
        StorageError, FormatError: the scene folder is missing or broken.
    """
    if renderer is not None and not callable(getattr(renderer, "render", None)):
        raise ConfigError(
            f"renderer is {brief(renderer)}, which draws nothing",
            remedy="give DrawnScene(build_renderer(scene.gaussians)), or the name of a backend as "
            "backend='cpu', 'cuda', 'cpu-visible' or 'cuda-visible'",
        )
    max_steps = whole_number(max_steps, "max_steps")  # before a scene is opened for nothing
    active = frozenset(sensor.name for sensor in carry_sensors(sensors).sensors)
    mode = check_map_mode(map_mode, active)
    if not isinstance(scene, Scene):
        from gn0.scenes.folder import load_scene  # readers are not needed for a Scene in memory

        scene = load_scene(Path(scene))
    cameras = find_preset(preset) if isinstance(preset, str) else check_config(preset)
    config = SensorConfig(
        active=active,
        preset=cameras,
        map_view=read_map_view(map_view),
        map_mode=mode,
        cut_height=cut_height,
        noise=noise or Noise(),
    )
    carried, explores = config.carried, config.explores
    body = agent or cameras.agent
    if navigation is None:
        navigation = NavigationMap(scene.grid, body.radius)
    if not navigation.inflated.free_area:
        raise SceneError(
            f"nothing is walkable for an agent of radius {body.radius:g} m",
            where=scene.path or scene.id,
            remedy="run `gn0 scene check`, or use an agent with a smaller radius",
        )
    bev: BevPicture | None = None
    if renderer is None and carried.needs_renderer(explores):
        cloud = scene.gaussians if light is None else relight_cloud(scene.gaussians, light)
        renderer = DrawnScene(build_renderer(cloud, name_drawing(backend)))
    if carried.bev and renderer is not None and not explores:
        bev = render_bev(
            look_hash(scene, light),
            renderer,
            np.array(scene.grid.bounds).reshape(2, 2),
            scene.grid.resolution,
            cut_height,
            background=cameras.background,
        )
    if backend in VISIBLE_BACKENDS and renderer is not None:  # the BEV is seen from above
        renderer = renderer.limit_to_visible(
            scene.cloud_hash or scene.gaussians.content_hash,
            navigation.inflated,
            body.camera_height,
        )
    return Simulator(
        scene,
        navigation=navigation,
        sensors=config,
        renderer=renderer,
        bev=bev,
        agent=body,
        max_steps=max_steps,
        one_step_moves=one_step_moves,
        motion=motion,
        bank=bank,
        light=light,
        person_radius=person_radius,
    )
