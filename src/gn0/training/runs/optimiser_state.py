"""What an optimiser remembers, by the names of its parameters, and the same put back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from gn0.errors import CheckpointError, brief

# how an optimiser computes is its owner's choice, made again where a run goes on
_HOW = ("params", "fused", "foreach", "capturable", "differentiable")


@dataclass(frozen=True)
class OptimiserState:
    """What a torch optimiser remembers.

    Attributes:
        kind: its class, e.g. "AdamW".
        groups: of each group of parameters the settings (`lr`, `betas` …) and, as `names`, the
            parameters' names.
        arrays: "KEY/PARAMETER" → tensor; KEY is `step`, `exp_avg`, `exp_avg_sq` for AdamW.
    """

    kind: str
    groups: tuple[Mapping[str, Any], ...]
    arrays: Mapping[str, Tensor]


def capture_optimiser(
    optimiser: torch.optim.Optimizer, named: Iterable[tuple[str, Tensor]]
) -> OptimiserState:
    """What an optimiser remembers now; tensors are its own, so save them before its next step.

    Args:
        optimiser: of tensors as its states.
        named: its parameters by name, as `Module.named_parameters` gives them.

    Raises:
        CheckpointError: a parameter of the optimiser has no name.
    """
    names = {id(array): name for name, array in named}
    groups, arrays = [], {}
    for group in optimiser.param_groups:
        for array in group["params"]:
            if id(array) not in names:
                raise CheckpointError(
                    f"the optimiser has a parameter {tuple(array.shape)} without a name",
                    remedy="name all parameters of the optimiser",
                )
            for key, value in optimiser.state.get(array, {}).items():
                arrays[f"{key}/{names[id(array)]}"] = torch.as_tensor(value)
        settings = {key: _plain(value) for key, value in group.items() if key not in _HOW}
        groups.append(settings | {"names": [names[id(array)] for array in group["params"]]})
    return OptimiserState(type(optimiser).__name__, tuple(groups), arrays)


def restore_optimiser(
    optimiser: torch.optim.Optimizer,
    state: OptimiserState,
    named: Iterable[tuple[str, Tensor]],
) -> None:
    """Make an optimiser of the same parameters remember what another did, settings included.

    Raises:
        CheckpointError: it is another optimiser, or one of other parameters.
    """
    kind = type(optimiser).__name__
    if kind != state.kind:
        raise CheckpointError(
            f"the state is that of {state.kind}, the optimiser is {kind}",
            remedy="resume with the recipe of the run, or from weights alone",
        )
    names = {id(array): name for name, array in named}
    ours = [[names.get(id(array), "") for array in g["params"]] for g in optimiser.param_groups]
    theirs = [list(group["names"]) for group in state.groups]
    if ours != theirs:
        odd = sorted({n for g in ours for n in g} ^ {n for g in theirs for n in g})
        what = f"the first without a fellow is {brief(odd[0])}" if odd else "their order differs"
        raise CheckpointError(
            f"the optimiser's groups of parameters are not those of its state: {what}",
            remedy="resume with the recipe of the run, or from weights alone",
        )
    remembered: dict[str, dict[str, Tensor]] = {}
    for place, array in state.arrays.items():
        key, _, name = place.partition("/")
        remembered.setdefault(name, {})[key] = array
    kept: dict[int, dict[str, Tensor]] = {}
    groups: list[dict[str, Any]] = []
    number = 0
    for group, saved in zip(optimiser.param_groups, state.groups, strict=True):
        numbers = range(number, number + len(group["params"]))
        number = numbers.stop
        for k, (name, array) in zip(
            numbers, zip(saved["names"], group["params"], strict=True), strict=True
        ):
            if name not in remembered:
                continue
            kept[k] = remembered[name]
            wrong = [v for key, v in kept[k].items() if key != "step" and v.shape != array.shape]
            if wrong:
                raise CheckpointError(
                    f"{tuple(wrong[0].shape)} is remembered of {brief(name)} "
                    f"of shape {tuple(array.shape)}",
                    remedy="the state is that of another model",
                )
        own = {key: value for key, value in group.items() if key != "params"}
        settings = {key: _like(value, own.get(key)) for key, value in saved.items()}
        settings.pop("names")
        groups.append({**own, **settings, "params": list(numbers)})
    optimiser.load_state_dict({"state": kept, "param_groups": groups})


def _plain(value: Any) -> Any:
    """A setting as JSON has it."""
    if isinstance(value, Tensor):
        return value.item()
    return list(value) if isinstance(value, tuple) else value


def _like(value: Any, own: Any) -> Any:
    """A setting from JSON in the form that the optimiser has: a tensor stays the same tensor."""
    if isinstance(own, Tensor):
        return own.fill_(value)
    return tuple(value) if isinstance(value, list) else value
