"""The model card of a policy that DAPO trained: how it came to be, in a page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

TERMS = {
    "trajectory": "where the plan leads, and the waypoints where there are some: 0 to 1",
    "first": "a right first action",
    "collision": "share of FORWARDs that are cut short",
    "length": "plans that stop too early or too late",
    "format": "an answer that cannot be read, which scores nothing else",
}
_SHOWN = ("SR", "SPL", "first_action", "stop_recall", "stop_precision", "cut_short", "entropy")


def describe_policy(
    recipe: Mapping[str, Any],
    hashes: Mapping[str, str],
    before: Mapping[str, float],
    after: Mapping[str, float],
) -> str:
    """A card in Markdown.

    Args:
        recipe: of the run, as `describe_recipe` gives it.
        hashes: of corpus and start.
        before: what was measured before the first step.
        after: and at the end.
    """
    reward = recipe["rollout"]["reward"]
    lines = [
        "---", "license: apache-2.0", "---", "",
        "# A navigation policy, trained by DAPO on where its answers lead", "",
        f"Began from `{recipe['start']}` ({hashes['start']}); "
        f"learned in {', '.join(f'`{one}`' for one in recipe['suites'])} ({hashes['corpus']}).", "",
        f"{recipe['states']:,} states of the {recipe['walks']}'s walks, {recipe['epochs']} epochs, "
        f"{recipe['prompts']} prompts × {recipe['rollout']['answers']} answers a rollout, "
        f"{recipe['minibatches']} minibatches, rate {recipe['recipe']['rate']:g}, "
        f"clips {recipe['low']:g} and {recipe['high']:g}, seed {recipe['seed']}. "
        "The vision tower was frozen.", "",
        "| term of the reward | weight | |", "| --- | --- | --- |",
    ]  # fmt: skip
    for name, meaning in TERMS.items():
        sign = "−" if name in ("collision", "length", "format") else ""
        weight = "1" if name == "trajectory" else f"{sign}{reward[name]:g}"
        lines.append(f"| `{name}` | {weight} | {meaning} |")
    lines += [
        "",
        f"Scales: {reward['position_scale']:g} m of poses, {reward['waypoint_scale']:g} m of "
        "waypoints.",
    ]
    shown = [name for name in _SHOWN if name in after]
    if shown:
        lines += ["", "| held out | before | after |", "| --- | --- | --- |"]
        lines += [
            f"| {name} | {_tell(before.get(name))} | {_tell(after[name])} |" for name in shown
        ]
    lines += [
        "", "What it is shown and asked is in `policy.json`; all settings of the run:", "",
        "```json", json.dumps(recipe, indent=1, ensure_ascii=False), "```", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _tell(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"
