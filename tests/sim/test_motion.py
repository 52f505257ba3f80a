"""Moving parts in simulators: nobody is shown yesterday's picture, and nothing else changes."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.data.sample_pictures import build_eyes, draw_views
from gn0.device.host import DeviceHost
from gn0.errors import RenderError, SimError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.render.host import RendererHost
from gn0.render.instance import Instance, move_instance
from gn0.render.open import open_renderer
from gn0.render.renderer import DrawnScene
from gn0.scenes.parts import build_ball, build_box, build_leaf
from gn0.sim import presets
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.motion import STILL, Moment, PartPath, PathMotion, take_moment
from gn0.sim.open import open_simulator
from gn0.sim.presets import CameraPreset
from gn0.sim.vector import VectorEnv
from gn0.storage import content_hash
from gn0.testing.scenes import build_point_episodes, build_room_scene

SPACING = 0.05


def place(x: float, y: float, z: float, yaw: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    pose[:3, 3] = x, y, z
    return pose


def roll(*times: float) -> PathMotion:
    """A ball that crosses the flat's first room at 1 m/s, between some times [s]."""
    poses = np.stack([place(1.0 + t, 2.5, 0.3) for t in times])
    return PathMotion(
        {"ball": build_ball(0.3, spacing=SPACING)}, [PartPath("ball", np.array(times), poses)]
    )


@pytest.fixture(scope="module")
def flat():
    return build_room_scene(spacing=0.2)


@pytest.fixture
def tiny(monkeypatch) -> str:
    """A preset of small pictures, by its name."""
    camera = Camera.from_hfov(36, 28, 90)
    monkeypatch.setitem(presets._BY_NAME, "tiny", CameraPreset("tiny", camera, camera))
    return "tiny"


@pytest.fixture(scope="module")
def episodes(flat):
    return build_point_episodes(flat, NavigationMap(flat.grid, 0.2), 3, agent=AgentSpec())


def test_who_stands_still_sees_what_moves(flat, episodes, tiny) -> None:
    """Four turns on the spot and back: the same pose at another time is another picture."""
    motion = roll(0.0, 4.0)
    simulator = open_simulator(flat, tiny, "cpu", {"rgb", "depth"}, motion=motion)
    episode = replace_start(episodes[0], (1.0, 2.5, 0.0))
    first = simulator.reset(episode)
    simulator.step(2)
    again = simulator.step(3).observation
    assert (first.rgb != again.rgb).any() and (first.depth != again.depth).any()
    drawn = DrawnScene(open_renderer("cpu"))
    drawn.renderer.keep("", flat.gaussians)
    drawn.name_cloud("ball", motion.clouds["ball"])
    suite = simulator.suite
    views = suite.views_of([simulator.pose])
    for observation in (first, again):
        want = drawn.render(
            suite.config.preset.rgb, views, background=suite.config.preset.background,
            parts=motion.at(observation.time),
        )  # fmt: skip
        np.testing.assert_array_equal(observation.rgb, want.rgb[0])


def replace_start(episode, start):
    import msgspec

    return msgspec.structs.replace(episode, start=start, path=(start[:2], episode.goal))


def test_what_stands_still_again_is_not_drawn_again(flat, episodes, tiny, monkeypatch) -> None:
    """The ball lies still from 0.5 s on; without a ball no picture is drawn more often."""
    calls = []
    render = DrawnScene.render
    monkeypatch.setattr(
        DrawnScene, "render", lambda own, *a, **m: (calls.append(m), render(own, *a, **m))[1]
    )
    walker = open_simulator(flat, tiny, "cpu", set())
    walker.reset(replace_start(episodes[0], (1.0, 2.5, math.pi)))
    while not walker.step(1).collided:
        pass
    wall = replace_start(episodes[0], tuple(walker.pose))
    for motion, want in ((None, 1), (roll(0.0, 0.5), 2)):
        simulator = open_simulator(flat, tiny, "cpu", {"rgb", "depth"}, motion=motion)
        calls.clear()
        simulator.reset(wall)
        for _ in range(3):
            result = simulator.step(1)
            assert result.collided and result.moved == 0.0
        assert len(calls) == want  # where it was, and where it came to rest
        assert all("parts" in more for more in calls) == (motion is not None)


@pytest.mark.parametrize("visible", [False, True])
def test_many_agents_see_what_one_sees(
    flat, episodes, tiny, visible, tmp_path, monkeypatch
) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path))
    motions = {"left": roll(0.0, 3.0), "right": roll(1.0, 2.0)}
    scenes = [replace(flat, id=name) for name in motions]
    mine = [
        episode
        for scene in scenes
        for episode in build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 2)
    ]
    many = VectorEnv(
        4, scenes, episodes=mine, sensors=("rgb", "depth", "goal_picture"), preset=tiny,
        backend="cpu", max_steps=3, motions=motions, visible_sets=visible,
    )  # fmt: skip
    backend = "cpu-visible" if visible else "cpu"
    ones = {
        scene.id: open_simulator(
            scene, tiny, backend, {"rgb", "depth", "goal_picture"}, max_steps=3,
            motion=motions[scene.id],
        )
        for scene in scenes
    }  # fmt: skip
    seen, infos = many.reset(seed=1, options={"episode": [0, 1, 2, 3]})
    by_id = {(e.scene_id, e.id): e for e in mine}
    for step in range(3):
        for agent in range(4):
            episode = by_id[infos["scene_id"][agent], infos["episode_id"][agent]]
            one = ones[episode.scene_id]
            want = one.reset(episode)
            for _ in range(step):
                want = one.step(2).observation
            for name in ("rgb", "depth", "goal_picture"):
                np.testing.assert_array_equal(seen[name][agent], getattr(want, name), err_msg=name)
        if step < 2:
            seen, *_, infos = many.step(np.full(4, 2))
    many.close()


def test_their_own_maps_of_what_moves_are_the_same(flat, tiny) -> None:
    """One agent and each of many; an agent that goes back to a saved state, and on."""
    motion = roll(0.0, 3.0)
    mine = build_point_episodes(flat, NavigationMap(flat.grid, 0.2), 2)
    shared = {"max_steps": 8, "map_mode": "explored", "backend": "cpu", "preset": tiny}
    many = VectorEnv(
        2, flat, episodes=mine, sensors=("bev", "occupancy"), motions={flat.id: motion}, **shared
    )
    one = open_simulator(flat, sensors={"bev", "occupancy"}, motion=motion, **shared)
    seen, infos = many.reset(seed=1, options={"episode": [0, 1]})
    walk = [0, 2, 2, 1, 3, 1]  # the first is reset
    for step in range(len(walk)):
        for agent in range(2):
            episode = next(e for e in mine if e.id == infos["episode_id"][agent])
            want = one.reset(episode)
            for k, action in enumerate(walk[1 : step + 1]):
                if k == 1:
                    kept = one.save_state()
                    one.step(1)
                    one.restore_state(kept)
                want = one.step(action).observation
            for name in ("bev", "occupancy"):
                np.testing.assert_array_equal(seen[name][agent], getattr(want, name), err_msg=name)
            assert one.save_state().explored.time == want.time
        if step + 1 < len(walk):
            seen, *_, infos = many.step(np.full(2, walk[step + 1]))
    many.close()


class RendererByHost(RendererBatch):
    """Is told by the host where eyes and parts are."""

    def __init__(self, device) -> None:
        super().__init__(device)
        self.traits = replace(self.traits, device_views=False)


@pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
@pytest.mark.parametrize("kind", [RendererBatch, RendererByHost])
def test_agents_on_a_device_see_the_same(flat, tiny, kind) -> None:
    """Autoresets included: an episode that begins anew begins at time 0; three scenes, two move."""
    shade = np.float32([[0.6] * 3, [0] * 3, [0] * 3, [0.4] * 3])
    box = np.stack([place(2.0, 2.5, 0.0, yaw) for yaw in (0.0, 1.0)])
    two = PathMotion(
        {"ball": build_box((0.3, 0.5, 0.8), spacing=SPACING)},  # of the same name as the ball
        [PartPath("ball", np.array([0.0, 1.0]), box, shade, nearer=0.5 * k) for k in range(2)],
    )
    scenes = [replace(flat, id=name) for name in ("left", "plain", "right")]
    motions = {"left": roll(0.0, 1.0), "right": two}
    mine = [
        episode
        for scene in scenes
        for episode in build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 2)
    ]
    settings = {"episodes": mine, "sensors": ("rgb", "depth"), "preset": tiny, "max_steps": 2}
    device = DeviceHost(1)
    env = VectorEnvDevice(
        3, scenes, device=device, renderer=kind(device), motions=motions,
        final_pictures=True, **settings,
    )  # fmt: skip
    twin = VectorEnv(3, scenes, backend="cpu", motions=motions, **settings)
    still = VectorEnv(3, scenes, backend="cpu", **settings)
    mine, theirs = env.reset(seed=3)[0], twin.reset(seed=3)[0]
    plain = still.reset(seed=3)[0]
    differs = False
    for _ in range(4):
        gap = np.abs(mine["rgb"].numpy().astype(int) - theirs["rgb"])
        assert gap.max() <= 3
        np.testing.assert_allclose(mine["depth"].numpy(), theirs["depth"], atol=2e-3)
        differs = differs or (plain["rgb"] != theirs["rgb"]).any()
        mine, _, _, _, told = env.step(np.full(3, 2))
        theirs, *_, infos = twin.step(np.full(3, 2))
        plain = still.step(np.full(3, 2))[0]
        for k, agent in enumerate(told["final_obs"]["agents"].tolist()):
            gap = np.abs(
                told["final_obs"]["rgb"][k].numpy().astype(int) - infos["final_obs"][agent]["rgb"]
            )
            assert gap.max() <= 3
    assert differs


def test_renderers_that_know_no_parts_are_shown_moved_splats(flat) -> None:
    """A plug-in sees the same ball, by another way: 75 dB and a tenth of a millimetre."""
    from gn0.render.cpu import RendererCpu
    from gn0.testing.renderer_check import psnr

    motion = roll(0.0, 4.0)
    camera = Camera.from_hfov(80, 60, 90)
    parts = [motion.at(t) for t in (0.5, 1.5)] + [()]
    simulator = open_simulator(flat, "gn_bench", "cpu", {"rgb"})
    views = simulator.suite.views_of([Pose2D(0.6, 2.5, 0.0)] * 3)
    found = []
    for renderer in (open_renderer("cpu"), RendererHost("mine", RendererCpu)):
        renderer.keep("flat", flat.gaussians)
        renderer.name_cloud("ball", motion.clouds["ball"])
        found.append(renderer.render(camera, views, "flat", parts=parts))
    own, moved = found
    assert psnr(own.rgb, moved.rgb, 255) > 75
    near = np.isfinite(own.depth)
    assert (near == np.isfinite(moved.depth)).all()
    assert np.abs(own.depth[near] - moved.depth[near]).max() <= 1e-4
    assert (own.rgb[0] != own.rgb[2]).any() and (own.rgb[2] == moved.rgb[2]).all()


def test_equal_poses_of_another_time_are_drawn_apart(flat, tiny) -> None:
    """Pictures of data: neighbours of equal pose are one rendering only while nothing moves."""
    navigation = NavigationMap(flat.grid, 0.2)
    eyes = build_eyes(flat, navigation, presets.find_preset(tiny), AgentSpec())
    motion = roll(0.0, 4.0)
    for name, cloud in motion.clouds.items():
        eyes.renderer.name_cloud(name, cloud)
    poses = np.tile([0.6, 2.5, 0.0], (3, 1))
    moments = [take_moment(motion, time) for time in (0.0, 1.0, 1.0)]
    for depth in (False, True):
        one, two, three = draw_views(eyes, poses, depth=depth, moments=moments)
        assert (one.rgb != two.rgb).any() and one.rgb is not two.rgb
        assert two.rgb.tobytes() == three.rgb.tobytes()
        if depth:
            assert (one.depth != two.depth).any()
        plain = next(draw_views(eyes, poses, depth=depth))
        assert (plain.rgb != two.rgb).any()


def test_a_moment_of_nothing_adds_no_byte_to_a_key() -> None:
    assert STILL.key == b"" == Moment(7.0).key == take_moment(None, 3.0).key
    motion = roll(0.0, 1.0)
    keys = [take_moment(motion, time).key for time in (0.0, 0.5, 1.0, 2.0)]
    assert len(set(keys)) == 3 and keys[2] == keys[3]  # it has come to rest
    one = Instance("ball", np.eye(4))
    others = [
        Instance("box", np.eye(4)),
        Instance("ball", place(0, 0, 1e-6)),
        Instance("ball", np.eye(4), np.ones(3, np.float32)),
        Instance("ball", np.eye(4), nearer=0.1),
    ]
    assert len({Moment(parts=(other,)).key for other in (one, *others)}) == 5
    as_ever = content_hash("ball", np.eye(4).tobytes(), b"")  # what is not nearer adds nothing
    assert Moment(parts=(one,)).key == bytes.fromhex(as_ever)
    assert Moment(parts=(one, others[0])).key != Moment(parts=(others[0], one)).key


@given(st.floats(0, 4), st.floats(-3.1, 3.1), st.floats(-3.1, 3.1))
def test_paths_turn_the_shorter_way_at_an_even_pace(time, start, turn) -> None:
    turn = turn if abs(turn) > 1e-3 else 0.5
    poses = np.stack([place(0, 0, 0, start), place(4, -2, 1, start + turn)])
    path = PartPath("x", np.array([0.0, 4.0]), poses)
    found = path.at(time).pose
    want = place(time, -time / 2, time / 4, start + turn * time / 4)
    np.testing.assert_allclose(found, want, atol=1e-9)


def test_paths_hold_their_ends_or_begin_again() -> None:
    poses = np.stack([place(x, 0, 0) for x in (0.0, 1.0)])
    once = PartPath("x", np.array([1.0, 2.0]), poses)
    assert [once.at(t).pose[0, 3] for t in (0.0, 1.5, 9.0)] == [0.0, 0.5, 1.0]
    again = PartPath("x", np.array([1.0, 2.0]), poses, repeats=True)
    assert [again.at(t).pose[0, 3] for t in (1.25, 2.25, 7.25)] == [0.25] * 3


def test_motions_without_meaning_are_refused() -> None:
    ball = {"ball": build_ball(spacing=0.05)}
    rest = np.eye(4)[None]
    for times, poses, cloud, error, match in (
        ([0.0], rest, "box", SimError, "no cloud is named 'box'"),
        ([0.0, 1.0], rest, "ball", SimError, "poses at 2 times"),
        ([], rest[:0], "ball", SimError, "at 0 times"),
        ([1.0, 1.0], rest.repeat(2, 0), "ball", SimError, "do not increase"),
        ([0.0, np.nan], rest.repeat(2, 0), "ball", SimError, "do not increase"),
        ([0.0], np.full((1, 4, 4), np.nan), "ball", RenderError, "not finite"),
        ([0.0], 2 * rest, "ball", RenderError, "not a rigid"),
    ):
        with pytest.raises(error, match=match):
            PathMotion(ball, [PartPath(cloud, np.array(times), poses)])

    class Crowd(PathMotion):
        def at(self, time):
            return super().at(time) * 40

    with pytest.raises(RenderError, match="40 instances in one view"):
        take_moment(Crowd(ball, [PartPath("ball", np.zeros(1), rest)]), 0.0)


@pytest.mark.parametrize("build", [build_ball, build_box, build_leaf])
def test_small_things_are_closed_and_face_outwards(build) -> None:
    """Seen from six sides, nothing shows through and every surface is near its size."""
    cloud: GaussianCloud = build(spacing=0.02)
    low, high = cloud.means.min(0), cloud.means.max(0)
    centre, size = (low + high) / 2, high - low
    outward = ((cloud.means - centre) * cloud.normal).sum(1)
    assert (outward > -1e-4).all()
    renderer = open_renderer("cpu")
    renderer.keep("it", cloud)
    for axis in range(3):
        for side in (-1.0, 1.0):
            forward = np.eye(3)[axis] * side
            across = np.eye(3)[(axis + 1) % 3]
            rotation = np.stack([across, np.cross(forward, across), forward])
            view = np.eye(4)
            view[:3, :3], view[:3, 3] = rotation, -rotation @ (centre - 3 * forward)
            pixel = float(np.delete(size, axis).min()) / 14
            camera = Camera.orthographic(60, 60, pixel, near=0.0, far=100.0)
            found = renderer.render(camera, view, "it")
            u, v = ((np.arange(60) - 29.5) * pixel,) * 2
            points = u[None, :, None] * rotation[0] + v[:, None, None] * rotation[1]  # [60, 60, 3]
            reach = size / 2 - 3 * pixel
            inside = (
                np.linalg.norm(points, axis=2) < reach.min()
                if build is build_ball
                else (np.abs(points) < reach + 1e-6 + 99 * np.abs(rotation[2])).all(axis=2)
            )
            assert inside.any()
            assert (found.alpha[0][inside] > 0.9).all()
            assert np.isfinite(found.depth[0][inside]).all()


def test_small_things_need_a_size() -> None:
    from gn0.errors import SceneError

    for build, size in ((build_ball, 0.0), (build_leaf, math.nan), (build_ball, -1.0)):
        with pytest.raises(SceneError, match="more than 0"):
            build(size)


def test_a_moved_ball_is_the_truth_for_the_gain(flat) -> None:
    """The part's own shade: half the light from above, as `move_instance` says it."""
    gain = np.zeros((4, 3), np.float32)
    gain[0], gain[3] = 0.6, 0.4
    ball = build_ball(0.3, spacing=SPACING)
    stands = Instance("ball", place(1.5, 2.5, 0.5, 0.7), gain)
    renderer = open_renderer("cpu")
    renderer.keep("flat", flat.gaussians)
    renderer.name_cloud("ball", ball)
    camera = Camera.from_hfov(64, 48, 90)
    views = open_simulator(flat, "gn_bench", "cpu", {"rgb"}).suite.views_of([Pose2D(0.4, 2.5, 0.0)])
    own = renderer.render(camera, views, "flat", parts=[stands])
    moved = renderer.render(camera, views, "flat", extra=move_instance(ball, stands))
    assert np.abs(own.rgb.astype(int) - moved.rgb).max() <= 1
