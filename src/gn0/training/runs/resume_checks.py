"""Whether a run may go on from a state, and what is then no longer exact."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from gn0.errors import CheckpointError
from gn0.training.runs.recipe_text import list_recipe_differences
from gn0.training.runs.training_state import TrainingState, list_versions


def check_resume(
    state: TrainingState,
    *,
    recipe: Mapping[str, Any],
    corpus: str,
    device: str,
    free: Collection[str] = (),
    exact: bool = False,
) -> tuple[str, ...]:
    """Make sure that a run of this recipe, corpus and device goes on from a state of its own.

    Args:
        state: as loaded.
        recipe: as `describe_recipe` gives it.
        corpus: hash of what will be learned from.
        device: what the run will be on, as `name_device` says it.
        free: fields of the recipe that may differ, such as the number of steps.
        exact: the run must go on to the bit.

    Returns:
        What differs and is allowed, each in a line to be shown and logged.

    Raises:
        CheckpointError: another recipe or corpus; with `exact`, whatever else changes a bit.
    """
    if corpus != state.corpus:
        raise CheckpointError(
            f"the state learned from {state.corpus}, this is {corpus}",
            remedy="give the dataset or corpus of the run, or start a new run from its weights",
        )
    held, allowed = list_recipe_differences(state.recipe, recipe, free)
    if held:
        raise CheckpointError(
            f"the state is that of another recipe: {'; '.join(held)}",
            remedy="resume with the recipe of the run, or start a new run from its weights",
        )
    inexact: list[str] = []
    if state.optimiser is None:
        inexact.append("the optimiser was left behind: it begins anew and is warmed again")
    if device != state.device:
        inexact.append(f"saved on {state.device}, resumed on {device}: not the same bits")
    ours = list_versions()
    for name, version in state.versions.items():
        if ours.get(name) != version:
            now = ours.get(name, "absent")
            inexact.append(f"saved with {name} {version}, resumed with {now}: not the same bits")
    if exact and inexact:
        raise CheckpointError(
            f"not to be resumed exactly: {'; '.join(inexact)}",
            remedy="resume where it was saved, or without exactness",
        )
    return (*inexact, *(f"recipe: {text}" for text in allowed))
