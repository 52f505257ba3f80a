"""Two thousand agents at once: train a small policy by the cross-entropy method, in NumPy alone.

Eight agents share a set of weights; the mean of the best sets begins the next generation.
Run: python examples/04_vector_env.py
"""

import time

import gymnasium
import numpy as np

POLICIES, EACH, STEPS, GENERATIONS = 256, 8, 100, 12
AGENTS = POLICIES * EACH


def features(seen):
    """What a policy knows [N, 5]: where the goal is, how near, and its bumper."""
    forward, left = seen["goal_vector"].T
    distance = np.hypot(forward, left) + 1e-6
    return np.column_stack(
        [forward / distance, left / distance, np.exp(-distance), seen["collided"], np.ones(AGENTS)]
    )


def main() -> None:
    env = gymnasium.make_vec(
        "gn0.sim.env:gn0/PointNav-v1", num_envs=AGENTS, sensors=("goal_vector",), max_steps=STEPS
    )
    rng = np.random.default_rng(0)
    mean, spread = np.zeros((4, 5)), np.ones((4, 5))
    start = time.perf_counter()
    for generation in range(GENERATIONS):
        weights = mean + spread * rng.normal(size=(POLICIES, 4, 5))
        score, first, found = np.zeros(AGENTS), np.ones(AGENTS, bool), 0
        seen, _ = env.reset(seed=generation)
        for _ in range(STEPS):
            known = features(seen).reshape(POLICIES, EACH, 5)
            actions = np.einsum("pef,paf->pea", known, weights).argmax(axis=2).ravel()
            seen, rewards, stopped, cut, infos = env.step(actions)
            score += rewards * first
            ended = first & (stopped | cut)
            if ended.any():  # the next episode began in this step: the last one's end is here
                found += int(infos["final_info"]["success"][ended].sum())
            first &= ~ended  # one episode an agent counts
        best = weights[np.argsort(-score.reshape(POLICIES, EACH).sum(axis=1))[: POLICIES // 10]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.05
        print(f"generation {generation}: {found / AGENTS:4.0%} of the agents find their goal")
    rate = GENERATIONS * STEPS * AGENTS / (time.perf_counter() - start)
    print(f"{rate:,.0f} steps a second, learning included")
    env.close()


if __name__ == "__main__":
    main()
