"""What a ring of steps gives is what the sensors said when the steps were taken."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.errors import ConfigError, DeviceMemoryError, SimError

torch = pytest.importorskip("torch")
step_ring = pytest.importorskip("gn0.training.streams.step_ring")

SENSORS = ("rgb", "history", "ego_map")


def walk(env, ring, rounds: int, seed: int = 0) -> list[dict[str, np.ndarray]]:
    """Take steps at random, and keep all that the environment said of each."""
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    last, kept = torch.full((env.num_envs,), -1, dtype=torch.int8), []
    for _ in range(rounds):
        labels = env.labels(1.0)
        ring.put(labels, last)
        seen, outputs = env.observe(), env.simulator.outputs
        told = {name: seen[name].numpy() for name in env.sensors}
        told |= {name: outputs[name].numpy() for name in ("episode", "pose")}
        told |= {"collided": outputs["collided"].numpy() != 0, "last": last.numpy().copy()}
        told |= {name: getattr(labels, name).numpy() for name in labels._fields}
        kept.append(told)
        actions = rng.choice(4, env.num_envs, p=(0.03, 0.57, 0.2, 0.2))
        _, _, stopped, cut, _ = env.step(actions)
        ended = stopped.numpy() | cut.numpy()
        last = torch.from_numpy(np.where(ended, -1, actions).astype(np.int8))
    return kept


def assert_states(states, kept, numbers: np.ndarray, agents: int) -> None:
    """Each state is what was said of it, to the bit."""
    for k, number in enumerate(numbers.tolist()):
        told = {name: rows[number % agents] for name, rows in kept[number // agents].items()}
        for name in ("episode", "pose", "collided", "last", "actions", "waypoints", "distance"):
            ours = getattr(states, name)[k].numpy()
            assert ours.tobytes() == told[name].astype(ours.dtype).tobytes(), name
        for name in ("rgb", "history"):
            np.testing.assert_array_equal(states.pictures[name][k].numpy(), told[name], name)
        near, far = states.pictures["near"][k].numpy(), states.pictures["far"][k].numpy()
        np.testing.assert_array_equal(near, told["ego_map"][:, :24])
        np.testing.assert_array_equal(far, told["ego_map"][:16, 24:])


def test_samples_are_what_the_sensors_said(make_env) -> None:
    """Mosaic and ego maps too, round the ring, as episodes end and begin."""
    env = make_env(3, SENSORS)
    ring = step_ring.StepRing(env, 24)
    kept = walk(env, ring, 60)
    begins = np.concatenate([told["last"] < 0 for told in kept[40:]])
    assert begins.any()
    first, end = ring.window
    assert (first, end) == ((60 - 24 + 16) * 3, 180)
    numbers = np.random.default_rng(1).integers(first, end, 40)
    assert_states(ring.draw(numbers), kept, numbers, 3)
    latest = ring.latest()
    assert_states(latest, kept, np.arange(177, 180), 3)
    assert latest.pick(torch.tensor([2, 0])).pictures["near"].shape == (2, 24, 24, 3)


def test_a_blacked_out_mosaic_is_the_only_change(make_env) -> None:
    env = make_env(2, SENSORS)
    ring = step_ring.StepRing(env, 20)
    walk(env, ring, 12)
    numbers = np.arange(8, 24)
    dark = np.arange(16) % 3 == 0
    plain, shown = ring.draw(numbers), ring.draw(numbers, dark)
    history = shown.pictures["history"].numpy()
    assert not history[dark].any()
    assert (history[~dark] == plain.pictures["history"].numpy()[~dark]).all()
    assert history[~dark].any()
    for name in ("rgb", "near", "far"):
        assert (shown.pictures[name] == plain.pictures[name]).all()


def test_a_thousand_marked_steps_round_the_ring(make_env) -> None:
    """Tiles that hold their own step: every mosaic holds those of its episode, in order."""
    env = make_env(2, SENSORS)
    env.reset(seed=0)
    labels, agents = env.labels(), 2
    ring = step_ring.StepRing(env, 50)
    rng, age = np.random.default_rng(2), np.zeros(agents, np.int32)
    ages, last = [], torch.full((agents,), -1, dtype=torch.int8)
    for step in range(1000):
        ring.put(labels, last, torch.from_numpy(age.copy()))
        for agent in range(agents):
            mark = torch.tensor([(step * agents + agent) % 251 + 1, step % 256, agent])
            ring["tile"][step % 50, agent] = mark.to(torch.uint8)
        ages.append(age.copy())
        age = np.where(rng.random(agents) < 0.08, 0, age + 1).astype(np.int32)
        if step % 97 and step != 999:
            continue
        first, end = ring.window
        assert end - first == (min(step + 1, 50) - (16 if step >= 50 else 0)) * agents
        numbers = np.arange(first, end)
        mosaics = ring.draw(numbers).pictures["history"].numpy()
        tiles = mosaics.reshape(-1, 4, 4, 4, 8, 3).swapaxes(2, 3).reshape(len(numbers), 16, 4, 8, 3)
        for number, shown in zip(numbers.tolist(), tiles, strict=True):
            now, agent = divmod(number, agents)
            for back in range(1, 17):
                past = now - back
                mark = [0, 0, 0]
                if back <= ages[now][agent]:
                    mark = [(past * agents + agent) % 251 + 1, past % 256, agent]
                assert (shown[back - 1] == mark).all(), (step, number, back)


def test_what_is_overwritten_or_not_there_yet_is_refused(make_env) -> None:
    env = make_env(2, ("rgb",))
    ring = step_ring.StepRing(env, 18)
    assert ring.window == (0, 0)
    walk(env, ring, 25)
    for numbers in ([22 * 2], [25 * 2], [-1]):
        with pytest.raises(SimError, match="draw states of StepRing"):
            ring.draw(np.array(numbers))
    assert len(ring.draw(np.array([23 * 2]))) == 1


def test_maps_alone_need_no_views_and_little_memory(make_env) -> None:
    env = make_env(4, ("ego_map",))
    ring = step_ring.StepRing(env, 8, names=("close", "wide"))
    kept = walk(env, ring, 20)
    assert ring.window == (12 * 4, 20 * 4)
    assert ring.nbytes < 8 * 4 * 200
    states = ring.draw(np.arange(12 * 4, 80))
    assert set(states.pictures) == {"close", "wide"}
    shown = np.concatenate([told["ego_map"] for told in kept[12:]])
    np.testing.assert_array_equal(states.pictures["close"].numpy(), shown[:, :, :24])


def test_too_large_a_ring_says_how_many_bytes_and_what_fits(make_env) -> None:
    env = make_env(2)
    each = 2 * (24 * 20 * 3 + 8 * 4 * 3 + 4 + 24 + 4 + 1 + 1 + 6 + 104 + 1 + 8)
    with pytest.raises(DeviceMemoryError, match=f"takes {1000 * each} bytes, 100000 are free") as e:
        step_ring.StepRing(env, 1000, memory=100_000)
    assert f"up to {100_000 // each} steps" in str(e.value)
    ring = step_ring.StepRing(env, 100_000 // each, memory=100_000)
    assert ring.nbytes <= 100_000
    for steps in (0, 16):
        with pytest.raises(ConfigError, match="for the mosaics"):
            step_ring.StepRing(env, steps)
    with pytest.raises(ConfigError, match="squares"):
        step_ring.StepRing(env, 20, names=("near",))
