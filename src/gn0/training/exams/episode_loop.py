"""`EpisodeLoop`: whole episodes on a device, where a policy's own actions lead.

Who has come to an end begins the next episode. A walk takes 60 steps on the mean and 500 at most,
so were all to wait for the last, seven of eight answers would be given for nobody.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gn0.bench.metrics import straight_to_goal
from gn0.errors import ConfigError
from gn0.missions.controls import Control, check_control, choose_texts
from gn0.missions.episode import Episode, mission_name
from gn0.paper import SUCCESS_RADIUS
from gn0.policies.bae.policy_settings import MAPS, SQUARE_NAMES
from gn0.progress import Progress, no_progress
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.ego_map import MapView
from gn0.training.exams.turns import Turns
from gn0.training.exams.walkers import AskedAgents, Walkers, take_tensor
from gn0.training.exams.walks import Walk
from gn0.training.streams.live_counts import COUNTED, LiveCounts
from gn0.training.streams.stream_live import STOP_DISTANCE

NEAR = 1.0  # m on foot: the stricter radius


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
        asks: how often all were asked so far.
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
        self.asks, self.counts = 0, LiveCounts()
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

    def begin(self, which: NDArray[np.int64], episodes: Sequence[Episode]) -> None:
        """Agents `which` begin these: what remembers forgets; others need not be told."""
        del which, episodes

    def play(
        self,
        episodes: Sequence[int] | None = None,
        *,
        control: Control = "none",
        seed: int = 0,
        keep: Callable[[list[Walk]], None] | None = None,
        progress: Progress = no_progress,
    ) -> list[Walk]:
        """Play episodes once each; who has come to an end begins the next one.

        Args:
            episodes: numbers among `env.tasks.episodes`; all when None.
            control: what is taken away: the text for another one of the same scene (shuffled), or
                for `go` (no_words); pictures are black (no_pictures).
            seed: of the shuffling.
            keep: is given walks while others go on, as they come to an end.
            progress: is told how many walks there are.

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
        self.counts = LiveCounts()
        walks: dict[int, Walk] = {}
        if wanted:
            for some in self._walk(wanted, texts, control == "no_pictures", progress):
                walks |= some
                if keep is not None:
                    keep(list(some.values()))
        return [walks[k] for k in range(len(wanted))]

    def _walk(
        self, wanted: list[int], texts: Tensor, dark: bool, progress: Progress
    ) -> Iterator[dict[int, Walk]]:
        """Walks as they come to an end, by place among `wanted`."""
        env, tasks, begun = self.env, self.env.tasks.episodes, time.perf_counter()
        turns = Turns(wanted, env.num_envs)
        env.mute(*self._unseen)
        seen, infos = env.reset(seed=0, options={"episode": turns.numbers.tolist()})
        self.begin(np.arange(env.num_envs), [tasks[number] for number in turns.numbers])
        walkers = Walkers(infos, self.actions, self.executed, self.device)
        walkers.done |= torch.from_numpy(~turns.counted).to(self.device)
        steps = 0
        progress("walking", 0, len(wanted))
        while True:
            if steps % self.executed == 0:
                over = turns.list_over(walkers.done.cpu().numpy())
                if turns.is_due(over):
                    now = time.perf_counter()
                    episodes = [tasks[number] for number in turns.numbers[over]]
                    walks = self._score_ended(walkers, over, episodes, now - begun)
                    begun = now
                    yield dict(zip(turns.end(over), walks, strict=True))
                    progress("walking", turns.ended, len(wanted))
                    seated = turns.seat(over)
                    if not turns.counted.any():
                        break
                    if len(seated):
                        mask = np.isin(np.arange(env.num_envs), seated)
                        seen, infos = env.reset(
                            options={"episode": turns.numbers.tolist(), "reset_mask": mask}
                        )
                        self.begin(seated, [tasks[number] for number in turns.numbers[seated]])
                        walkers.seat(infos, torch.from_numpy(mask).to(self.device))
            self._ask(walkers, seen, texts, dark, steps)
            action = walkers.choose()
            if self.labelled:
                walkers.judge(action, take_tensor(env.labels(STOP_DISTANCE).actions)[:, 0])
            steps += 1
            if not self.confirm_stop:  # what nobody looks at is not drawn
                env.mute(*(self._idle if steps % self.executed else self._unseen))
            seen, _, terminated, _, infos = env.step(action.to(torch.uint8))
            walkers.follow(action, seen, terminated, infos)
        env.synchronize()

    def _ask(self, walkers: Walkers, seen: Any, texts: Tensor, dark: bool, steps: int) -> None:
        """Decide anew for those who are at an end of what they were told."""
        asked = walkers.asked(self.confirm_stop)
        # without confirming, all agents are asked at once: the host need not look
        due = asked & ~walkers.done
        if not (bool(due.any()) if self.confirm_stop else steps % self.executed == 0):
            return
        shown = self._show(seen, walkers.own, walkers.pose, dark)
        agents = AskedAgents(
            texts[walkers.own], walkers.own, walkers.pose, walkers.last, walkers.hit,
            walkers.idle, due,
        )  # fmt: skip
        walkers.hear(self.decide(shown, agents), asked)
        self.asks += 1

    def _score_ended(
        self,
        walkers: Walkers,
        which: NDArray[np.int64],
        episodes: Sequence[Episode],
        seconds: float,
    ) -> list[Walk]:
        """What agents `which` have done in the episodes that they have ended."""
        self.env.synchronize()
        rows = torch.from_numpy(which).to(self.device)
        found = {name: values[rows].cpu().numpy() for name, values in walkers.book.items()}
        found["seconds"] = np.full(len(which), seconds / max(len(which), 1))
        walks = [
            _score(episode, {name: values[k] for name, values in found.items()})
            for k, episode in enumerate(episodes)
        ]
        if self.labelled:
            sums = {name: int(found[name].sum()) for name in set(COUNTED) & set(found)}
            steps = int(found["steps"].sum())
            arrived = sum(walk.success for walk in walks)
            sums |= {"steps": steps, "asked": steps, "ended": len(walks), "arrived": arrived}
            self.counts += LiveCounts(**sums)
        return walks

    def _show(self, seen: Any, episode: Tensor, pose: Tensor, dark: bool) -> list[Tensor]:
        """Pictures of the prompt, in its order."""
        squares = dict(
            zip(SQUARE_NAMES, self.view.split(take_tensor(seen["ego_map"])), strict=False)
            if "ego_map" in seen
            else ()
        )
        made = squares | self._draw_whole(episode, pose)
        shown = [made[n] if n in made else take_tensor(seen[n]) for n in self.pictures]
        return [torch.zeros_like(one) for one in shown] if dark else shown

    def _draw_whole(self, episode: Tensor, pose: Tensor) -> dict[str, Tensor]:
        """Whole maps of those that are shown, by name."""
        del episode, pose
        return {}


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
