"""Whether a sensor keeps the protocol: run one of your own against it.

from gn0.testing import check_sensor
check_sensor(SENSOR)
"""

from __future__ import annotations

import random
from typing import Any

import numpy as np

from gn0.errors import ConfigError, SimError
from gn0.plugins import plugin_names, register
from gn0.policies.remote.extension import ObservationSender, read_observation
from gn0.policies.remote.wire import decode_message, encode_message
from gn0.sim.env import GoalNavEnv
from gn0.sim.open import open_simulator
from gn0.sim.presets import find_preset
from gn0.sim.sensor.sensor import Sensor
from gn0.sim.sensor.table import find_sensor
from gn0.sim.sensors import SensorConfig
from gn0.sim.simulator import Simulator
from gn0.sim.state import Observation
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_labelled_scene, build_point_episodes

ACTIONS = (1, 2, 1, 1, 3, 3, 1)


def check_sensor(sensor: Sensor, *, preset: str = "vlnce_r2r") -> None:
    """Check a sensor in a small flat: alone, among many agents, and over the wire.

    It is registered under its name where it is not yet.

    Args:
        sensor: the value that goes into `register("sensor", …)`.
        preset: cameras and body.

    Raises:
        AssertionError: the first rule that is broken, in plain words.
    """
    assert isinstance(sensor, Sensor), f"{type(sensor).__name__} is not a gn0.sim.Sensor"
    assert sensor.doc.strip() and "\n" not in sensor.doc, "its doc must be one line of text"
    if sensor.name not in plugin_names("sensor"):
        register("sensor", sensor.name, sensor)
    try:
        assert find_sensor(sensor.name) is sensor, f"another sensor goes by {sensor.name!r}"
        sensor.find_space(SensorConfig())
        seen = _check_alone(sensor, preset)
        _check_many(sensor, preset)
    except (ConfigError, SimError) as error:
        raise AssertionError(str(error)) from error
    _check_wire(sensor, seen)


def _open(sensor: Sensor, preset: str) -> Simulator:
    return open_simulator(build_labelled_scene(), preset, "cpu", {sensor.name})


def _walk(sensor: Sensor, simulator: Simulator) -> list[Observation]:
    """What is observed on a short walk."""
    (episode,) = build_point_episodes(simulator.scene, simulator.navigation, 1, seed=3)
    seen = [simulator.reset(episode)]
    seen += [simulator.step(action).observation for action in ACTIONS]
    again = simulator.observe_at(simulator.pose)
    assert _bytes(sensor, again) == _bytes(sensor, seen[-1]), (
        "it reads something else at the same place and moment: take chance from here.random(name)"
    )
    return seen


def _bytes(sensor: Sensor, observation: Observation) -> bytes:
    return sensor.as_array(observation.read(sensor.name)).tobytes()


def _check_alone(sensor: Sensor, preset: str) -> list[Observation]:
    states = random.getstate(), np.random.get_state()
    config = SensorConfig(active=frozenset({sensor.name}))
    seen = _walk(sensor, _open(sensor, preset))
    for observation in seen:
        value = observation.read(sensor.name)
        assert value is not None, "it gives nothing"
        if isinstance(value, np.ndarray):
            assert not value.flags.writeable or sensor.name == "occupancy" or sensor.views, (
                "what it gives can be written to"
            )
        _in_space(sensor, sensor.as_array(value), preset, config)
    other = _walk(sensor, _open(sensor, preset))
    for a, b in zip(seen, other, strict=True):
        assert _bytes(sensor, a) == _bytes(sensor, b), "the same walk again reads something else"
    assert states[0] == random.getstate(), "it draws from `random`: use here.random(name)"
    after = np.random.get_state()
    assert all(np.array_equal(x, y) for x, y in zip(states[1], after, strict=True)), (
        "it draws from `numpy.random`: use here.random(name)"
    )
    return seen


def _in_space(sensor: Sensor, array: Any, preset: str, config: SensorConfig) -> None:
    space = sensor.find_space(SensorConfig(active=config.active, preset=find_preset(preset)))
    wrong = space.refusal(array)
    assert not wrong, f"sensor {sensor.name!r} {wrong}"


def _check_many(sensor: Sensor, preset: str) -> None:
    scene = build_labelled_scene()
    settings: dict[str, Any] = {"preset": preset, "backend": "cpu", "sensors": {sensor.name}}
    one, many = GoalNavEnv(scene, **settings), VectorEnv(2, scene, **settings)
    a, b = one.reset(seed=7)[0], many.reset(seed=7)[0]
    for action in (None, *ACTIONS):
        if action is not None:
            a, b = one.step(action)[0], many.step([action, 2])[0]
        x, y = a[sensor.name], b[sensor.name][0]
        assert x.dtype == y.dtype and x.tobytes() == y.tobytes(), (
            "an agent among many reads something else than one alone"
        )
        assert a[sensor.name] in one.observation_space[sensor.name], (  # type: ignore[index]
            "what it gives is not in its space"
        )


def _check_wire(sensor: Sensor, seen: list[Observation]) -> None:
    if sensor.wire is None:
        return
    sender, before = ObservationSender(), None
    for observation in seen:
        sent = decode_message(encode_message(sender.pack(observation)))
        before = read_observation("", None, sent, before)
        assert _bytes(sensor, before) == _bytes(sensor, observation), "the wire changes it"
