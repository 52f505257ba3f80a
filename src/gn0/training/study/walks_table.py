"""Walks of a policy as a table of its model card, with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gn0.errors import TrainingError
from gn0.missions.controls import CONTROLS
from gn0.training.exams.walks import Walk, summarise_walks
from gn0.training.exams.walks_folder import WalksAbout, load_walks
from gn0.training.study.crossed_intervals import estimate_mean

_HEAD = """Walks of `gn0 policy examine`, evenly over the suite; in brackets the 95 % interval over
homes of this one policy:

| walks | missions | episodes | homes | SR % | SPL % | OS % | SR 1 m % | NE m | cut short % |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
"""


def build_walks_table(folders: Sequence[Path | str], weights: str = "") -> str:
    """Markdown of walks; a row a folder and mission kind.

    Args:
        folders: of finished walks, as `gn0 policy examine` writes.
        weights: digest of the policy whose walks they must be (`digest_checkpoint`); "": any.

    Returns:
        the table; empty without folders.

    Raises:
        TrainingError: a folder holds no finished walks, or those of another policy.
        StorageError, FormatError: it cannot be read, or is damaged.
    """
    if not folders:
        return ""
    lines, said = [], []
    for folder in folders:
        about, walks = load_walks(folder)
        if weights and about.weights != weights:
            raise TrainingError(
                "walks of another policy",
                where=folder,
                remedy="give walks of the policy that is packed, with these weights",
            )
        name = _name(about)
        lines += [f"| {name} | {_row(kind, some)} |" for kind, some in _group(about, walks)]
        said.append(_tell(name, about))
    return f"{_HEAD}{chr(10).join(lines)}\n\n{chr(10).join(said)}\n"


def _group(about: WalksAbout, walks: Sequence[Walk]) -> Iterator[tuple[str, Sequence[Walk]]]:
    """All walks, and without a control those of each kind of missions, too."""
    yield "all", walks
    if about.control != CONTROLS[0]:
        return
    for kind in sorted({walk.kind for walk in walks}):
        yield kind, [walk for walk in walks if walk.kind == kind]
    visible = [walk for walk in walks if walk.tier]
    if visible:
        yield visible[0].tier, visible


def _name(about: WalksAbout) -> str:
    parts = [about.suite, "+".join(about.splits) or "all splits", about.inputs]
    return " ".join(part for part in parts if part) + (
        "" if about.control == CONTROLS[0] else f", {about.control}"
    )


def _tell(name: str, about: WalksAbout) -> str:
    drawn = f"drawn after {about.draw_after} that lead nowhere" if about.draw_after else "not drawn"
    asked = ", STOPs asked again" if about.confirm_stop else ""
    return (
        f"* {name}: suite {about.suite_hash[:12]}, {about.executed} actions of an answer{asked}, "
        f"answers {drawn}, {about.dtype} on {about.device}"
    )


def _row(kind: str, walks: Sequence[Walk]) -> str:
    means = summarise_walks(walks)["all"]
    homes = [walk.scene for walk in walks]
    rate = estimate_mean(np.array([float(walk.success) for walk in walks]), homes, name=kind)
    shares = [f"{100 * means[name]:.1f}" for name in ("SPL", "OS", "SR_1m")]
    low, high = max(0.0, rate.low), min(1.0, rate.high)  # of few walks it reaches beyond
    span = f"{100 * rate.value:.1f} [{100 * low:.1f} to {100 * high:.1f}]"
    numbers = [kind, f"{len(walks)}", f"{len(set(homes))}", span, *shares, f"{means['NE']:.2f}"]
    return " | ".join([*numbers, f"{100 * means['cut_short']:.1f}"])
