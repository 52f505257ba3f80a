"""People in pictures of agents on a device: what VectorEnv draws by the same renderer."""

from __future__ import annotations

import math
import shutil

import msgspec
import numpy as np
import pytest

from gn0.avatars import AvatarBank, generate_bank
from gn0.avatars.detail import SHARES, choose_level
from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, DeviceMemoryError, EpisodeError
from gn0.missions.episode import AgentSpec, Episode, MissionGoal
from gn0.people.cast import Cast
from gn0.people.person import EpisodePerson, PersonStop
from gn0.people.shown import Shown, pose_shown, show_person
from gn0.render import Camera
from gn0.render.cuda import who as render_who
from gn0.render.cuda.batch import RendererBatch
from gn0.scenes import build_example_scene
from gn0.sim import presets
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.presets import find_preset
from gn0.sim.vector import VectorEnv

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
FLAT = build_example_scene()
BODY = AgentSpec(radius=0.25, step_seconds=0.2)
EYE = Camera.from_vfov(48, 36, 70.0)


@pytest.fixture(scope="module")
def bank(tmp_path_factory) -> AvatarBank:
    folder = tmp_path_factory.mktemp("bank")
    generate_bank(folder, count=1, seed=1, density=0.05)
    return AvatarBank(folder)


@pytest.fixture(scope="module")
def episodes(bank) -> list[Episode]:
    """Who walks to and fro, stands, waves, sits and holds a box, before agents; and nobody."""
    (name, *_) = sorted(bank.names)
    goal = MissionGoal(goal=(6.0, 2.5), object_id="", category="bed", instruction="Go.")

    def somebody(number, *path, **more) -> EpisodePerson:
        return EpisodePerson(number=number, identity=name, path=path, seed=number, **more)

    walker = somebody(7, (3.2, 2.2), (3.2, 2.9), after="back", speed=0.8)
    idle = somebody(2, (4.2, 2.4), behaviour="stand", yaw=1.0)
    waver = somebody(3, (3.4, 3.7), behaviour="stand", clip="wave", yaw=-2.0)
    sitter = somebody(4, (4.4, 3.0), behaviour="sit", yaw=3.0, seat=0.5)
    holder = somebody(3, (3.4, 3.7), behaviour="stand", clip="hold", yaw=-2.5)
    groups = (("all", (walker, idle, waver, sitter)), ("one", (walker, holder)), ("none", ()))
    return [
        Episode(
            id=title, scene_id=FLAT.id, mission=goal, start=(2.0, 2.5, 0.1 * k),
            path=((2.0, 2.5), goal.goal), people=people,
        )
        for k, (title, people) in enumerate(groups)
    ]  # fmt: skip


@pytest.fixture
def preset(monkeypatch) -> str:
    small = msgspec.structs.replace(find_preset("gn_bench"), agent=BODY, rgb=EYE, depth=EYE)
    monkeypatch.setitem(presets._BY_NAME, "small", small)
    return "small"


def open_device_env(episodes, bank, preset, count=3, sensors=("rgb", "depth"), **more):
    device = DeviceHost(1)
    return VectorEnvDevice(
        count, FLAT, episodes=episodes, device=device, renderer=RendererBatch(device),
        sensors=sensors, preset=preset, agent=BODY, bank=bank, **more,
    )  # fmt: skip


def in_view(cloud, pose, stands) -> bool:
    """Whether the camera of an agent that stands at (x, y, yaw) may see any of a posed person."""
    preset = find_preset("small")
    x, y, yaw = stands
    pitch, eye = math.radians(preset.pitch_degrees), BODY.camera_height
    at = cloud.means @ pose[:3, :3].T + pose[:3, 3] - (x, y, eye)
    ahead = at @ (np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch))
    side = abs(at @ (-np.sin(yaw), np.cos(yaw), 0.0))
    up = abs(at @ (-np.cos(yaw) * np.sin(pitch), -np.sin(yaw) * np.sin(pitch), np.cos(pitch)))
    wide, high = (EYE.width / 2 + 4.0) / EYE.fx, (EYE.height / 2 + 4.0) / EYE.fy
    far = 3.0 * cloud.scales.max(axis=1)
    inside = (side <= wide * np.maximum(ahead, 0.0) + far) & (
        up <= high * np.maximum(ahead, 0.0) + far
    )
    return bool((inside & (ahead > -far)).any())


def check_shown(env, cast, episodes, infos) -> list[Shown]:
    """Codes and poses are those of the host; how each is shown who is seen."""
    eyes, count, there = env._eyes.people, len(episodes), []
    sizes: dict[tuple[str, int, str], int] = {}  # of avatars at rest, which poses of one key share
    real, whole = (env.simulator.company.read_state(n) for n in ("real", "whole"))
    codes = eyes._shown[0].numpy().reshape(count, -1)
    poses = eyes._shown[1].numpy().reshape(count, -1, 4, 4)
    for i, episode in enumerate(episodes):
        x, y, yaw = infos["pose"].numpy()[i]
        assert not codes[i, len(episode.people) :].any()
        for p, person in enumerate(episode.people):
            away = real[i, p, :2] - (x, y)
            actor = cast.find(person.identity)
            want, pose = show_person(person, actor, real[i, p], whole[i, p], (x, y))
            if not codes[i, p]:
                assert not in_view(pose_shown(actor, want, 0), pose, (x, y, yaw))
                continue
            found = eyes.codes.read(int(codes[i, p]))
            assert found.shown == want
            assert found.level == choose_level(float(np.hypot(*away)), EYE.fx)
            size = len(found.avatar)
            assert sizes.setdefault(found.rest_key, size) == size
            assert (size > len(actor.levels[found.level])) == (want.clip == "hold")
            np.testing.assert_array_equal(poses[i, p], pose)
            there.append(want)
    return there


def show_alone(env, monkeypatch) -> None:
    """From now on it is found how people look, but nobody is posed or drawn."""
    drawn, people = env._eyes.draw(env.simulator), env._eyes.people
    monkeypatch.setattr(people.posed, "ask", lambda *_: None)
    monkeypatch.setattr(people.posed, "answer", lambda *_: 0)
    monkeypatch.setattr(env._eyes, "draw", lambda simulator: people.show(simulator) and drawn)


def test_codes_say_what_the_host_shows(episodes, bank, preset, monkeypatch) -> None:
    """Clip, frame, blend, look and level of each, and where it stands, over 24 steps."""
    env, cast = open_device_env(episodes, bank, preset), Cast(bank)
    names = [e.id for e in episodes]
    env.reset(seed=0, options={"episode": names})
    show_alone(env, monkeypatch)
    clips = set()
    for row in np.random.default_rng(0).choice([1, 2, 3], (24, 3)):
        infos = env.step(row)[4]
        clips |= {shown.clip for shown in check_shown(env, cast, episodes, infos)}
    assert {"walk", "wave", "sit", "hold"} < clips


def test_nobody_behind_an_agent_is_posed(bank, preset, monkeypatch) -> None:
    """Of who stands 1 to 2 m away, all round: left out only where no picture may show him."""
    (name, *_) = sorted(bank.names)
    goal = MissionGoal(goal=(6.0, 2.5), object_id="", category="bed", instruction="Go.")
    episodes = []
    for k in range(24):
        at = (1.45 + (1.0, 1.6, 2.0)[k % 3], 1.65)
        person = EpisodePerson(number=1, identity=name, path=(at,), behaviour="stand", seed=k)
        episodes.append(
            Episode(
                id=f"round-{k}", scene_id=FLAT.id, mission=goal,
                start=(1.45, 1.65, math.tau * k / 24), path=((1.45, 1.65), goal.goal),
                people=(person,),
            )
        )  # fmt: skip
    level = msgspec.structs.replace(find_preset(preset), pitch_degrees=0.0)
    monkeypatch.setitem(presets._BY_NAME, preset, level)
    env, cast = open_device_env(episodes, bank, preset, count=24), Cast(bank)
    _, infos = env.reset(seed=0, options={"episode": [e.id for e in episodes]})
    there = check_shown(env, cast, episodes, infos)
    assert 8 <= len(there) <= 20, "those before it, and few of the others"


def test_each_level_of_detail_is_that_of_the_host(bank, preset, monkeypatch) -> None:
    """Of who stands before an agent, from near to far, by cameras of long focal lengths."""
    (name, *_) = sorted(bank.names)
    goal = MissionGoal(goal=(6.0, 2.5), object_id="", category="bed", instruction="Go.")
    aways = (0.65, 1.0, 1.3, 1.5, 1.7, 1.9, 2.1, 2.4)
    episodes = [
        Episode(
            id=f"away-{k}", scene_id=FLAT.id, mission=goal, start=(1.0, 2.5, 0.0),
            path=((1.0, 2.5), goal.goal), people=(
                EpisodePerson(
                    number=1, identity=name, path=((1.0 + away, 2.5),), behaviour="stand", seed=k
                ),
            ),
        )
        for k, away in enumerate(aways)
    ]  # fmt: skip
    seen = set()
    for degrees in (16.0, 46.0):
        long = Camera.from_hfov(32, 32, degrees)
        eyes = msgspec.structs.replace(find_preset(preset), rgb=long, depth=long)
        monkeypatch.setitem(presets._BY_NAME, preset, eyes)
        env = open_device_env(episodes, bank, preset, count=len(aways), sensors=("rgb",))
        env.reset(seed=0, options={"episode": [e.id for e in episodes]})
        codes, read = env._eyes.people._shown[0].numpy(), env._eyes.people.codes.read
        levels = [read(int(code)).level for code in codes if code]
        assert levels == [choose_level(away, long.fx) for away in aways]
        seen |= set(levels)
    assert seen == set(range(len(SHARES)))


def test_who_turns_on_the_spot_steps_as_on_the_host(bank, preset, monkeypatch) -> None:
    """To both sides, from walks into turns, late feet, and walks that begin from them."""
    (name, *_) = sorted(bank.names)
    goal = MissionGoal(goal=(6.0, 2.5), object_id="", category="bed", instruction="Go.")
    looks = ((1.0, 75.0, 3.0), (1.4, -70.0, 2.0), (1.4, 0.0, 1.1), (1.7, 50.0, 0.5))
    episodes = [
        Episode(
            id=f"turns-{k}", scene_id=FLAT.id, mission=goal, start=(3.0, 1.5, 1.57),
            path=((3.0, 1.5), goal.goal),
            people=(
                EpisodePerson(
                    number=1, identity=name, path=((1.3, 2.5), (3.4, 2.5)), seed=k, after="back",
                    speed=0.6 + 0.2 * k, stops=tuple(
                        PersonStop(at=at, seconds=seconds, look=(look, -look)[k])
                        for at, look, seconds in looks
                    ),
                ),
            ),
        )
        for k in range(2)
    ]  # fmt: skip
    env, cast = open_device_env(episodes, bank, preset, count=2, sensors=("rgb",)), Cast(bank)
    env.reset(options={"episode": [e.id for e in episodes]})
    show_alone(env, monkeypatch)
    alone, blends = set(), set()
    for k in range(120):
        infos = env.step(np.full(2, 2 + k % 2))[4]
        for shown in check_shown(env, cast, episodes, infos):
            if shown.other:
                blends.add((shown.other[:6], shown.clip[:6]))
            else:
                alone.add(shown.clip)
    assert {"pivot_left", "pivot_right", "settle_left", "settle_right", "walk"} < alone
    assert {("pivot_", "walk"), ("settle", "walk"), ("walk", "pivot_")} <= blends


def test_who_is_beside_a_picture_is_not_posed(episodes, bank, preset) -> None:
    """And the pictures are the same bytes as if all before the eye were."""
    wide = open_device_env(episodes, bank, preset)
    wide._eyes.people.sight = None
    env = open_device_env(episodes, bank, preset)
    posed = []
    for one in (env, wide):
        one.reset(seed=0, options={"episode": [e.id for e in episodes]})
        drawn, seen = [], 0
        for k in range(16):
            obs = one.step(np.array([2, 3, 1 + k % 3]))[0]
            drawn.append(obs["rgb"].numpy().tobytes())
            seen += int((one._eyes.people._shown[0].numpy() > 0).sum())
        posed.append((seen, drawn))
    assert posed[0][0] < 0.6 * posed[1][0] and posed[0][1] == posed[1][1]


def test_light_is_that_of_the_scene_s_probes(episodes, bank, preset) -> None:
    env = open_device_env(episodes, bank, preset)
    env.reset(seed=0, options={"episode": [e.id for e in episodes]})
    from gn0.avatars.light import find_probes

    probes = find_probes(FLAT.gaussians, FLAT.grid)
    gains = env._eyes.people._shown[2].numpy().reshape(3, -1, 4, 3)
    for p, person in enumerate(episodes[0].people):
        want = probes.gain_at(*person.spot)
        np.testing.assert_allclose(gains[0, p], want, rtol=1e-5, atol=1e-6)


def test_pictures_show_people_as_the_vector_env_s(episodes, bank, preset, monkeypatch) -> None:
    """Colour within a level of 255, depth alike and who is who, from host instances."""
    monkeypatch.setenv("GN0_DEVICE", "host")
    monkeypatch.setattr(render_who, "ALONE_BYTES", 3 * 4 * EYE.width * EYE.height)  # a few at once
    sensors = ("rgb", "depth", "history", "who", "people_seen")
    env = open_device_env(episodes, bank, preset, sensors=sensors)
    twin = VectorEnv(
        3, FLAT, episodes=episodes, sensors=sensors, preset=preset, agent=BODY, bank=bank,
        backend="cuda",
    )  # fmt: skip
    names = [e.id for e in episodes]
    mine = env.reset(seed=0, options={"episode": names})[0]
    theirs = twin.reset(seed=0, options={"episode": names})[0]
    bare = mine["rgb"].numpy()[2]
    assert (mine["rgb"].numpy()[0] != bare).any()
    met = set()
    for row in ([2, 2, 2], [1, 3, 1], [1, 1, 2]):
        for name in ("rgb", "history"):
            apart = np.abs(mine[name].numpy().astype(int) - theirs[name].astype(int))
            assert apart.max() <= 1, name
        np.testing.assert_allclose(mine["depth"].numpy(), theirs["depth"], atol=1e-3)
        for name in ("who", "people_seen"):
            np.testing.assert_array_equal(mine[name].numpy(), theirs[name], err_msg=name)
        met |= set(np.unique(mine["who"].numpy()).tolist())
        mine, theirs = env.step(np.array(row))[0], twin.step(np.array(row))[0]
    assert met == {0, 2, 3, 4, 7}


def test_who_is_posed_ahead_is_seen_the_same(episodes, bank, preset) -> None:
    """Of what a step shows anew most was posed while the one before was drawn."""
    one, two = (open_device_env(episodes, bank, preset) for _ in range(2))
    assert not one._eyes.people.ahead  # on the emulation
    two._eyes.people.ahead = True
    posed = [env._eyes.people.posed for env in (one, two)]
    names = [e.id for e in episodes]
    seen = [env.reset(seed=0, options={"episode": names})[0] for env in (one, two)]
    begun = [bank.misses for bank in posed]
    for row in ([2, 2, 2], [1, 1, 1], [3, 1, 0], [1, 2, 1], [1, 1, 3], [1, 1, 1]):
        for name in ("rgb", "depth"):
            np.testing.assert_array_equal(*(obs[name].numpy() for obs in seen))
        states = (env.simulator.company.read_state("real") for env in (one, two))
        np.testing.assert_array_equal(*states)
        seen = [env.step(np.array(row))[0] for env in (one, two)]
    lacked = [bank.misses - before for bank, before in zip(posed, begun, strict=True)]
    assert posed[0].ahead == 0 < posed[1].ahead and 2 * lacked[1] < lacked[0]


def test_people_go_where_they_were_foreseen(episodes, bank, preset) -> None:
    """Among agents who turn; that somebody looks ahead changes nothing."""
    env = open_device_env(episodes, bank, preset, sensors=("goal_vector",))
    env.reset(seed=0, options={"episode": [e.id for e in episodes]})
    company = env.simulator.company
    for _ in range(6):
        before = [company.read_state(name) for name in ("real", "whole")]
        company.look_ahead()
        for old, name in zip(before, ("real", "whole"), strict=True):
            np.testing.assert_array_equal(company.read_state(name), old)
        foreseen = [company._later[1][name].numpy() for name in ("real", "whole")]
        env.step(np.full(3, 2))
        for ahead, name in zip(foreseen, ("real", "whole"), strict=True):
            np.testing.assert_array_equal(ahead.transpose(2, 1, 0), company.read_state(name))
    assert (before[0] != company.read_state("real")).any(), "somebody walks"


def test_a_step_is_made_though_nobody_can_be_posed_ahead(
    episodes, bank, preset, monkeypatch
) -> None:
    env, twin = (open_device_env(episodes, bank, preset) for _ in range(2))
    people = env._eyes.people
    people.ahead = True
    env.reset(seed=0), twin.reset(seed=0)
    room, asked, before = people.posed.renderer.pose_parts, [], people.posed.ahead

    def lack(*given):
        asked.append(given)
        if people.posed._expected is None:  # of those who are expected; else of who is seen
            raise DeviceMemoryError("no memory is left")
        return room(*given)

    monkeypatch.setattr(people.posed.renderer, "pose_parts", lack)
    for row in ([1, 1, 1], [2, 1, 3], [1, 1, 1]):
        mine, theirs = env.step(np.array(row))[0], twin.step(np.array(row))[0]
        np.testing.assert_array_equal(mine["rgb"].numpy(), theirs["rgb"].numpy())
    assert asked and people.posed.ahead == before


def test_what_is_not_drawn_beside_people_is_refused(episodes, bank, preset) -> None:
    with pytest.raises(ConfigError, match="last pictures"):
        open_device_env(episodes, bank, preset, final_pictures=True)
    with pytest.raises(EpisodeError, match="bank of people"):
        open_device_env(episodes, None, preset)
    with pytest.raises(ConfigError, match="'bev_live' is painted on the CPU alone") as told:
        VectorEnvDevice(1, FLAT, episodes=episodes, device="host", sensors=("bev_live",))
    for works in ("VectorEnv", "'bev'", "'who'", "'people_seen'"):
        assert works in told.value.remedy
    with pytest.raises(ConfigError, match="maps that agents make for themselves"):
        VectorEnvDevice(
            1, FLAT, episodes=episodes, device="host", sensors=("bev",), map_mode="explored"
        )
    alone = open_device_env(episodes[2:], bank, preset, count=1)
    with pytest.raises(EpisodeError, match=r"'one'.*no episode had any"):
        alone.reset(options={"episode": episodes[1]})


@pytest.mark.filterwarnings("ignore:the people of one call need")  # of one byte
def test_people_in_poses_take_the_memory_that_they_are_given(episodes, bank, preset) -> None:
    """What makes room is posed again, and pictures stay the same."""
    seen = {}
    for memory in (None, 1):
        env = open_device_env(episodes, bank, preset, people_memory=memory)
        seen[memory] = [env.reset(seed=0, options={"episode": [0, 1, 2]})[0]["rgb"].numpy().copy()]
        for _ in range(3):
            moved = env.step(env.device.upload(np.array([2, 2, 2], np.int64)))[0]
            seen[memory].append(moved["rgb"].numpy().copy())
        posed = env._eyes.people.posed
        assert posed.budget == (512 * 2**20 if memory is None else memory)
        assert (posed.evicted > 0) == (memory == 1)
    assert all(np.array_equal(*pair) for pair in zip(*seen.values(), strict=True))
    with pytest.raises(ConfigError, match="0 bytes for posed people"):
        open_device_env(episodes, bank, preset, people_memory=0)
