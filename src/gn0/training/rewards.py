"""The reward of DAPO (paper, l. 847): how good an answer is, by where its actions lead.

    R = R_traj + 0.5 R_first − 0.5 R_col − 0.2 R_len − 2 R_fmt

Plain functions of N answers side by side. The paper prints neither the weights nor the shape of
R_traj; both are ours. Both plans are carried out from the same state, see `plan_walker.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated

import msgspec
import numpy as np
import torch
from torch import Tensor

from gn0.config import Config
from gn0.data.answer_form import AnswerForm
from gn0.data.answer_slots import END, AnswerSlots
from gn0.data.codec import EgoFrame
from gn0.errors import FormatError
from gn0.paper import FORWARD, STOP
from gn0.policies.bae.questions import list_allowed

Weight = Annotated[float, msgspec.Meta(ge=0)]
Scale = Annotated[float, msgspec.Meta(gt=0)]


class RewardWeights(Config, frozen=True):
    """What the terms weigh.

    Attributes:
        first: of a right first action.
        collision: of FORWARDs that are cut short.
        length: of plans that stop too early or too late.
        format: of an answer that cannot be read, which scores nothing else.
        position_scale: distance of executed poses at which their term falls to 1/e [m].
        waypoint_scale: the same of waypoints [m].
    """

    first: Weight = 0.5
    collision: Weight = 0.5
    length: Weight = 0.2
    format: Weight = 2.0
    position_scale: Scale = 0.5
    waypoint_scale: Scale = 0.3


@dataclass(frozen=True)
class PlanWalks:
    """Where N plans of A actions led.

    Attributes:
        poses: float64 [N, A, 3] x, y [m], yaw [rad] behind each action; from a STOP on the place
            where it was said.
        cut: bool [N, A] FORWARDs that were cut short; none behind a STOP.
    """

    poses: Tensor
    cut: Tensor

    def pick(self, rows: Tensor | slice) -> PlanWalks:
        """Some of them."""
        return PlanWalks(self.poses[rows], self.cut[rows])


@dataclass(frozen=True)
class Rewards:
    """Rewards float64 [N] and their terms; an answer that cannot be read has 0 in all but two.

    Attributes:
        total: R.
        trajectory: R_traj, 0 to 1: the task, from which the rest is shaped.
        first: R_first, 0 or 1.
        collision: R_col, 0 to 1.
        length: R_len, 0 to 1.
        format: R_fmt, 0 or 1.
    """

    total: Tensor
    trajectory: Tensor
    first: Tensor
    collision: Tensor
    length: Tensor
    format: Tensor

    def means(self) -> dict[str, Tensor]:
        """Means by name, scalars on the device."""
        names = {"total": "reward"}
        return {names.get(f.name, f"reward_{f.name}"): getattr(self, f.name).mean()
                for f in fields(self)}  # fmt: skip


def score_answers(
    said: PlanWalks,
    wanted: PlanWalks,
    actions: Tensor,
    wanted_actions: Tensor,
    readable: Tensor,
    *,
    waypoints: Tensor | None = None,
    wanted_waypoints: Tensor | None = None,
    weights: RewardWeights | None = None,
) -> Rewards:
    """Rewards of N answers.

    Args:
        said: where their actions led.
        wanted: where the reference's led from the same states.
        actions: [N, A] codes 0 to 3.
        wanted_actions: [N, A] of the reference.
        readable: bool [N] whether the strict parser reads them.
        waypoints: [N, K, 2] m in the agent's frame, without the agent's own place, where the
            answers have some.
        wanted_waypoints: [N, K, 2] m of the reference.
        weights: of the terms; the defaults when None.
    """
    weights = weights or RewardWeights()
    trajectory = compare_poses(said.poses, wanted.poses, weights.position_scale)
    if waypoints is not None and wanted_waypoints is not None and waypoints.shape[1]:
        way = compare_waypoints(waypoints, wanted_waypoints, weights.waypoint_scale)
        trajectory = (trajectory + way) / 2
    first = (actions[:, 0] == wanted_actions[:, 0]).double()
    collision = share_cut_short(actions, said.cut)
    length = (count_steps(actions) - count_steps(wanted_actions)).abs() / actions.shape[1]
    terms = [torch.where(readable, one, 0.0) for one in (trajectory, first, collision, length)]
    trajectory, first, collision, length = terms
    refused = (~readable).double()
    total = trajectory + weights.first * first - weights.collision * collision
    total = total - weights.length * length - weights.format * refused
    return Rewards(total, trajectory, first, collision, length, refused)


def compare_poses(said: Tensor, wanted: Tensor, scale: float) -> Tensor:
    """½ exp(−mean distance / scale) + ½ mean (1 + cos of the turn between) / 2: float64 [N].

    Args:
        said: [N, A, 3] x, y [m], yaw [rad].
        wanted: [N, A, 3].
        scale: [m].
    """
    off = torch.linalg.vector_norm(said[..., :2] - wanted[..., :2], dim=-1).mean(-1)
    facing = (1 + torch.cos(said[..., 2] - wanted[..., 2])).mean(-1) / 2
    return (torch.exp(-off / scale) + facing).double() / 2


def compare_waypoints(said: Tensor, wanted: Tensor, scale: float) -> Tensor:
    """exp(−mean distance / scale) of waypoints [N, K, 2] m: float64 [N]."""
    off = torch.linalg.vector_norm((said - wanted).double(), dim=-1).mean(-1)
    return torch.exp(-off / scale)


def count_steps(actions: Tensor) -> Tensor:
    """Actions before the first STOP of plans [N, A]: float64 [N]; A without one."""
    return (actions != STOP).long().cumprod(1).sum(1).double()


def share_cut_short(actions: Tensor, cut: Tensor) -> Tensor:
    """Share of the FORWARDs before a STOP that were cut short: float64 [N]; 0 without any."""
    done = (actions != STOP).long().cumprod(1).bool()
    walked = ((actions == FORWARD) & done).sum(1)
    return (cut & done).sum(1).double() / walked.clamp(min=1)


def tabulate_readable(slots: AnswerSlots, frame: EgoFrame) -> Tensor:
    """Which tokens may stand in each slot of an answer that is read: bool [S, vocabulary]."""
    table = torch.zeros((len(slots), slots.vocabulary.size), dtype=torch.bool)
    for slot, allowed in enumerate(list_allowed(slots, frame)):
        table[slot, torch.from_numpy(allowed)] = True
    return table


def find_readable(
    slots: AnswerSlots, frame: EgoFrame, ids: Tensor, table: Tensor | None = None
) -> Tensor:
    """Whether `AnswerSlots.decode` reads answers int64 [N, S]: bool [N]; point 0 must be right.

    Args:
        slots: of the answers.
        frame: the square that their coordinates are on.
        ids: with room behind the slots or without.
        table: of `tabulate_readable`, on the device of the ids; made when None.
    """
    if table is None:
        table = tabulate_readable(slots, frame).to(ids.device)
    at = torch.arange(len(slots), device=ids.device)
    return table[at, ids[:, : len(slots)]].all(1)


def punish_length(mask: Tensor, wanted: int, room: int) -> Tensor:
    """DAPO's soft punishment of answers [N, S] longer than `wanted` tokens: float64 [N], 0 to 1.

    It grows evenly over the `room` behind; no room, no punishment.
    """
    over = (mask.sum(1) - wanted).clamp(min=0).double()
    return over / room if room else over * 0


def find_spoken(slots: AnswerSlots, ids: Tensor) -> Tensor:
    """Tokens bool [N, S] of answers up to their first end token; all where there is none."""
    if slots.vocabulary.end is None or END not in slots.kinds:
        return torch.ones_like(ids, dtype=torch.bool)
    over = (ids == slots.vocabulary.end).long()
    return over.cumsum(1) - over == 0


def read_texts(
    form: AnswerForm, texts: Sequence[str], current: Sequence[int] | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Texts of a form, for trainers that give no ids.

    Args:
        form: of the answers.
        texts: N of them.
        current: map tokens (x, y) of where the agent stands; needed by compact answers.

    Returns:
        actions int64 [N, A], map tokens int64 [N, P, 2] (0 where unreadable), readable bool [N].
    """
    actions = np.zeros((len(texts), form.actions), np.int64)
    tokens = np.zeros((len(texts), form.points, 2), np.int64)
    readable = np.zeros(len(texts), np.bool_)
    for row, text in enumerate(texts):
        try:
            answer = form.read(text, current)
        except FormatError:
            continue
        actions[row], readable[row] = answer.actions, True
        if answer.tokens is not None:
            tokens[row] = answer.tokens
    return torch.from_numpy(actions), torch.from_numpy(tokens), torch.from_numpy(readable)
