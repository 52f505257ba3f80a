"""A policy server: copy it, load your model at the top, start it with a port, as in 8000.

gn0 bench run SUITE --policy remote --policy-option url=ws://127.0.0.1:8000 --out out/remote
"""

import sys

import numpy as np

from gn0.policies import PolicyRemote, PolicyServer, serve
from gn0.testing import check_policy


class DepthWalker:
    """Walks where there is room, and knows nothing of the goal: put your model in its place."""

    name = "depth walker"
    sensors = frozenset({"depth"})  # add "rgb" and whatever else your model looks at

    def reset(self, instruction, rng):
        self.side = None  # the way we turn until there is room ahead

    def answer(self, observation, frames):  # frames: the pictures since the last question
        if observation.step >= 60:
            return ["stop"]
        left, ahead, right = np.array_split(observation.depth[len(observation.depth) // 3 :], 3, 1)
        if ahead.min() > 0.8:
            self.side = None
            return ["forward"] * min(4, int((ahead.min() - 0.5) / 0.25))
        self.side = self.side or ("left" if left.mean() > right.mean() else "right")
        return [self.side]


if __name__ == "__main__":
    if len(sys.argv) > 1:
        serve(DepthWalker, port=int(sys.argv[1]))
    with PolicyServer(DepthWalker, port=0) as server:
        check_policy(lambda: PolicyRemote(server.url), preset="vlnce_r2r", max_steps=8)
        print("the depth walker keeps the contract, asked at", server.url)
