"""`Walkers`: agents that play episodes to be judged, as a policy and the judge know them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gn0.sim.state import Action

_COUNTS = ("steps", "forwards", "cut_short", "decisions", "agreed", "due", "stopped_right")


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


class Walkers:
    """N agents on their way: what they were told, and what is counted of them, on their device.

    Args:
        infos: of the reset.
        actions: A of a decision.
        executed: of them, that are carried out.
        device: of all this.

    Attributes:
        own: int64 [N] episodes. pose: float64 [N, 3].
        last: int64 [N] actions before; -1 where an episode begins. hit: whether it was cut short.
        idle: int64 [N] actions since they got anywhere.
        done: bool [N], whose episode is over; the one after it is nobody's.
        book: what was counted since the episode began, by name, [N] each.
    """

    def __init__(
        self, infos: Mapping[str, Any], actions: int, executed: int, device: torch.device
    ) -> None:
        self._executed = executed
        self._find(infos)
        zeros = torch.zeros_like(self.own)
        self.done = zeros.bool()
        self.last, self.hit, self.idle = zeros - 1, zeros.bool(), zeros.clone()
        self._at = zeros + executed
        self._plan = torch.zeros((len(zeros), actions), dtype=torch.int64, device=device)
        self.book = {name: zeros.double() for name in ("shortest", "least", "left", "length")}
        self.book |= {"stopped": zeros.bool(), "place": zeros.double()[:, None].repeat(1, 2)}
        self.book |= {name: zeros.clone() for name in _COUNTS}
        self.seat(infos, ~self.done)

    def seat(self, infos: Mapping[str, Any], which: Tensor) -> None:
        """Agents `which`, bool [N], begin another episode."""
        self._find(infos)
        distance = take_tensor(infos["distance_to_goal"])
        begun = dict.fromkeys(("shortest", "least", "left"), distance)
        for name, values in self.book.items():
            if name == "place":
                self.book[name] = torch.where(which[:, None], self.pose[:, :2], values)
            else:
                self.book[name] = torch.where(which, begun.get(name, 0), values).to(values.dtype)
        self.done = self.done & ~which
        self.last = torch.where(which, -1, self.last)
        self.hit = self.hit & ~which
        self.idle = torch.where(which, 0, self.idle)
        self._at = torch.where(which, self._executed, self._at)

    def _find(self, infos: Mapping[str, Any]) -> None:
        self.own = take_tensor(infos["episode"]).long().clone()
        self.pose = take_tensor(infos["pose"]).clone()

    def choose(self) -> Tensor:
        """The next action of each, int64 [N]."""
        action = self._plan.gather(1, self._at[:, None])[:, 0]
        self._at = self._at + 1
        return action

    def asked(self, confirm_stop: bool) -> Tensor:
        """Who is asked now, bool [N]; where STOPs are confirmed, before a later one, too."""
        asked = self._at >= self._executed
        if confirm_stop:
            next_up = self._plan.gather(1, self._at.clamp(max=self._plan.shape[1] - 1)[:, None])
            asked = asked | (self._at > 0) & (next_up[:, 0] == Action.STOP)
        return asked

    def hear(self, said: Tensor, asked: Tensor) -> None:
        """Those who were asked follow what was said, int64 [N, A]."""
        self._plan = torch.where(asked[:, None], said, self._plan)
        self._at = torch.where(asked, 0, self._at)
        self.book["decisions"] += asked & ~self.done

    def judge(self, action: Tensor, expert: Tensor) -> None:
        """Hold actions [N] against the expert's."""
        stopped, due = ~self.done & (action == Action.STOP), ~self.done & (expert == Action.STOP)
        self.book["agreed"] += ~self.done & (action == expert)
        self.book["due"] += due
        self.book["stopped_right"] += stopped & due

    def follow(
        self, action: Tensor, seen: Mapping[str, Any], terminated: Any, infos: Mapping[str, Any]
    ) -> None:
        """Count what came of actions [N]."""
        book, final = self.book, infos["final_info"]
        ended = take_tensor(infos["_final_info"]).bool()
        there = torch.where(ended[:, None], take_tensor(final["pose"]), take_tensor(infos["pose"]))
        left = torch.where(
            ended, take_tensor(final["distance_to_goal"]), take_tensor(infos["distance_to_goal"])
        )
        cut = torch.where(
            ended, take_tensor(infos["final_obs"]["collided"]), take_tensor(seen["collided"])
        ).bool()
        live = ~self.done
        book["steps"] += live
        book["length"] += live * torch.linalg.vector_norm(there[:, :2] - self.pose[:, :2], dim=-1)
        book["least"] = torch.where(live, torch.minimum(book["least"], left), book["least"])
        book["left"] = torch.where(live, left, book["left"])
        book["place"] = torch.where(live[:, None], there[:, :2], book["place"])
        book["forwards"] += live & (action == Action.FORWARD)
        book["cut_short"] += live & (action == Action.FORWARD) & cut
        book["stopped"] |= live & take_tensor(terminated).bool()
        self.done = self.done | ended
        # whoever ended is in another episode, which nobody counts
        self._find(infos)
        self.last = torch.where(ended, -1, action)
        self.hit = cut & ~ended
        still = ended | ((action == Action.FORWARD) & ~cut)
        self.idle = torch.where(still, 0, self.idle + 1)


def take_tensor(array: Any) -> Tensor:
    """What a device array holds, not copied."""
    found: Tensor = torch.from_dlpack(array)
    return found
