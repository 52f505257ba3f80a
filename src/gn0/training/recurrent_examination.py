"""How a recurrent baseline does in closed loop, by the same walks and figures as GN-BAE's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import torch
from torch import Tensor

from gn0.data.codec import EgoFrame
from gn0.data.navigation_vocabulary import TextTokenizer
from gn0.device.device import Device
from gn0.policies.bae.actor import Actor
from gn0.policies.bae.policy_settings import frame_of
from gn0.policies.cma.recurrent import RecurrentNet
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.ego_map import MapView
from gn0.training.evaluation import ClosedLoop
from gn0.training.pupil import Pupil
from gn0.training.recurrent_learner import DriverNet, WordTable
from gn0.training.walks import summarise_walks
from gn0.training.worlds import Lessons, load_lessons, open_world

AGENTS = 512  # that are examined at once at most


@dataclass(frozen=True)
class _Said:
    """Decisions of N agents: int64 [N, 1]."""

    actions: Tensor


@dataclass(frozen=True)
class _Form:
    """One action a decision."""

    actions: int = 1


@dataclass(frozen=True)
class _Slots:
    """Of an answer, see `ClosedLoop`."""

    form: _Form = _Form()


class ActorRecurrent:
    """Decides for N agents: the most probable action of each, and remembers.

    Memory is nought where an episode begins, which prompts say.

    Args:
        driver: a net as it is now.
    """

    slots = _Slots()

    def __init__(self, driver: DriverNet) -> None:
        self._driver = driver

    def decide(self, pictures: Sequence[Tensor], prompts: Tensor) -> _Said:
        """Decisions of all agents.

        Args:
            pictures: [N, ...] each.
            prompts: int64 [N, 2] numbers of texts, and actions before.
        """
        texts, last = prompts.unbind(1)
        return _Said(self._driver.choose(pictures, texts, last).argmax(-1)[:, None])


@dataclass(frozen=True)
class _Maker:
    """Makes prompts: what has been told, and what was done."""

    table: WordTable

    def prompts(self, texts: Tensor, pose: Tensor, last: Tensor, hit: Tensor) -> Tensor:
        """int64 [N, 2]."""
        del pose, hit
        return torch.stack([texts, last], 1)


@dataclass(frozen=True)
class _Shown:
    """Settings of the loop."""

    pictures: tuple[str, ...]
    view: MapView
    carried: frozenset[str]
    executed: int = 1

    @property
    def frame(self) -> EgoFrame:
        """No coordinates are said; they are not on the whole map."""
        return frame_of(self.view.squares[0])

    def sensors(self, template: None) -> frozenset[str]:
        """What agents must carry."""
        del template
        return self.carried


@dataclass(frozen=True)
class _Asked:
    """A net as `ClosedLoop` asks it."""

    model: RecurrentNet
    tokenizer: TextTokenizer
    template: None = None

    @property
    def settings(self) -> _Shown:
        """What it is shown."""
        own = self.model.settings
        return _Shown(own.pictures, own.view, own.sensors)

    def maker(
        self, texts: Sequence[str], device: torch.device, maps: Sequence[object] = ()
    ) -> _Maker:
        """Of the prompts of these texts; no word of them is about a map."""
        del maps
        length = self.model.settings.text_length
        return _Maker(WordTable(self.tokenizer, texts, length, device))


class ClosedLoopRecurrent(ClosedLoop):
    """Plays episodes with a recurrent net as it is now; open another one once it has learned.

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
        super().__init__(env, cast(Pupil, _Asked(net, tokenizer)), dtype=autocast)

    def _open_actor(self, pupil: Pupil, **options: Any) -> Actor:
        asked, maker = cast(_Asked, pupil), cast(_Maker, self.maker)
        driver = DriverNet(asked.model, maker.table, self.env.num_envs, options.get("dtype"))
        return cast(Actor, ActorRecurrent(driver))


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
        return load_lessons(self.suite, self.splits)

    @cached_property
    def _env(self) -> VectorEnvDevice:
        agents = min(self.episodes, AGENTS, len(self._lessons.episodes))
        return open_world(self._lessons, self.net.settings, agents, device=self.card)

    def __call__(self) -> dict[str, float]:
        """What was measured, by name, as `gn0 train sft` names it; shares from 0 to 1, m."""
        loop = ClosedLoopRecurrent(self._env, self.net, self.tokenizer, self.autocast)
        count = len(self._lessons.episodes)
        stride = max(1, count // self.episodes)
        picked = list(range(0, count, stride))[: self.episodes]
        found: dict[str, float] = {}
        for kind, means in summarise_walks(loop.play(picked)).items():
            end = "" if kind == "all" else f"_{kind}"
            found |= {f"{name}{end}": value for name, value in means.items()}
        return found
