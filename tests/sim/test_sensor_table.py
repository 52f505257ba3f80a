"""A sensor is one value in one file: those that there are, and one of a stranger's."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gn0 import plugins
from gn0.cli import list_names
from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, RenderError, SimError
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.env import GoalNavEnv
from gn0.sim.open import open_simulator
from gn0.sim.sensor import table
from gn0.sim.sensor.sensor import MAP_SIDE, Sensor, Space
from gn0.sim.sensors import SensorConfig
from gn0.sim.state import OBSERVED, Observation
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_labelled_scene, build_point_episodes
from gn0.testing.sensor_check import check_sensor

ROOT = Path(__file__).resolve().parents[2]
needs_host = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

COMPASS = Sensor(
    name="compass",
    doc="float32 [2]: where the scene's x axis points, forward and left",
    space=lambda settings: Space((2,), np.float32, -1, 1),
    read=lambda here: np.array([np.cos(here.pose.yaw), -np.sin(here.pose.yaw)], np.float32),
    many=lambda agents: np.column_stack(
        [np.cos(agents.poses()[:, 2]), -np.sin(agents.poses()[:, 2])]
    ).astype(np.float32),
)


@pytest.fixture(autouse=True)
def _forget(monkeypatch):
    """What a test registers is gone after it."""
    monkeypatch.setattr(plugins, "_registered", dict(plugins._registered))
    yield
    table._carry.cache_clear()


@pytest.fixture
def plan(room_scene):
    return room_scene


def enter(sensor: Sensor) -> str:
    plugins.register("sensor", sensor.name, sensor)
    return sensor.name


def test_the_docs_have_each_sensor_in_order_as_it_says_itself() -> None:
    page = (ROOT / "docs/simulator.md").read_text("utf-8")
    section = page.partition("\n## Sensors\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \| (.+) \| (yes|–) \|$", section, re.M)
    names = plugins.builtin_names("sensor")
    found = [table.find_sensor(name) for name in names]
    assert rows == [(s.name, s.doc, "yes" if s.device else "–") for s in found]


def test_every_sensor_is_one_file_and_every_field_of_an_observation_has_one() -> None:
    names = plugins.builtin_names("sensor")
    files = {path.stem for path in (ROOT / "src/gn0/sim/sensor").glob("*.py")}
    assert files - {"__init__", "sensor", "table"} == set(names)
    assert set(names) >= OBSERVED
    for name in names:
        sensor = table.find_sensor(name)
        assert sensor.find_space(SensorConfig()).fault() == ""


def test_the_list_of_sensors_tells_of_a_strangers(capsys) -> None:
    enter(COMPASS)
    enter(replace(COMPASS, name="contour", space=lambda _: Space((MAP_SIDE, MAP_SIDE), "u1", 0, 9)))
    assert list_names.run(list_names.Args(kind="sensors")) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("depth") and "float32 [360, 480]" in line for line in lines)
    (compass,) = (line for line in lines if line.startswith("compass"))
    assert "float32 [2]" in compass and compass.endswith(COMPASS.doc)
    assert any("uint8 [H, W]" in line for line in lines)


def test_a_strangers_sensor_goes_everywhere_by_its_name(plan) -> None:
    check_sensor(COMPASS)
    episodes = build_point_episodes(plan, open_simulator(plan).navigation, 2, seed=1)
    envs = VectorEnv(2, plan, episodes=episodes, sensors=("compass", "ranges"))
    one = GoalNavEnv(plan, episodes=episodes, sensors=("compass", "ranges"))
    many, alone = envs.reset(seed=4)[0], one.reset(seed=4)[0]
    for action in (2, 1, 2):
        np.testing.assert_array_equal(many["compass"][0], alone["compass"])
        assert alone in one.observation_space and many in envs.observation_space
        many, alone = envs.step([action, 3])[0], one.step(action)[0]


def test_an_installed_package_brings_its_sensor(tmp_path) -> None:
    folder = tmp_path / "compass-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: compass\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[gn0.plugins]\ncompass = their_compass\n")
    (tmp_path / "their_compass.py").write_text(
        "import numpy as np\nfrom gn0 import register\nfrom gn0.sim import Sensor, Space\n"
        "register('sensor', 'compass', Sensor(name='compass', doc='float32 [1] rad: heading',"
        "space=lambda _: Space((1,), np.float32, -4, 4),"
        "read=lambda here: np.float32([here.pose.yaw])))\n"
    )
    code = (
        "from gn0.sim import GoalNavEnv\n"
        "print(GoalNavEnv(sensors=('compass',)).reset(seed=1)[0]['compass'].shape)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60,
        env=os.environ | {"PYTHONPATH": f"{ROOT / 'src'}:{tmp_path}"},
    )  # fmt: skip
    assert done.stdout.strip() == "(1,)", done.stderr


def test_chance_of_a_sensor_belongs_to_its_episode_and_step(make_simulator, make_episode) -> None:
    enter(replace(
        COMPASS, name="noisy", many=None, space=lambda _: Space((1,), np.float64, 0, 1),
        read=lambda here: here.random("noisy").random(1),
    ))  # fmt: skip

    def walk(**changes) -> list[float]:
        simulator = make_simulator("noisy")
        seen = [simulator.reset(make_episode(**changes))]
        seen += [simulator.step(2).observation for _ in range(3)]
        return [float(o.more["noisy"][0]) for o in seen]

    assert walk() == walk() and len(set(walk())) == 4
    assert walk(id="another") != walk()


def test_two_sensors_of_one_name_are_refused() -> None:
    enter(COMPASS)
    enter(COMPASS)  # the same one again: a module that is imported twice
    with pytest.raises(ConfigError, match="'compass' is already registered"):
        enter(replace(COMPASS, doc="another"))
    with pytest.raises(ConfigError, match="'depth' is already registered"):
        enter(replace(COMPASS, name="depth"))


@pytest.mark.parametrize("name", ["instruction", "instruction_tokens", "collided", "more", "a-b",
                                  "_own", "seed", "version"])  # fmt: skip
def test_a_name_that_stands_for_something_else_is_refused(name) -> None:
    enter(replace(COMPASS, name=name))
    with pytest.raises(ConfigError, match="cannot go by the name"):
        table.find_sensor(name)


def test_what_is_no_sensor_is_refused_by_name() -> None:
    plugins.register("sensor", "odd", lambda here: 3)
    with pytest.raises(ConfigError, match=r"sensor 'odd' is a function.*register a gn0.sim.Sensor"):
        table.carry_sensors({"odd"})


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"space": lambda _: Space((3,), np.float32, -1, 1)}, r"gives shape \[2\], not \[3\]"),
        ({"space": lambda _: Space((2,), np.float64, -1, 1)}, "gives float32, not float64"),
        (
            {"space": lambda _: Space((2,), np.float32, -0.5, 0.5)},
            "gives values .* beyond -0.5 to 0.5",
        ),
        ({"read": lambda here: [1.0, 0.0]}, "gives a list, not an array"),
        ({"read": lambda here: np.float32([np.nan, 0])}, "gives values from nan"),
        ({"read": lambda here: 1 / 0}, "cannot be read: ZeroDivisionError"),
        ({"read": lambda here: here.seen("depth").min()}, "cannot be read: KeyError: 'depth'"),
    ],
)
def test_a_sensor_that_lies_or_breaks_is_named(
    changes, says, make_simulator, make_episode, plan
) -> None:
    enter(replace(COMPASS, many=None, **changes))
    with pytest.raises(SimError, match=f"sensor 'compass' {says}"):
        make_simulator("compass").reset(make_episode())
    with pytest.raises(SimError, match="sensor 'compass'"):
        VectorEnv(1, plan, sensors=("compass",)).reset(seed=0)


@pytest.mark.parametrize(
    "many", [lambda agents: np.zeros(2, np.float32), lambda agents: agents.colour()]
)
def test_a_sensor_that_lies_of_many_is_named(many, plan) -> None:
    enter(replace(COMPASS, many=many))
    with pytest.raises(SimError, match=r"sensor 'compass' (gives shape|cannot be read)"):
        VectorEnv(2, plan, sensors=("compass",)).reset(seed=0)


@pytest.mark.parametrize(
    ("space", "says"),
    [
        (lambda _: Space((0,), np.float32, 0, 1), r"shape \(0,\)"),
        (lambda _: Space((1,), object, 0, 1), "type object"),
        (lambda _: Space((1,), np.float32, 2, 1), "between 2 and 1"),
        (lambda _: (1,), "cannot be had: AttributeError"),
        (lambda settings: settings.colours, "cannot be had: AttributeError"),
    ],
)
def test_a_space_that_is_none_is_refused_before_anything_runs(space, says, plan) -> None:
    enter(replace(COMPASS, space=space))
    with pytest.raises(ConfigError, match=f"the space of sensor 'compass' .*{says}"):
        GoalNavEnv(plan, sensors=("compass",))


@needs_host
def test_a_device_refuses_a_sensor_that_does_not_say_how_it_is_read_there(plan) -> None:
    enter(COMPASS)
    with pytest.raises(ConfigError, match="'compass' does not say how a device reads it"):
        VectorEnvDevice(1, plan, device=DeviceHost(), sensors=("compass",))


@needs_host
def test_a_device_reads_a_strangers_sensor_and_holds_it_to_its_space(plan) -> None:
    odometer = replace(
        COMPASS, name="odometer", space=lambda _: Space((3,), np.float64, -np.inf, np.inf),
        read=lambda here: np.array(here.pose), many=lambda agents: agents.poses(),
        device=lambda agents: agents.output("pose"),
    )  # fmt: skip
    enter(odometer)
    enter(replace(odometer, name="liar", device=lambda agents: agents.output("distance")))
    enter(replace(odometer, name="broken", device=lambda agents: agents.output("colour")))
    env = VectorEnvDevice(2, plan, device=DeviceHost(), sensors=("odometer", "pose"))
    seen, _ = env.reset(seed=0)
    np.testing.assert_array_equal(seen["odometer"].numpy(), seen["pose"].numpy())
    for name, says in (("liar", r"gives shape \[\], not \[3\]"), ("broken", "cannot be read")):
        env = VectorEnvDevice(2, plan, device=DeviceHost(), sensors=(name,))
        with pytest.raises(SimError, match=f"sensor '{name}' {says}"):
            env.reset(seed=0)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"read": lambda here: np.float32([np.random.random(), 0])}, "something else|numpy.random"),
        ({"doc": ""}, "one line"),
        ({"many": lambda agents: np.zeros((len(agents.poses()), 2), np.float32)}, "than one alone"),
        ({"read": lambda here: here.seen("depth")[0, :2], "many": None}, "cannot be read"),
    ],
)
def test_the_check_finds_a_sensor_that_breaks_its_word(changes, says) -> None:
    with pytest.raises(AssertionError, match=says):
        check_sensor(replace(COMPASS, **changes))


def test_it_goes_over_the_wire_as_it_is() -> None:
    from gn0.policies.remote.extension import ObservationSender, read_observation
    from gn0.policies.remote.wire import decode_message, encode_message

    enter(COMPASS)
    seen = Observation(3, 1.5, "go", more={"compass": np.float32([0.6, -0.8])})
    sent = decode_message(encode_message(ObservationSender().pack(seen)))
    got = read_observation("go", None, sent, None)
    assert got.read("compass").tobytes() == seen.read("compass").tobytes()


@pytest.mark.parametrize("name", ["semantic", "instance"])
def test_labels_are_seen_by_one_by_many_and_over_the_wire(name) -> None:
    check_sensor(table.find_sensor(name))


def test_a_pixel_names_the_object_and_its_category() -> None:
    scene = build_labelled_scene()
    sensors = {"semantic", "instance", "depth", "rgb"}
    simulator = open_simulator(scene, "vlnce_r2r", "cpu", sensors)
    (episode,) = build_point_episodes(scene, simulator.navigation, 1, seed=3)
    seen = simulator.reset(episode)
    plain = open_simulator(scene, "vlnce_r2r", "cpu", {"depth", "rgb"}).reset(episode)
    assert seen.rgb.tobytes() == plain.rgb.tobytes()
    assert seen.depth.tobytes() == plain.depth.tobytes()
    for _ in range(24):
        seen = simulator.step(2).observation
        number, kind = seen.read("instance"), seen.read("semantic")
        assert number.shape == kind.shape == seen.depth.shape
        assert number.dtype == kind.dtype == np.uint32 and not number.flags.writeable
        if len(np.unique(number)) > 1:
            break
    else:
        pytest.fail("nothing with a label came in sight")
    for found in np.unique(number[number > 0]).tolist():
        shown = kind[number == found]
        assert {scene.categories[k] for k in np.unique(shown)} == {
            scene.objects[found - 1].category
        }
        box = scene.objects[found - 1].box
        reach = np.hypot(*np.subtract(box.centre[:2], simulator.pose[:2]))
        near = seen.depth[number == found].min()
        assert near <= reach + max(box.size), "it is not as far away as that"


def test_a_scene_without_labels_says_so(room_scene, make_episode) -> None:
    simulator = open_simulator(room_scene, "vlnce_r2r", "cpu", {"semantic"})
    with pytest.raises(RenderError, match="label"):
        simulator.reset(make_episode())


def test_one_text_is_not_several_sensors() -> None:
    for call in (table.check_sensors, table.carry_sensors):
        with pytest.raises(ConfigError, match=r"sensors are 'rgb'.*as sensors=\('rgb',\)"):
            call("rgb")
