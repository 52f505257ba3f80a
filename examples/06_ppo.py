"""Learn PointNav with Stable-Baselines3's PPO: 128 agents in one process.

Run: python examples/06_ppo.py [agent-steps], after pip install -e '.[rl]'. 600,000 steps (under a
minute on two quiet cores) find nearly every goal; the 20,000 of a plain run show that it begins.
"""

import sys

import gymnasium
import numpy as np

from gn0.sim import FlatVectorEnv, build_vec_env


def main() -> None:
    try:
        from stable_baselines3 import PPO
        from stable_baselines3.common.vec_env import VecNormalize
    except ImportError:
        print("needs Stable-Baselines3: pip install -e '.[rl]'")
        return
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    envs = gymnasium.make_vec(
        "gn0.sim.env:gn0/PointNav-v1", num_envs=128, max_steps=150, success_distance=0.5
    )
    env = VecNormalize(build_vec_env(FlatVectorEnv(envs)), norm_reward=False)
    model = PPO(
        "MlpPolicy", env, n_steps=32, batch_size=1024, n_epochs=4, learning_rate=1e-3, gamma=0.98,
        ent_coef=0.01, seed=0, device="cpu",
    )  # fmt: skip
    done = 0
    while done < steps:
        part = min(100_000, steps - done)
        model.learn(part, reset_num_timesteps=False)
        done = model.num_timesteps
        found = np.mean(model.ep_success_buffer)
        print(f"{done:,} steps: {found:.0%} of the last episodes found their goal")
    env.close()


if __name__ == "__main__":
    main()
