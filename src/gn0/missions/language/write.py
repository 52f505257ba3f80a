"""Texts for a route: requested, checked, and written by the grammar where the check fails."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

from gn0.errors import LanguageError
from gn0.missions.language.providers import TextProvider
from gn0.missions.language.route import STYLES, InstructionText, RouteDescription, Style
from gn0.missions.language.template import ProviderTemplate
from gn0.missions.language.text_check import check_text
from gn0.progress import Progress, no_progress

_KINDS = (
    (r"check: turns are", "turns"),
    (r"unknown landmark", "landmark"),
    (r"the target .* named", "target"),
    (r"is not on the (?:left|right)", "side"),
    (r"it tells a|it counts in|no distance of the route", "distance"),
    (r": check: ", "form"),
    (r"the budget of", "budget"),
    (r"was given up", "server given up"),
    (r"the answer (?:is not|has not)", "answer"),
    (r"was not recorded", "not recorded"),
    (r"no answer within", "timeout"),
    (r"the server answered 429", "busy"),
)
_TRIES = 8  # seeds the grammar may take until its own text passes


def write_texts(
    route: RouteDescription,
    provider: TextProvider,
    *,
    styles: Sequence[Style] = STYLES,
    seed: int = 0,
    held_out: bool = False,
) -> dict[Style, InstructionText]:
    """A checked text of each style.

    A text that fails the check, or that the provider could not give, is written by `template`
    instead; `fallback` then says why.

    Args:
        route: what to describe.
        provider: who writes.
        styles: which styles.
        seed: seed of the choice of words.
        held_out: use only the skeletons kept for unseen splits; of no effect on a language model.
    """
    return {style: _write(route, provider, style, seed, held_out) for style in styles}


def write_texts_many(
    routes: Iterable[RouteDescription],
    provider: TextProvider,
    *,
    styles: Sequence[Style] = STYLES,
    seed: int = 0,
    held_out: bool = False,
    progress: Progress = no_progress,
) -> list[dict[Style, InstructionText]]:
    """`write_texts` for many routes, as many at once as the provider allows; in their order."""
    todo = list(routes)
    out: list[dict[Style, InstructionText]] = []

    def one(route: RouteDescription) -> dict[Style, InstructionText]:
        return write_texts(route, provider, styles=styles, seed=seed, held_out=held_out)

    if provider.concurrency <= 1 or len(todo) <= 1:
        for route in todo:
            out.append(one(route))
            progress("writing instructions", len(out), len(todo))
        return out
    with ThreadPoolExecutor(provider.concurrency) as pool:
        for texts in pool.map(one, todo):
            out.append(texts)
            progress("writing instructions", len(out), len(todo))
    return out


def fallback_kind(fallback: str) -> str:
    """What kind of failure a `fallback` reports, for counting; "" for none.

    One of turns, landmark, target, side, distance, form (the check), answer (not as asked),
    timeout, busy, server, server given up, budget, not recorded.
    """
    if not fallback:
        return ""
    return next((kind for pattern, kind in _KINDS if re.search(pattern, fallback)), "server")


def _write(
    route: RouteDescription, provider: TextProvider, style: Style, seed: int, held_out: bool
) -> InstructionText:
    if isinstance(provider, ProviderTemplate):
        return _by_grammar(route, style, seed, held_out, "")
    try:
        text = provider.write(route, style, seed=seed, held_out=held_out)
    except LanguageError as error:
        return _by_grammar(route, style, seed, held_out, f"{provider.name}: {error.what}")
    faults = check_text(text, route, style)
    if faults:
        return _by_grammar(
            route, style, seed, held_out, f"{provider.name}: check: {'; '.join(faults)}"
        )
    return InstructionText(style=style, text=text, provider=provider.name, version=provider.version)


def _by_grammar(
    route: RouteDescription, style: Style, seed: int, held_out: bool, why: str
) -> InstructionText:
    provider = ProviderTemplate()
    text, faults = "", ["nothing written"]
    for attempt in range(_TRIES):
        text = provider.write(route, style, seed=seed + attempt, held_out=held_out)
        faults = check_text(text, route, style)
        if not faults:
            break
    else:
        raise LanguageError(
            f"the grammar's own {style} text fails its check: {'; '.join(faults)}: {text!r}",
            where=f"scene {route.scene_id!r}",
            remedy="report this route; it is a fault of gn0",
        )
    return InstructionText(
        style=style, text=text, provider=provider.name, version=provider.version, fallback=why
    )
