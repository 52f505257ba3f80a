"""How good a policy is: its free answers on labelled states, and whole episodes on a device.

Teacher-forced figures prove nothing: here the model reads what it said itself, and walks where its
own actions lead.

    loop = ClosedLoop(env, pupil, dtype=torch.bfloat16)
    walks = loop.play()                       # every episode of env once
    print(summarise_walks(walks)["all"]["SR"])
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gn0.bench.metrics import straight_to_goal
from gn0.data.answer_slots import ACTION
from gn0.errors import ConfigError
from gn0.missions.controls import CONTROL_TEXT, Control, check_control, choose_texts
from gn0.missions.episode import Episode, mission_name
from gn0.paper import SUCCESS_RADIUS
from gn0.policies.bae.actor import Actor, Decisions
from gn0.policies.bae.draws import NEVER, check_draw_after, make_draws
from gn0.policies.bae.policy_settings import MAPS, SQUARE_NAMES
from gn0.policies.bae.waypoint_plan import Carried, check_carried
from gn0.seeds import random_stream
from gn0.sim.device_atlas import EgoAtlas
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.ego_map import MapView
from gn0.sim.state import Action
from gn0.training.exams.walks import Walk
from gn0.training.exams.walks import summarise_walks as summarise_walks
from gn0.training.exams.waypoint_follower import WaypointFollower
from gn0.training.pupil import Pupil
from gn0.training.streams.live_counts import COUNTED, LiveCounts
from gn0.training.streams.samples import LabelledStates, SampleMaker
from gn0.training.streams.step_ring import draw_whole
from gn0.training.streams.stream_live import STOP_DISTANCE

POLICY = "bae"  # whose streams are those of the benchmark's policy of that name
NEAR = 1.0  # m on foot: the stricter radius
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


@dataclass(frozen=True)
class AskedAgents:
    """N agents who are asked what to do.

    Attributes:
        texts: int64 [N] numbers of what they are told.
        episode: int64 [N] numbers of theirs.
        pose: float64 [N, 3].
        last: int64 [N] actions before; -1 where an episode begins.
        hit: bool [N], whether an obstacle cut that short.
        idle: int64 [N] actions since they got anywhere.
        heard: bool [N], whose answer is carried out.
    """

    texts: Tensor
    episode: Tensor
    pose: Tensor
    last: Tensor
    hit: Tensor
    idle: Tensor
    heard: Tensor


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


class EpisodeLoop(ABC):
    """Plays episodes of an environment, as many at once as it has agents; subclasses decide.

    Args:
        env: its agents; they are reset.
        pictures: that are shown, by name.
        view: of the ego map.
        sensors: that agents must have, the pose and whole maps aside.
        device: where decisions are made.
        actions: A of a decision.
        executed: of them, that are carried out.
        on_map: whether prompts say where on the whole map the agent is.
        confirm_stop: a STOP behind the first action is asked again.
        labelled: hold what the policy does against the expert, wherever it gets to.

    Attributes:
        decisions: answers so far.
        counts: of the last `play`, where `labelled`; episodes that nobody counts are left out.

    Raises:
        ConfigError: the agents do not see what is shown.
    """

    def __init__(
        self,
        env: VectorEnvDevice,
        *,
        pictures: Sequence[str],
        view: MapView,
        sensors: Collection[str],
        device: torch.device,
        actions: int,
        executed: int,
        on_map: bool = False,
        confirm_stop: bool = False,
        labelled: bool = False,
    ) -> None:
        self.env, self.device, self.pictures, self.view = env, device, tuple(pictures), view
        self.actions, self.executed, self.on_map = actions, executed, on_map
        self.confirm_stop, self.labelled = confirm_stop, labelled
        self.whole = [name for name in MAPS if name in pictures]
        needed = set(sensors) - {"pose", *MAPS}
        missing = (needed | ({"ego_map"} if self.whole else set())) - set(env.sensors)
        if missing:
            raise ConfigError(
                f"agents do not see {', '.join(sorted(missing))}",
                where="evaluation",
                remedy="open the environment with the sensors of the policy's settings",
            )
        if labelled:
            env.expect_labels()
        self.decisions, self.counts = 0, LiveCounts()
        squares = set(SQUARE_NAMES) & {*pictures}
        # whole maps are drawn of the same pictures as squares
        self._unseen = ["ego_map"] if self.whole and not squares else []
        views = "history" not in env.sensors  # mosaics are made of all views
        self._idle = [n for n in ("ego_map", *(["rgb"] if views else [])) if n in env.sensors]

    @abstractmethod
    def decide(self, shown: Sequence[Tensor], agents: AskedAgents) -> Tensor:
        """Decisions of all N agents: int64 [N, A] actions.

        Args:
            shown: pictures [N, ...] each.
            agents: who is asked.
        """

    def begin(self, episodes: Sequence[Episode]) -> None:
        """All agents begin these: what remembers forgets; others need not be told."""
        del episodes

    def play(
        self,
        episodes: Sequence[int] | None = None,
        *,
        control: Control = "none",
        seed: int = 0,
    ) -> list[Walk]:
        """Play episodes once each.

        Args:
            episodes: numbers among `env.tasks.episodes`; all when None.
            control: what is taken away: the text for another one of the same scene (shuffled), or
                for `go` (no_words); pictures are black (no_pictures).
            seed: of the shuffling.

        Returns:
            walks in the order of `episodes`.

        Raises:
            ConfigError: no such control.
            EpisodeError: no such episode.
        """
        check_control(control)
        wanted = list(range(len(self.env.tasks.episodes))) if episodes is None else list(episodes)
        chosen = choose_texts(self.env.episodes, control, seed)
        if control == "no_words" and self.on_map:
            chosen = chosen + np.arange(len(chosen))
        texts = torch.from_numpy(chosen).to(self.device)
        count, walks = self.env.num_envs, []
        self.counts = LiveCounts()
        for begin in range(0, len(wanted), count):
            some = wanted[begin : begin + count]
            filled = some + [some[-1]] * (count - len(some))  # who has none plays one for nobody
            dark = control == "no_pictures"
            walks += self._round(filled, len(some), texts, dark=dark)
        return walks

    def _round(self, numbers: list[int], real: int, texts: Tensor, *, dark: bool) -> list[Walk]:
        env, begun = self.env, time.perf_counter()
        env.mute(*self._unseen)
        seen, infos = env.reset(seed=0, options={"episode": numbers})
        self.begin([env.tasks.episodes[number] for number in numbers])
        own = _take(infos["episode"]).long().clone()
        pose, distance = _take(infos["pose"]).clone(), _take(infos["distance_to_goal"]).clone()
        count = len(numbers)
        zeros = torch.zeros(count, dtype=torch.int64, device=self.device)
        done = torch.arange(count, device=self.device) >= real
        book = {
            "shortest": distance.clone(), "least": distance.clone(), "left": distance.clone(),
            "length": torch.zeros_like(distance), "steps": zeros.clone(),
            "forwards": zeros.clone(), "cut_short": zeros.clone(),
            "decisions": zeros.clone(), "stopped": zeros.bool(), "place": pose[:, :2].clone(),
            **{name: zeros.clone() for name in ("agreed", "due", "stopped_right")},
        }  # fmt: skip
        last, hit, idle, at = zeros - 1, zeros.bool(), zeros.clone(), zeros + self.executed
        plan = torch.zeros((count, self.actions), dtype=torch.int64).to(last)
        steps = 0
        while not (steps % self.executed == 0 and bool(done.all())):
            next_up = plan.gather(1, at.clamp(max=plan.shape[1] - 1)[:, None])[:, 0]
            asked = at >= self.executed
            if self.confirm_stop:
                asked |= (at > 0) & (next_up == Action.STOP)
            # without confirming, all agents are asked at once: the host need not look
            if bool((asked & ~done).any()) if self.confirm_stop else steps % self.executed == 0:
                shown = self._show(seen, own, pose, dark)
                agents = AskedAgents(texts[own], own, pose, last, hit, idle, asked & ~done)
                said = self.decide(shown, agents)
                plan = torch.where(asked[:, None], said, plan)
                at = torch.where(asked, 0, at)
                self.decisions += real
                book["decisions"] += asked & ~done
            action = plan.gather(1, at[:, None])[:, 0]
            if self.labelled:
                expert = _take(env.labels(STOP_DISTANCE).actions)[:, 0]
                stopped, due = ~done & (action == Action.STOP), ~done & (expert == Action.STOP)
                book["agreed"] += ~done & (action == expert)
                book["due"] += due
                book["stopped_right"] += stopped & due
            at, steps = at + 1, steps + 1
            if not self.confirm_stop:  # what nobody looks at is not drawn
                env.mute(*(self._idle if steps % self.executed else self._unseen))
            seen, _, terminated, _, infos = env.step(action.to(torch.uint8))
            final, ended = infos["final_info"], _take(infos["_final_info"]).bool()
            there = torch.where(ended[:, None], _take(final["pose"]), _take(infos["pose"]))
            left = torch.where(
                ended, _take(final["distance_to_goal"]), _take(infos["distance_to_goal"])
            )
            cut = torch.where(
                ended, _take(infos["final_obs"]["collided"]), _take(seen["collided"])
            ).bool()
            live = ~done
            book["steps"] += live
            book["length"] += live * torch.linalg.vector_norm(there[:, :2] - pose[:, :2], dim=-1)
            book["least"] = torch.where(live, torch.minimum(book["least"], left), book["least"])
            book["left"] = torch.where(live, left, book["left"])
            book["place"] = torch.where(live[:, None], there[:, :2], book["place"])
            book["forwards"] += live & (action == Action.FORWARD)
            book["cut_short"] += live & (action == Action.FORWARD) & cut
            book["stopped"] |= live & _take(terminated).bool()
            done = done | ended
            # whoever ended is in another episode, which nobody counts
            own = _take(infos["episode"]).long().clone()
            pose = _take(infos["pose"]).clone()
            last = torch.where(ended, -1, action)
            hit = cut & ~ended
            idle = torch.where(ended | ((action == Action.FORWARD) & ~cut), 0, idle + 1)
        env.synchronize()
        found = {name: values.cpu().numpy() for name, values in book.items()}
        found["seconds"] = np.full(real, (time.perf_counter() - begun) / real)
        walks = [
            _score(env.tasks.episodes[numbers[k]], {n: v[k] for n, v in found.items()})
            for k in range(real)
        ]
        if self.labelled:
            sums = {name: int(found[name][:real].sum()) for name in set(COUNTED) & set(found)}
            steps = int(found["steps"][:real].sum())
            arrived = sum(walk.success for walk in walks)
            sums |= {"steps": steps, "asked": steps, "ended": real, "arrived": arrived}
            self.counts += LiveCounts(**sums)
        return walks

    def _show(self, seen: Any, episode: Tensor, pose: Tensor, dark: bool) -> list[Tensor]:
        """Pictures of the prompt, in its order."""
        squares = dict(
            zip(SQUARE_NAMES, self.view.split(_take(seen["ego_map"])), strict=False)
            if "ego_map" in seen
            else ()
        )
        made = squares | self._draw_whole(episode, pose)
        shown = [made[n] if n in made else _take(seen[n]) for n in self.pictures]
        return [torch.zeros_like(one) for one in shown] if dark else shown

    def _draw_whole(self, episode: Tensor, pose: Tensor) -> dict[str, Tensor]:
        """Whole maps of those that are shown, by name."""
        del episode, pose
        return {}


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
        watch: Watch | None = None,
    ) -> list[Walk]:
        """Play episodes once each; see `EpisodeLoop`.

        Args:
            episodes: numbers among `env.tasks.episodes`; all when None.
            control: what is taken away.
            seed: of the shuffling.
            watch: is given pictures, prompts and answers of each decision of all agents; those
                that are done decide on, for nobody.
        """
        self._watch = watch
        return super().play(episodes, control=control, seed=seed)

    def begin(self, episodes: Sequence[Episode]) -> None:
        """Numbers of their draws, those that the benchmark's policy has."""
        if not self.draw_after:
            return
        streams = (random_stream(e.seed, "policy", POLICY, e.id) for e in episodes)
        slots = len(self.actor.slots)
        draws = np.stack([make_draws(stream, slots) for stream in streams])
        self._draws = torch.from_numpy(draws).to(self.device)
        self._drawn = torch.zeros(len(episodes), dtype=torch.int64, device=self.device)

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


def _take(array: Any) -> Tensor:
    found: Tensor = torch.from_dlpack(array)
    return found


def _score(episode: Episode, found: dict[str, Any]) -> Walk:
    left, least, shortest = (float(found[name]) for name in ("left", "least", "shortest"))
    length, stopped = float(found["length"]), bool(found["stopped"])
    straight = straight_to_goal(episode, *found["place"].tolist())
    within = episode.success_within(SUCCESS_RADIUS)
    success, near = stopped and left < within, stopped and left < min(within, NEAR)
    by_eye = success if episode.in_area else stopped and straight < within
    longer = max(shortest, length)
    share = shortest / longer if longer > 0 else 1.0
    return Walk(
        episode=episode.id,
        scene=episode.scene_id,
        path=episode.path_id,
        kind=mission_name(episode.mission),
        tier=episode.tier,
        steps=int(found["steps"]),
        stopped=stopped,
        length=length,
        shortest=shortest,
        left=left,
        left_straight=straight,
        least=least,
        success=success,
        success_straight=by_eye,
        success_near=near,
        spl=share if success else 0.0,
        spl_straight=share if by_eye else 0.0,
        spl_near=share if near else 0.0,
        oracle=least < within,
        forwards=int(found["forwards"]),
        cut_short=int(found["cut_short"]),
        decisions=int(found["decisions"]),
        seconds=float(found["seconds"]),
    )
