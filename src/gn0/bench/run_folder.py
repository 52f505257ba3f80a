"""Whether a folder is one that a run may write to, and in what another run there differs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gn0.errors import BenchError, brief
from gn0.suites.suite import Suite

OTHERS = {  # the file by which each of our folders is known
    "bank.json": "a bank of people",
    "cma.json": "a policy",
    "corpus.json": "a corpus of scenes",
    "dataset.json": "a dataset",
    "export.json": "an export",
    "metrics.jsonl": "a training run",
    "policy.json": "a policy",
    "scene.json": "a scene",
    "shard.json": "a shard of a dataset",
    "suite.json": "a suite",
}
_ORDER = ("suite", "policy", "config", "source", "code")  # what explains the rest comes first


def check_run_folder(out: Path) -> None:
    """Refuse a folder that holds something else of ours, before anything is written or forgotten.

    Raises:
        BenchError: it is a scene, a suite, a dataset or the like.
    """
    for name, what in OTHERS.items():
        if (out / name).is_file():
            raise BenchError(f"is {what}, not a run", where=out, remedy="choose another --out")


def tell_inputs(
    suite: Suite,
    options: Mapping[str, Any],
    backend: str,
    episodes: int,
    *,
    isolated: bool = False,
    control: str = "none",
    bank: str = "",
) -> dict[str, Any]:
    """What is behind the digests of a run's identity, in words, for its journal.

    Of `options` what looks like a secret is masked already; `bank` is a content hash.
    """
    return {
        "suite": suite.name,
        "episodes": episodes,
        "backend": backend,
        "control": control,
        "isolated": isolated,
        "bank": bank,
        "options": msgspec.json.decode(msgspec.json.encode(dict(options))),  # as it is read back
    }


def tell_difference(
    head: Mapping[str, Any], identity: Mapping[str, str], told: Mapping[str, Any]
) -> str:
    """In what the run of a journal's first line differs from this one, in words.

    `told` is what `tell_inputs` says of this run; the line has that of the other under `told`,
    where its version wrote it.
    """
    name = next(name for name in _ORDER if head.get(name) != identity[name])
    was, now = brief(head.get(name) or "none"), brief(identity[name] or "none")
    before = head.get("told")
    before = before if isinstance(before, dict) else {}
    if name == "config":
        parts = _compare(before, told)
        if parts:
            return f"another config: {'; '.join(parts)}"
    if name == "suite" and "suite" in before:
        was, now = f"{_tell_suite(before)} {was}", f"{_tell_suite(told)} {now}"
    what = f"source of policy {head.get('policy')!r}" if name == "source" else name
    return f"another {what} ({_plain(was)}, now {_plain(now)})"


def _tell_suite(told: Mapping[str, Any]) -> str:
    return f"{brief(told.get('suite'))} of {told.get('episodes')} episodes,"


def _compare(before: Mapping[str, Any], now: Mapping[str, Any]) -> Sequence[str]:
    """Each input that differs, as "episodes 6, now 2"; none where an earlier version was mute."""
    parts = []
    for name in (name for name in now if name in before and before[name] != now[name]):
        ours, theirs = now[name], before[name]
        if name != "options" or not isinstance(theirs, dict):
            parts.append(f"{name} {_plain(brief(theirs))}, now {_plain(brief(ours))}")
            continue
        for key in sorted({*ours, *theirs}):
            if theirs.get(key) != ours.get(key) or (key in ours) != (key in theirs):
                was = brief(theirs[key]) if key in theirs else "not given"
                is_now = brief(ours[key]) if key in ours else "not given"
                parts.append(f"policy option {key} {was}, now {is_now}")
    return parts


def _plain(text: str) -> str:
    return text.replace("'", "") or "none"
