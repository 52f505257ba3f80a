"""What stands on the renderer: visible sets and simulation on the device."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.maps.navigation import NavigationMap
from gn0.render.cuda.renderer import RendererCuda, RendererVisibleCuda
from gn0.render.visible_places import VisibleOptions
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.vector import VectorEnv
from gn0.testing.renderer_check import psnr
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes
from gn0_figures.device_scenes import flat_scene
from gn0_figures.flat import flat_camera


def test_visible_sets(device, scale, tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path))
    scene = flat_scene(scale.splats)
    renderer = RendererCuda(scene.cloud, device=device)
    full = device.kind == "cuda"
    options = VisibleOptions() if full else VisibleOptions(cell=1.0, places=2, pixels=64)
    sets = RendererVisibleCuda(renderer, "flat", scene.floor, scene.eye, options)
    camera, views = flat_camera(scale.pixels, scale.pixels), scene.views(scale.views, 3)
    got, want = sets.render(camera, views), renderer.render(camera, views)
    assert got.rgb is not None
    assert want.rgb is not None
    assert psnr(got.rgb, want.rgb, 255) > (55.0 if full else 25.0)
    cell = next(c for c in sets.sets.locate(camera, views) if c is not None)
    assert 0 < sets.size_of(cell) < len(scene.cloud)
    again = RendererVisibleCuda(renderer, "flat", scene.floor, scene.eye, options)
    assert again.render(camera, views).rgb.tobytes() == got.rgb.tobytes()  # type: ignore[union-attr]
    assert again.built == 0, "read from the cache"
    above, view = scene.bev(scale.bev)
    assert sets.render(above, view).rgb.tobytes() == renderer.render(above, view).rgb.tobytes()  # type: ignore[union-attr]


@pytest.mark.small
def test_agents_walk_as_on_the_cpu(device) -> None:
    grid = build_floor_plan(1, width=6.0, depth=5.0)
    scene = build_map_scene(grid, "plan")
    episodes = build_point_episodes(scene, NavigationMap(grid, 0.2), 6)
    count, steps = (64, 40) if device.kind == "cuda" else (4, 8)
    actions = np.random.default_rng(0).choice(4, (steps, count), p=[0.05, 0.55, 0.2, 0.2])
    there = VectorEnvDevice(count, scene, episodes=episodes, device=device, max_steps=12)
    here = VectorEnv(count, scene, episodes=episodes, sensors=("goal_vector",), max_steps=12)
    there.reset(seed=3)
    here.reset(seed=3)
    for row in actions:
        seen, rewards, terminated, truncated, infos = there.step(device.upload(row))
        want, gains, ended, cut, facts = here.step(row)
        assert (infos["pose"].numpy() == np.asarray(facts["pose"])).all()
        assert (rewards.numpy() == gains).all()
        assert (terminated.numpy() == ended).all()
        assert (truncated.numpy() == cut).all()
        assert (seen["goal_vector"].numpy() == want["goal_vector"]).all()
    there.synchronize()
