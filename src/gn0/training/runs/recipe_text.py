"""Recipes and commands as they may be written down: plain, and without secrets."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import msgspec

from gn0.config import Config
from gn0.errors import brief
from gn0.plugins import SECRETS

HIDDEN = "(not kept)"
_ABSENT = "(absent)"
_WORD = re.compile(r"[-_.\s]+")


def describe_recipe(recipe: Config) -> dict[str, Any]:
    """A recipe as JSON has it; what looks like a secret is not kept.

    A field that the recipe declares is a secret when it is a text and a word of its name says so
    (`hub_token`, not `tokenizer`); a key of a table, which a user may have made up, when its name
    holds such a word anywhere, as elsewhere in GN0.
    """
    plain = _hide(recipe)
    described: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(plain, enc_hook=str))
    return described


def _hide(value: Any) -> Any:
    if isinstance(value, msgspec.Struct):
        fields = {name: getattr(value, name) for name in value.__struct_fields__}
        return {
            name: HIDDEN if isinstance(one, str) and one and _says_secret(name) else _hide(one)
            for name, one in fields.items()
        }
    if isinstance(value, Mapping):
        return {
            name: HIDDEN if any(word in str(name).lower() for word in SECRETS) else _hide(one)
            for name, one in value.items()
        }
    if isinstance(value, list | tuple | set | frozenset):
        return [_hide(one) for one in value]
    return value


def _says_secret(name: str) -> bool:
    words = _WORD.split(name.lower())
    return any(word in words for word in SECRETS) or "api_key" in name.lower().replace("-", "_")


def describe_command(words: Sequence[str]) -> list[str]:
    """A command line without its secrets: values of `--api-key X`, `--api-key=X`, `api_key=X`."""
    shown: list[str] = []
    hidden_next = False
    for word in words:
        name, equal, _ = word.partition("=")
        flag = name.startswith("--")
        secret = _says_secret(name) if flag else any(one in name.lower() for one in SECRETS)
        if hidden_next and not flag:
            shown.append(HIDDEN)
        else:
            shown.append(f"{name}={HIDDEN}" if equal and secret else word)
        hidden_next = flag and secret and not equal
    return shown


def list_recipe_differences(
    then: Mapping[str, Any], now: Mapping[str, Any], free: Collection[str] = ()
) -> tuple[list[str], list[str]]:
    """Fields in which two described recipes differ, in words.

    Args:
        then: of the run.
        now: of who wants to go on.
        free: fields that may differ.

    Returns:
        Those that may not differ, and those that may.
    """
    held: list[str] = []
    free_ones: list[str] = []
    for name in sorted({*then, *now}):
        before, after = then.get(name, _ABSENT), now.get(name, _ABSENT)
        if before != after:
            (free_ones if name in free else held).extend(_tell_difference(name, before, after))
    return held, free_ones


def _tell_difference(name: str, before: Any, after: Any) -> list[str]:
    """Of tables only the fields that differ: a table shown as a whole is cut before them."""
    if not (isinstance(before, Mapping) and isinstance(after, Mapping) and before and after):
        return [f"{name} was {brief(before)}, is {brief(after)}"]
    told: list[str] = []
    for key in sorted({*before, *after}):
        a, b = before.get(key, _ABSENT), after.get(key, _ABSENT)
        if a != b:
            told += _tell_difference(f"{name}.{key}", a, b)
    return told
