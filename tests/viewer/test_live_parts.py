"""The parts of the live view that need no browser: thinning, walking, maps, words, the gate."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from http.client import HTTPConnection

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import ConfigError
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.geometry import Pose2D, quaternion_from_rotation
from gn0.loopback import is_loopback
from gn0.maps.navigation import NavigationMap
from gn0.render.open import build_renderer
from gn0.scenes.example import build_example_scene
from gn0.sim.open import open_simulator
from gn0.sim.presets import find_preset
from gn0.sim.state import Action
from gn0.viewer.live_eyes import canvas_camera, draw_canvas
from gn0.viewer.live_loop import LiveLoop
from gn0.viewer.live_map import MapAgent, plan_map
from gn0.viewer.live_server import Gate, fetch_page, find_port, open_server
from gn0.viewer.live_splats import build_live_splats
from gn0.viewer.live_stage import OVERVIEW_FOV, overview
from gn0.viewer.live_text import name_line, plain
from gn0.viewer.live_walk import AgentWalk, colour_depth
from gn0.viewer.scene_sheet import render_views
from gn0.viewer.viewpoints import choose_viewpoints

HOSTILE = (
    "<script>window.gn0Hacked=1</script>",
    "<img src=x onerror=window.gn0Hacked=1>",
    "<iframe srcdoc='<script>parent.gn0Hacked=1</script>'></iframe>",
    "[click](javascript:window.gn0Hacked=1)",
    '![x](x" onerror="window.gn0Hacked=1)',
    "<svg onload=window.gn0Hacked=1>",
    "| a | b |\n| --- | --- |\n# big **bold** `code` $x$ &lt;b&gt; <b>",
    "</div><style>*{display:none}</style>",
    "{window.gn0Hacked=1} ~~gone~~ __under__ \\ *star*",
)


@pytest.fixture(scope="module")
def scene():
    return build_example_scene(spacing=0.05)


@pytest.fixture(scope="module")
def walk(scene):
    simulator = open_simulator(scene, sensors={"rgb", "depth", "bev", "occupancy"})
    return AgentWalk(simulator)


def as_cloud(splats) -> GaussianCloud:
    values, vectors = np.linalg.eigh(splats.covariances.astype(np.float64))
    vectors[:, :, 0] *= np.linalg.det(vectors)[:, None]
    return GaussianCloud(
        means=splats.centres,
        quats=quaternion_from_rotation(vectors).astype(np.float32),
        scales=np.sqrt(np.maximum(values, 1e-12)).astype(np.float32),
        opacities=splats.opacities,
        sh=((splats.colours - 0.5) / SH_C0)[:, None, :].astype(np.float32),
    )


def psnr(a, b) -> float:
    error = np.mean((np.asarray(a, np.float64) - np.asarray(b, np.float64)) ** 2)
    return 10 * math.log10(255**2 / max(error, 1e-9))


def test_a_small_cloud_is_passed_on_as_it_is(scene):
    cloud = scene.gaussians
    splats = build_live_splats(cloud, len(cloud))
    assert len(splats) == np.count_nonzero(cloud.opacities >= 0.02)
    assert splats.total == len(cloud)
    pose = choose_viewpoints(scene, 1)
    whole = render_views(build_renderer(cloud), pose, 160, 120)[0]
    same = render_views(build_renderer(as_cloud(splats)), pose, 160, 120)[0]
    assert psnr(whole, same) > 40  # SH beyond the constant colour is all that is lost


def test_thinned_splats_still_look_like_the_scene(scene):
    cloud = scene.gaussians
    poses = choose_viewpoints(scene, 3)
    whole = render_views(build_renderer(cloud), poses, 160, 120)
    merged = build_live_splats(cloud, len(cloud) // 4)
    assert len(merged) <= len(cloud) // 4
    random = np.sort(np.random.default_rng(0).permutation(len(cloud))[: len(merged)])
    ours = render_views(build_renderer(as_cloud(merged)), poses, 160, 120)
    theirs = render_views(build_renderer(cloud.select(random)), poses, 160, 120)
    gains = [psnr(w, o) - psnr(w, t) for w, o, t in zip(whole, ours, theirs, strict=True)]
    assert np.mean(gains) > 3.0  # dB over leaving splats out at random


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 400), st.integers(1, 300), st.integers(0, 2**32 - 1))
def test_thinning_never_exceeds_the_count_and_repeats(size, count, seed):
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(size, 4))
    cloud = GaussianCloud(
        means=(rng.normal(size=(size, 3)) * rng.choice([0, 1e-4, 1, 1e4])).astype(np.float32),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.uniform(1e-4, 0.5, (size, 3)).astype(np.float32),
        opacities=rng.uniform(0, 1, size).astype(np.float32),
        sh=rng.normal(size=(size, 1, 3)).astype(np.float32),
    )
    splats = build_live_splats(cloud, count)
    assert len(splats) <= count
    for name in ("centres", "covariances", "colours", "opacities"):
        values = getattr(splats, name)
        assert np.isfinite(values).all()
        assert np.array_equal(values, getattr(build_live_splats(cloud, count), name))
    if len(splats):
        assert splats.opacities.min() >= 0 and splats.opacities.max() <= 1
        values = np.linalg.eigvalsh(splats.covariances.astype(np.float64))
        assert (values[:, 0] >= -1e-5 * values[:, 2]).all()


def test_a_walk_moves_exactly_as_the_simulator_does(scene, walk):
    pose = choose_viewpoints(scene, 1)[0]
    assert walk.place(*pose)
    twin = AgentWalk(open_simulator(scene, sensors={"rgb", "depth", "bev", "occupancy"}))
    twin.place(*pose)
    for action in (1, 2, 2, 1, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1):
        result = twin.simulator.step(action)
        last = walk.act(Action(action))
        assert walk.pose == twin.simulator.pose
        assert (last.moved, last.bumped) == (result.moved, result.collided)
    assert walk.last.bumped and walk.bumps > 0  # a flat is not 5 m long in every direction
    assert walk.trail[0] == (pose.x, pose.y)
    assert walk.trail[-1] == pytest.approx((walk.pose.x, walk.pose.y))
    assert "yaw" in walk.text


def test_pictures_are_the_agents_own(scene, walk):
    walk.place(*choose_viewpoints(scene, 1)[0])
    rgb = walk.picture("RGB")
    assert rgb.shape == (360, 480, 3)
    assert len(np.unique(walk.picture("depth").reshape(-1, 3), axis=0)) > 20
    assert not np.array_equal(walk.picture("BEV"), walk.picture("occupancy"))
    walk.act(Action.LEFT)
    assert not np.array_equal(rgb, walk.picture("RGB"))


def test_an_agent_is_not_put_where_it_has_no_room(scene, walk):
    pose = choose_viewpoints(scene, 1)[0]
    walk.place(*pose)
    navigation = NavigationMap(scene.grid, 0.20)
    row, col = np.argwhere(navigation.blocked)[0]
    x, y = scene.grid.centres_of(np.array([[row, col]]))[0]
    assert not walk.place(float(x), float(y), 0.0)
    assert walk.last.bumped and "no room" in walk.text
    assert walk.pose == Pose2D(*pose)  # it still stands where it stood


def test_the_panel_tells_the_heading_in_degrees(scene, walk):
    pose = choose_viewpoints(scene, 1)[0]
    assert walk.place(pose.x, pose.y, math.pi / 2)
    assert "yaw 90°" in walk.text


def test_depth_colours_go_from_pale_to_dark():
    ramp = colour_depth(np.linspace(0, 12, 50, dtype=np.float32)[None], 10.0)[0].astype(int)
    light = ramp.sum(axis=1)
    assert (np.diff(light) <= 12).all() and light[0] > 600 > 200 > light[-1]
    far = colour_depth(np.array([[np.inf, np.nan, 10.0]], np.float32), 10.0)
    assert (far == far[0, 0]).all()


def test_the_plan_shows_the_agent_where_it_is(scene):
    plan = plan_map(scene, 400)
    x0, y0, x1, y1 = scene.grid.bounds
    pose = Pose2D((x0 + x1) / 2 + 1.0, (y0 + y1) / 2, 0.3)
    colour = (250, 0, 250)
    marked = plan.draw([MapAgent(pose, colour, [(pose.x - 1, pose.y), (pose.x, pose.y)])])
    ((u, v),) = plan.pixels([(pose.x, pose.y)])
    ((u1, v1),) = plan.pixels([(pose.x + 1, pose.y + 1)])
    assert u1 > u and v1 < v  # east is right, north is up
    where = np.argwhere((np.abs(marked.astype(int) - colour) < 30).all(axis=2))
    assert np.hypot(*(where - (v, u)).T).min() < 3
    assert np.hypot(*(where - (v, u)).T).max() < plan.scale * 1.0 + 12


def test_the_overview_shows_all_of_the_scene(scene):
    for aspect in (0.5, 1.0, 1.8):
        position, target = overview(scene, aspect)
        forward = (target - position) / np.linalg.norm(target - position)
        right = np.cross(forward, (0, 0, 1))
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        free = scene.grid.centres_of(np.argwhere(scene.grid.cells == 0)[::50])
        away = np.column_stack([free, np.zeros(len(free))]) - position
        depth = away @ forward
        half = math.tan(OVERVIEW_FOV / 2)
        assert (np.abs(away @ up) <= half * depth).all()
        assert (np.abs(away @ right) <= half * aspect * depth).all()


@given(st.text(max_size=300))
def test_plain_text_has_no_markup_left(text):
    out = plain(text)
    assert not set(out) & set('<>[]`*_|\\"$~{}^=\n\r')
    assert "&" not in out.replace("&#", "")


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_names_stay_words(text):
    assert "<" not in plain(text) and "\n" not in name_line(text)
    assert len(name_line("x" * 999)) == 80


def test_the_loop_does_work_in_order_and_forgets_what_is_stale():
    loop, done = LiveLoop(), []
    for number in range(3):
        loop.post(lambda n=number: done.append(n))
        loop.post(lambda n=number: done.append(10 * n), key="slider")
    loop.post(loop.stop)
    loop.run()
    assert done == [0, 1, 2, 20]


def test_the_loop_hears_other_threads_and_ticks():
    loop, ticks = LiveLoop(), []

    def tick(now: float) -> float:
        ticks.append(now)
        if len(ticks) == 3:
            threading.Thread(target=loop.stop).start()
        return 0.001

    loop.run(tick)
    assert len(ticks) >= 3


class Headers(dict):
    def get_all(self, name):
        return [self[name]] if name in self else []


def test_the_gate_lets_in_who_knows_the_secret():
    gate = Gate.fresh()
    assert gate.secret != Gate.fresh().secret
    assert gate.judge("/", Headers())[0] == 403
    assert gate.judge("/?secret=wrong", Headers())[0] == 403
    status, _, more = gate.judge(f"/?secret={gate.secret}", Headers())
    assert status == 303 and more["Location"] == "/" and "HttpOnly" in more["Set-Cookie"]
    _, _, deep = gate.judge(f"/?secret={gate.secret}&episode=a%0d%0aX%26b", Headers())
    assert deep["Location"] == "/?episode=a%0D%0AX%26b"
    cookie = more["Set-Cookie"].partition(";")[0]
    assert gate.judge("/", Headers(Cookie=f"other=1; {cookie}")) is None
    assert gate.judge("/", Headers(Cookie=cookie[:-1]))[0] == 403
    own = Headers(Cookie=cookie, Origin="http://127.0.0.1:8080", Host="127.0.0.1:8080")
    assert gate.judge("/", own) is None
    other = Headers(Cookie=cookie, Origin="http://127.0.0.1:3000", Host="127.0.0.1:8080")
    assert gate.judge("/", other)[0] == 403
    assert gate.judge("/", Headers(Cookie=f"{gate.cookie}=ünsinn"))[0] == 403


def test_addresses_that_others_can_reach_need_a_word():
    assert is_loopback("127.0.0.1") and is_loopback("::1") and is_loopback("localhost")
    assert not is_loopback("0.0.0.0") and not is_loopback("example.org")
    with (
        pytest.raises(ConfigError, match="reached from other machines") as caught,
        open_server("0.0.0.0", 0),
    ):
        pass
    assert "--allow-remote" in caught.value.remedy
    with pytest.raises(ConfigError, match="cannot listen"):
        find_port("no-such-host.invalid", 8080)


def test_a_taken_port_gives_way_and_every_path_is_guarded():
    pytest.importorskip("viser")
    with open_server(port=0) as first, open_server(port=first.port) as second:
        assert second.port > first.port == second.asked_port
        assert b"gn0Frames" in fetch_page(second)  # our script comes along
        for path in ("/", "/index.html", "/?secret=", "/..%2f..%2fetc/passwd"):
            connection = HTTPConnection("127.0.0.1", second.port, timeout=10)
            connection.request("GET", path)
            assert connection.getresponse().status == 403
            connection.close()
        connection = HTTPConnection("127.0.0.1", second.port, timeout=10)
        upgrade = {
            "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Protocol": "viser-v1.1.1",
        }  # fmt: skip
        connection.request("GET", "/", headers=upgrade)
        assert connection.getresponse().status == 403
        connection.close()
        assert second.viser.request_share_url() is None  # no tunnel for anybody


def test_without_viser_the_error_says_what_to_type(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    with pytest.raises(ConfigError) as caught, open_server(port=0):
        pass
    assert "pip install -e '.[view]'" in caught.value.remedy


def test_scenes_without_anything_get_a_plan(scene):
    bare = replace(scene, objects=(), rooms=(), walls=())
    assert plan_map(bare, 300).draw([]).shape[2] == 3


def test_up_of_a_bare_file_is_proposed(capsys: pytest.CaptureFixture[str]) -> None:
    """A flat that lies on its side is stood up; a file without surfaces keeps +z."""
    from gn0.cli.view import find_up
    from gn0.gaussians.transform import transform_cloud
    from gn0.scenes.example import build_example_scene

    cloud = build_example_scene().gaussians
    to_minus_y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert find_up(cloud) == "+z"
    assert find_up(transform_cloud(cloud, rotation=to_minus_y)) == "-y"
    assert "--up says otherwise" in capsys.readouterr().out
    assert find_up(cloud.select(np.arange(5))) == "+z"


def test_a_canvas_of_any_shape_holds_the_agents_whole_picture():
    preset = find_preset("gn_bench")
    pose = Pose2D(2.0, 1.5, 0.4)
    scene = build_example_scene(spacing=0.1)
    renderer = build_renderer(scene.gaussians, "cpu")
    for size in ((300, 120), (120, 300), (160, 120)):
        camera, (left, top, right, bottom) = canvas_camera(preset.rgb, size)
        assert (camera.width, camera.height) == size
        assert left >= 0 and top >= 0 and right <= size[0] and bottom <= size[1]
        assert right - left == size[0] or bottom - top == size[1]
        corner = ((left - camera.cx) / camera.fx, (top - camera.cy) / camera.fy)
        own = (-preset.rgb.cx / preset.rgb.fx, -preset.rgb.cy / preset.rgb.fy)
        assert corner == pytest.approx(own, abs=2 / min(size))  # rounded to a pixel
        drawn = draw_canvas(renderer, preset, pose, 1.3, size, beyond=0.0)
        assert drawn.shape == (size[1], size[0], 3)
        outside = np.ones(drawn.shape[:2], bool)
        outside[top:bottom, left:right] = False
        assert not drawn[outside].any() and drawn[~outside].mean() > 20
