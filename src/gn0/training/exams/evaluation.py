"""How good a policy is: its free answers on labelled states, and whole episodes on a device.

Teacher-forced figures prove nothing: here the model reads what it said itself, and walks where its
own actions lead.

    loop = ClosedLoop(env, pupil, dtype=torch.bfloat16)
    walks = loop.play()                       # every episode of env once
    print(summarise_walks(walks)["all"]["SR"])
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gn0.data.answer_slots import ACTION
from gn0.errors import ConfigError
from gn0.missions.controls import CONTROL_TEXT, Control
from gn0.missions.episode import Episode
from gn0.policies.bae.actor import Actor, Decisions
from gn0.policies.bae.draws import NEVER, check_draw_after, make_draws
from gn0.policies.bae.waypoint_plan import Carried, check_carried
from gn0.progress import Progress, no_progress
from gn0.seeds import random_stream
from gn0.sim.device_atlas import EgoAtlas
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.state import Action
from gn0.training.exams.episode_loop import EpisodeLoop
from gn0.training.exams.walkers import AskedAgents
from gn0.training.exams.walks import Walk
from gn0.training.exams.walks import summarise_walks as summarise_walks
from gn0.training.exams.waypoint_follower import WaypointFollower
from gn0.training.pupil import Pupil
from gn0.training.streams.samples import LabelledStates, SampleMaker
from gn0.training.streams.step_ring import draw_whole

POLICY = "bae"  # whose streams are those of the benchmark's policy of that name
Watch = Callable[[Sequence[Tensor], Tensor, Decisions], None]


@dataclass(frozen=True)
class StateScores:
    """Free answers against the expert's, on N states.

    Attributes:
        states: how many.
        actions: share of right actions by place in the answer; the first is what counts.
        last_median, last_mean: distance of the last waypoint to the expert's [m]; NaN without any.
        stop_recall: share of states where the expert stops at once in which the policy does.
        stop_precision: share of states where the policy stops at once in which the expert does.
        entropy: mean over the slots that are chosen, at temperature 1 [nat].
        action_entropy: mean of each action's slot, by place in the answer, likewise.
    """

    states: int
    actions: tuple[float, ...]
    last_median: float
    last_mean: float
    stop_recall: float
    stop_precision: float
    entropy: float
    action_entropy: tuple[float, ...]


def score_states(actor: Actor, maker: SampleMaker, states: LabelledStates) -> StateScores:
    """Ask about labelled states, batch by batch.

    Raises:
        ConfigError: there are none, or they lack a picture that the prompt shows.
    """
    if not len(states):
        raise ConfigError("no states to ask about", where="evaluation", remedy="give some")
    said, wanted, off, entropy, spoken = [], [], [], [], []
    slots = torch.from_numpy(np.flatnonzero(actor.slots.kinds == ACTION)).to(actor.device)
    way = actor.slots.form.points > 0
    for begin in range(0, len(states), actor.count):
        some = states.pick(slice(begin, begin + actor.count))
        batch = maker.make(some)
        told = actor.decide(batch.pictures, batch.ids)
        said.append(told.actions)
        wanted.append(some.actions[:, : told.actions.shape[1]].long())
        chosen = (told.entropy > 0).sum(1).clamp(min=1)
        entropy.append(told.entropy.sum(1) / chosen)
        spoken.append(told.entropy[:, slots])
        if way:
            last = actor.slots.form.points - 1
            found = maker.waypoints(told.ids, some.episode, some.pose)[:, -1]
            off.append(torch.linalg.vector_norm(found - some.waypoints[:, last], dim=-1))
    mine, theirs = torch.cat(said), torch.cat(wanted)
    stops, right = mine[:, 0] == Action.STOP, theirs[:, 0] == Action.STOP
    both = float((stops & right).sum())
    distance = torch.cat(off).double() if way else torch.full((1,), torch.nan)
    return StateScores(
        states=len(states),
        actions=tuple((mine == theirs).double().mean(0).tolist()),
        last_median=float(distance.quantile(0.5)) if way else float("nan"),
        last_mean=float(distance.mean()),
        stop_recall=both / max(int(right.sum()), 1),
        stop_precision=both / max(int(stops.sum()), 1),
        entropy=float(torch.cat(entropy).double().mean()),
        action_entropy=tuple(torch.cat(spoken).double().mean(0).tolist()),
    )


class ClosedLoop(EpisodeLoop):
    """Plays episodes of an environment with a model, as many at once as it has agents.

    A model that learns between two calls plays with what it has then.

    Args:
        env: its agents; they are reset.
        pupil: the model and how it is asked; on the device of `env`.
        dtype: of what is computed, see `Actor`.
        compiled: see `Actor`.
        executed: actions of an answer that are carried out; 0: as the settings say.
        confirm_stop: see `EpisodeLoop`.
        carried: the answers' actions; or their waypoints, along which the cheapest actions lead,
            while STOP is that of a first action (`waypoint_plan`).
        labelled: see `EpisodeLoop`.
        temperature: of the draws, see `Actor`.
        draw_after: actions without getting anywhere after which answers are drawn, as `PolicyBae`
            draws them; 0: never, -1: as the settings say. Not with a temperature.

    Raises:
        ConfigError: the agents do not see what the prompt shows.
    """

    def __init__(
        self,
        env: VectorEnvDevice,
        pupil: Pupil,
        *,
        dtype: torch.dtype | None = None,
        compiled: bool = False,
        executed: int = 0,
        confirm_stop: bool = False,
        carried: Carried = "actions",
        labelled: bool = False,
        temperature: float = 0.0,
        draw_after: int = -1,
    ) -> None:
        settings = self.settings = pupil.settings
        own = 0 if temperature > 0 else settings.draw_after
        self.draw_after = check_draw_after(draw_after, own)
        super().__init__(
            env, pictures=settings.pictures, view=settings.view,
            sensors=settings.sensors(pupil.template), device=pupil.model.device,
            actions=settings.form.actions, executed=executed or settings.executed,
            on_map=settings.frame is None, confirm_stop=confirm_stop, labelled=labelled,
        )  # fmt: skip
        texts = [episode.instruction for episode in env.episodes]
        self.atlas = EgoAtlas(env) if self.whole or self.on_map else None
        maps = self.atlas.frames if self.atlas is not None else ()
        # a prompt on the whole map says its scale, so each episode has a prompt without words, too
        said = [CONTROL_TEXT] * (len(texts) if self.on_map else 1)
        self.maker = pupil.maker([*texts, *said], self.device, maps * 2)
        self.actor = Actor(
            pupil.model, self.maker.table.layout, pupil.slots, settings.frame, env.num_envs,
            said=self.maker.table.place, dtype=dtype, compiled=compiled, temperature=temperature,
            drawn=self.draw_after > 0,
        )  # fmt: skip
        self._draws = self._drawn = torch.empty(0)  # by `begin`
        self._follower: WaypointFollower | None = None
        if check_carried(carried, settings.form.points) == "waypoints":
            self._follower = WaypointFollower(self.device)
        self._watch: Watch | None = None

    def play(
        self,
        episodes: Sequence[int] | None = None,
        *,
        control: Control = "none",
        seed: int = 0,
        keep: Callable[[list[Walk]], None] | None = None,
        progress: Progress = no_progress,
        watch: Watch | None = None,
    ) -> list[Walk]:
        """Play episodes once each; see `EpisodeLoop`.

        Args:
            episodes: numbers among `env.tasks.episodes`; all when None.
            control: what is taken away.
            seed: of the shuffling.
            keep: is given walks while others go on.
            progress: is told how many walks there are.
            watch: is given pictures, prompts and answers of each decision of all agents; those
                that are done decide on, for nobody.
        """
        self._watch = watch
        return super().play(episodes, control=control, seed=seed, keep=keep, progress=progress)

    def begin(self, which: NDArray[np.int64], episodes: Sequence[Episode]) -> None:
        """Numbers of their draws, those that the benchmark's policy has."""
        if not self.draw_after:
            return
        streams = (random_stream(e.seed, "policy", POLICY, e.id) for e in episodes)
        slots = len(self.actor.slots)
        draws = torch.from_numpy(np.stack([make_draws(one, slots) for one in streams]))
        if not len(self._draws):
            count = self.env.num_envs
            self._draws = torch.empty((count, *draws.shape[1:]), dtype=draws.dtype).to(self.device)
            self._drawn = torch.zeros(count, dtype=torch.int64, device=self.device)
        rows = torch.from_numpy(which).to(self.device)
        self._draws[rows], self._drawn[rows] = draws.to(self.device), 0

    def decide(self, shown: Sequence[Tensor], agents: AskedAgents) -> Tensor:
        """See `EpisodeLoop`."""
        ids = self.maker.prompts(agents.texts, agents.pose, agents.last, agents.hit)
        said = self.actor.decide(shown, ids, self._draw(agents) if self.draw_after else None)
        if self._watch is not None:
            self._watch(shown, ids, said)
        told = said.actions
        if self._follower is not None:
            stops = told[:, :1] == Action.STOP
            told = self._follower.plan(self.maker.waypoints(said.ids, agents.episode, agents.pose))
            told = told.masked_fill(stops, Action.STOP)
        return told

    def _draw(self, agents: AskedAgents) -> Tensor:
        """Numbers float32 [N, S] of those who get nowhere; below 0 for the others."""
        lost = agents.idle >= self.draw_after
        rows = torch.arange(len(lost), device=self.device)
        numbers = self._draws[rows, self._drawn % self._draws.shape[1]]
        self._drawn = self._drawn + (lost & agents.heard)
        return torch.where(lost[:, None], numbers, float(NEVER))

    def _draw_whole(self, episode: Tensor, pose: Tensor) -> dict[str, Tensor]:
        size, found = self.settings.map_size, dict[str, Tensor]()
        for name in self.whole:
            assert self.atlas is not None
            found[name] = draw_whole(self.atlas, self.env.device, name, size, episode.int(), pose)
        return found
