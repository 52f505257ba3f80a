"""How a recurrent baseline does in closed loop, by the same walks and figures as GN-BAE's."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import torch
from torch import Tensor

from gn0.data.navigation_vocabulary import TextTokenizer
from gn0.device.device import Device
from gn0.missions.controls import CONTROL_TEXT
from gn0.policies.cma.recurrent import RecurrentNet
from gn0.sim.device_env import VectorEnvDevice
from gn0.training.exams.episode_loop import EpisodeLoop
from gn0.training.exams.walkers import AskedAgents
from gn0.training.exams.walks import summarise_walks
from gn0.training.recurrent_learner import DriverNet, WordTable
from gn0.training.worlds import Lessons, load_held_out, open_world, pick_evenly

AGENTS = 512  # that are examined at once at most


class ClosedLoopRecurrent(EpisodeLoop):
    """Plays episodes with a recurrent net as it is now; open another one once it has learned.

    It decides on one action, the most probable one, and remembers; memory is nought where an
    episode begins.

    Args:
        env: its agents; they are reset.
        net: on the device of `env`.
        tokenizer: of the policy.
        autocast: see `RecurrentLearner`.

    Raises:
        ConfigError: the agents do not see what the net is shown, or a text is longer than it reads.
    """

    def __init__(
        self,
        env: VectorEnvDevice,
        net: RecurrentNet,
        tokenizer: TextTokenizer,
        autocast: torch.dtype | None = None,
    ) -> None:
        own, device = net.settings, net.device
        super().__init__(
            env, pictures=own.pictures, view=own.view, sensors=own.sensors, device=device,
            actions=1, executed=1,
        )  # fmt: skip
        texts = [*(episode.instruction for episode in env.episodes), CONTROL_TEXT]
        table = WordTable(tokenizer, texts, own.text_length, device)
        self._driver = DriverNet(net, table, env.num_envs, autocast)

    def decide(self, shown: Sequence[Tensor], agents: AskedAgents) -> Tensor:
        """See `EpisodeLoop`; neither place nor obstacles are told."""
        return self._driver.choose(shown, agents.texts, agents.last).argmax(-1)[:, None]


class RecurrentExamination:
    """Examines a net on held-out episodes; the next step of training knows nothing of it.

    Args:
        net: what is examined.
        tokenizer: of it.
        suite: where.
        splits: of the suite.
        card: the device of the agents.
        episodes: that are walked.
        autocast: see `RecurrentLearner`.
    """

    def __init__(
        self,
        net: RecurrentNet,
        tokenizer: TextTokenizer,
        suite: str,
        splits: Sequence[str],
        card: Device,
        *,
        episodes: int,
        autocast: torch.dtype | None = None,
    ) -> None:
        self.net, self.tokenizer, self.autocast = net, tokenizer, autocast
        self.suite, self.splits, self.card, self.episodes = suite, tuple(splits), card, episodes

    @cached_property
    def _lessons(self) -> Lessons:
        return load_held_out(self.suite, self.splits)

    @cached_property
    def _env(self) -> VectorEnvDevice:
        agents = min(self.episodes, AGENTS, len(self._lessons.episodes))
        return open_world(self._lessons, self.net.settings, agents, device=self.card)

    def __call__(self) -> dict[str, float]:
        """What was measured, by name, as `gn0 train sft` names it; shares from 0 to 1, m."""
        loop = ClosedLoopRecurrent(self._env, self.net, self.tokenizer, self.autocast)
        count = len(self._lessons.episodes)
        picked = pick_evenly(count, self.episodes)
        found: dict[str, float] = {}
        for kind, means in summarise_walks(loop.play(picked)).items():
            end = "" if kind == "all" else f"_{kind}"
            found |= {f"{name}{end}": value for name, value in means.items()}
        return found
