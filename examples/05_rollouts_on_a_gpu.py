"""Thousands of agents on a GPU: rollouts as tensors, for training.

Without a GPU it runs as well: a few agents on the host emulation of one.
Run: python examples/05_rollouts_on_a_gpu.py
"""

import time

import numpy as np

from gn0 import DeviceError
from gn0.device import find_device, open_device
from gn0.sim import RolloutCollector, VectorEnvDevice

STEPS = 64


def main() -> None:
    device, reason = find_device()
    if device is None:
        try:
            device = open_device("host")
        except DeviceError as error:
            print(f"no GPU ({reason}), and no emulation of one ({error})")
            return
    agents = 4096 if device.kind == "cuda" else 64
    torch = None
    if device.kind == "cuda":
        try:
            import torch
        except ImportError:
            print("torch is not installed: the policy runs in NumPy, through host memory")

    def policy(seen):
        """Turn to the goal, walk, stop near it; after a bump turn left."""
        if torch is None:
            forward, left = seen["goal_vector"].numpy().T
            bumped, where = seen["collided"].numpy() == 1, np.where
        else:  # on the GPU, without a copy
            forward, left = torch.from_dlpack(seen["goal_vector"]).T
            bumped, where = torch.from_dlpack(seen["collided"]) == 1, torch.where
        turn = where(left > 0, 2, 3)
        walk = (abs(left) < 0.3 * forward) & ~bumped
        return where(forward**2 + left**2 < 1, 0, where(walk, 1, where(bumped, 2, turn)))

    env = VectorEnvDevice(agents, device=device, sensors=("goal_vector",), max_steps=60)
    rollouts = RolloutCollector(env, STEPS, observations=("goal_vector", "collided"))
    env.reset(seed=0)
    rollouts.collect(policy)  # kernels are compiled, fields built
    start = time.perf_counter()
    rollout = rollouts.collect(policy)
    env.synchronize()
    rate = agents * STEPS / (time.perf_counter() - start)
    ended = rollout.terminated.numpy() | rollout.truncated.numpy()
    print(f"{device.name}: {agents} agents, {rollouts.nbytes / 2**20:.1f} MB a rollout")
    print(f"{rollout.rewards.numpy().mean():.3f} m of progress a step")
    print(f"{rollout.success.numpy().sum()} of {ended.sum()} episodes succeeded")
    print(f"{rate:,.0f} agent-steps a second, policy included")
    env.close()


if __name__ == "__main__":
    main()
