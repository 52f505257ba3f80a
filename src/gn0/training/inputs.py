"""Inputs that one policy is trained on in turn: which there are, and which step is of which.

    all:0.5,views:0.3,maps:0.2

Every step is of one input, so that shapes stay constant. Which one follows from the seed and the
step's number alone: it is the same in all processes, and where a run goes on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from gn0.errors import ConfigError
from gn0.policies.bae.policy_settings import (
    INPUT_NAME,
    MAPS,
    SQUARE_NAMES,
    PolicySettings,
    join_inputs,
)
from gn0.policies.bae.prompt_template import PAPER, load_prompt, prompt_names
from gn0.seeds import random_stream

KNOWN: Mapping[str, tuple[tuple[str, ...], int]] = {
    "all": (("rgb", "history", "near", "far"), 13),
    "views": (("rgb", "history"), 0),
    "maps": (("near", "far"), 13),
}
"""Pictures and waypoints of inputs by name, in a prompt that leaves both open."""
_FORM = "give NAME:SHARE with commas between; a name is {}, or yours as NAME=rgb+near/13:SHARE"


@dataclass(frozen=True)
class InputMixture:
    """Which input a step of training is of.

    Attributes:
        shares: of the steps, by input; they need not sum up to 1.
        seed: of the choice.

    Raises:
        ConfigError: a share is not a number above 0.
    """

    shares: Mapping[str, float]
    seed: int = 0

    def __post_init__(self) -> None:
        for name, share in self.shares.items():
            if not (share > 0 and math.isfinite(share)):
                raise ConfigError(
                    f"input {name!r} has share {share}", where="inputs", remedy="give one above 0"
                )
        if not self.shares:
            raise ConfigError("a mixture of nothing", where="inputs", remedy="name inputs")

    def choose(self, step: int) -> str:
        """The input of a step."""
        names, shares = list(self.shares), np.cumsum(list(self.shares.values()))
        drawn = random_stream(self.seed, "inputs", step).random() * shares[-1]
        return names[int(np.searchsorted(shares[:-1], drawn, side="right"))]


def read_inputs(
    text: str, settings: PolicySettings, known: Mapping[str, PolicySettings] | None = None
) -> tuple[PolicySettings, dict[str, float]]:
    """Settings of a policy that is asked in several ways, and their shares.

    Args:
        text: `all:0.5,views:0.3,maps:0.2`. A name is one of `KNOWN`, a prompt of GN0's that leaves
            pictures and points closed (`paper_planning_views`), or a new one with pictures and
            points: `near_alone=near/13`. A share that is left out is 1. The first is the default.
        settings: what they have in common; the prompt is that of `KNOWN` and new names.
        known: inputs that are there already, by name: taken as they are.

    Raises:
        ConfigError: it reads otherwise, names an input twice or one that there is not.
    """
    chosen: dict[str, PolicySettings] = {}
    shares: dict[str, float] = {}
    for head, share in read_shares(text).items():
        name, equal, told = head.partition("=")
        if name in chosen or not INPUT_NAME.fullmatch(name):
            raise _refuse(f"{name!r} names no input, or two")
        if known and name in known and not equal:
            chosen[name], shares[name] = known[name], share
            continue
        chosen[name], shares[name] = _read_input(name, told if equal else None, settings), share
    if not chosen:
        raise _refuse("no input")
    InputMixture(shares)
    if len(chosen) == 1:  # a policy like any other
        return msgspec.structs.replace(next(iter(chosen.values())), input=""), {}
    return join_inputs(chosen), shares


def read_again(text: str, own: PolicySettings) -> tuple[PolicySettings | None, dict[str, float]]:
    """What a trained policy is asked from now on, and the shares.

    Where all names are the policy's, and all of them stand there, only shares change. Else inputs
    that the policy has stay as they are, and others are read as for a new one, with what the
    policy's default has: prompt, parts, cameras and layout of answers.

    Args:
        text: see `read_inputs`; empty for the policy's default alone.
        own: the policy's settings.

    Returns:
        settings, None where they stay; and shares by input.

    Raises:
        ConfigError: see `read_inputs`.
    """
    shares = read_shares(text)
    if not shares or (own.inputs and shares.keys() == own.by_input.keys()):
        return None, shares
    plain = msgspec.structs.replace(own.choose(), input="", prompt_digest="")
    return read_inputs(text, plain, own.by_input if own.input else {})


def read_shares(text: str) -> dict[str, float]:
    """Shares by name of inputs that a policy has: `all:0.5,views:0.3`; one left out is 1.

    Raises:
        ConfigError: it reads otherwise, or names an input twice.
    """
    shares: dict[str, float] = {}
    for part in (one.strip() for one in text.split(",") if one.strip()):
        name, colon, number = part.partition(":")
        if name in shares:
            raise _refuse(f"{name!r} stands twice")
        try:
            shares[name] = float(number) if colon else 1.0
        except ValueError:
            raise _refuse(f"{number!r} is not a share") from None
    return shares


def _read_input(name: str, told: str | None, settings: PolicySettings) -> PolicySettings:
    if told is None and name in KNOWN:
        pictures, points = KNOWN[name]
    elif told is None and name in prompt_names():
        parts = (PAPER, *load_prompt(name).parts)
        without = tuple(one for one in settings.without if one in parts)
        return fit_prompt(msgspec.structs.replace(settings, prompt=name, without=without))
    elif told is None:
        raise _refuse(f"no input {name!r}")
    else:
        shown, slash, number = told.partition("/")
        pictures = tuple(one.strip() for one in shown.split("+") if one.strip())
        if slash and not number.isdecimal():
            raise _refuse(f"{number!r} is not a number of waypoints")
        points = int(number) if slash else settings.form.points
    form = msgspec.structs.replace(settings.form, points=points)
    return fit_prompt(msgspec.structs.replace(settings, pictures=pictures, form=form))


def fit_prompt(settings: PolicySettings) -> PolicySettings:
    """The settings with what their prompt does not leave open.

    Coordinates are on what the prompt speaks of. One that leaves that open has them on the whole
    map where it shows whole maps and no square of the ego map.

    Raises:
        ConfigError, StorageError, FormatError: there is no such prompt; see `load_prompt`.
    """
    plain = load_prompt(settings.prompt, without=settings.without)
    form, pictures, view = settings.form, settings.pictures, settings.view
    if "pictures" not in plain.opened:
        pictures = plain.pictures
    closed = {
        name: getattr(plain, name) for name in ("points", "layout") if name not in plain.opened
    }
    if "arrow" in plain.parts:
        view = msgspec.structs.replace(view, arrow="arrow" in plain.on)
    shown = set(pictures)
    on_map = plain.frame == "global"
    if plain.frame == "any":
        on_map = bool(shown & {*MAPS}) and not shown & {*SQUARE_NAMES}
    return msgspec.structs.replace(
        settings,
        pictures=pictures,
        form=msgspec.structs.replace(form, **closed),
        task=settings.task if "task" in plain.opened else plain.task,
        coordinates="map" if on_map else "square",
        view=view,
    )


def _refuse(what: str) -> ConfigError:
    return ConfigError(what, where="--inputs", remedy=_FORM.format(", ".join(KNOWN)))
