"""Mutation fuzzing for readers of untrusted files: seeded, repeatable, any number of inputs.

A reader passes when every input is either read, and what was read is sound, or refused with one of
GN0's own errors, in bounded time and memory. `python -m gn0_trials.fuzz ply --count 1000000` runs
a reader's campaign from the command line.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from gn0.errors import FormatError, Gn0Error
from gn0.progress import Progress, no_progress
from gn0.seeds import random_stream
from gn0_trials.peak_memory import peak_memory_bytes, reset_peak_memory

HANG_SECONDS = 1.0  # processor time a megabyte of input, at least for one megabyte
_KEPT_FAULTS = 20
_EDGES = (0, 1, 2, 0x7F, 0x80, 0xFE, 0xFF, 10, 13, 32, 45, 46, 48, 57)
_NUMBERS = (
    b"0", b"1", b"-1", b"2", b"255", b"256", b"257", b"65536", b"2147483647", b"2147483648",
    b"4294967295", b"4294967296", b"1000000000000", b"9223372036854775807", b"18446744073709551616",
    b"1e9", b"nan", b"inf", b"-0", b"007", b"1" * 30, b"9" * 400, b"",
)  # fmt: skip


@dataclass(frozen=True)
class FuzzTarget:
    """What is to be fuzzed.

    Attributes:
        name: for messages.
        read: reads the file at a path.
        corpus: sound files by name, the seeds of all mutations.
        check: raises if what was read is not sound.
        tokens: words of the format that mutations may put in.
        suffix: file name ending.
        beside: sound files that lie beside the input, by relative path.
        finish: last step of every mutant, e.g. making its checksums agree again.
    """

    name: str
    read: Callable[[Path], Any]
    corpus: Mapping[str, bytes]
    check: Callable[[Any], None] = lambda _: None
    tokens: Sequence[bytes] = ()
    suffix: str = ""
    beside: Mapping[str, bytes] = field(default_factory=dict)
    finish: Callable[[bytes, np.random.Generator], bytes] = lambda data, _: data


@dataclass(frozen=True)
class FuzzFault:
    """One input that a reader did not take well."""

    index: int
    seed_name: str
    what: str
    data: bytes


@dataclass(frozen=True)
class FuzzReport:
    """Outcome of a campaign.

    Attributes:
        inputs: how many inputs were tried.
        accepted: how many were read.
        refused: how many were refused with a `Gn0Error` that names its file and a remedy.
        foreign: all others: other exceptions, warnings, bare refusals, unsound results.
        hangs: inputs that took more than `HANG_SECONDS` of processor time a megabyte.
        slowest_s: processor time of the slowest input [s].
        peak_growth_bytes: growth of the process's peak memory; 0 where it cannot be told.
        faults: the first few of them, with their bytes.
    """

    inputs: int
    accepted: int
    refused: int
    foreign: int
    hangs: int
    slowest_s: float
    peak_growth_bytes: int
    faults: tuple[FuzzFault, ...]


def mutate(
    data: bytes,
    rng: np.random.Generator,
    corpus: Sequence[bytes] = (),
    tokens: Sequence[bytes] = (),
) -> bytes:
    """One mutant of a sound file: one to four small damages, half of them near its start."""
    mutant = bytearray(data)
    for _ in range(min(4, int(rng.geometric(0.6)))):
        if not mutant:
            mutant = bytearray(data)
        _MUTATIONS[int(rng.integers(len(_MUTATIONS)))](mutant, rng, corpus, tokens)
    return bytes(mutant)


def fuzz_reader(
    target: FuzzTarget,
    *,
    count: int,
    seed: int = 0,
    first: int = 0,
    work: Path | None = None,
    progress: Progress = no_progress,
) -> FuzzReport:
    """Feed `count` mutants to a reader.

    Input i depends on (seed, target name, i) alone, so a fault is found again by its index.

    Args:
        target: the reader and its corpus.
        count: number of inputs.
        seed: root seed.
        first: index of the first input.
        work: scratch folder; by default one in memory where the system has it.
        progress: told every thousand inputs.
    """
    names = sorted(target.corpus)
    files = [target.corpus[name] for name in names]
    accepted = refused = foreign = hangs = 0
    slowest = 0.0
    faults: list[FuzzFault] = []
    memory = Path("/dev/shm")
    parent = work or (memory if os.access(memory, os.W_OK) else None)
    with tempfile.TemporaryDirectory(dir=parent) as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        path = Path(folder) / f"input{target.suffix}"
        for name, data in target.beside.items():
            (Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            (Path(folder) / name).write_bytes(data)
        for data in files:  # compile and warm up, outside the clock
            path.write_bytes(data)
            target.check(target.read(path))
        reset_peak_memory()
        before = peak_memory_bytes()
        for index in range(first, first + count):
            rng = random_stream(seed, "fuzz", target.name, index)
            pick = int(rng.integers(len(files)))
            data = target.finish(mutate(files[pick], rng, files, target.tokens), rng)
            path.write_bytes(data)
            started = time.process_time()
            what = ""
            try:
                result = target.read(path)
                target.check(result)
                accepted += 1
            except Gn0Error as error:
                if isinstance(error, FormatError) and not (error.file and error.remedy):
                    what = f"refusal without file or remedy: {error}"
                else:
                    refused += 1
            except Exception as error:
                what = f"{type(error).__name__}: {error}"
            took = time.process_time() - started
            slowest = max(slowest, took)
            foreign += bool(what)
            if took > HANG_SECONDS * max(1.0, len(data) / 1e6):
                hangs += 1
                what = f"{what} took {took:.1f} s"
            if what and len(faults) < _KEPT_FAULTS:
                faults.append(FuzzFault(index, names[pick], what, data))
            if index % 1000 == 999:
                progress(f"fuzz {target.name}", index + 1 - first, count)
        growth = max(0, peak_memory_bytes() - before)
    return FuzzReport(count, accepted, refused, foreign, hangs, slowest, growth, tuple(faults))


def _place(mutant: bytearray, rng: np.random.Generator) -> int:
    """A position; half of them among the first 512 bytes, where headers are."""
    end = len(mutant)
    if end > 512 and rng.random() < 0.5:
        end = 512
    return int(rng.integers(end + 1))


def _flip_bit(m: bytearray, rng: np.random.Generator, *_: Any) -> None:
    at = min(_place(m, rng), len(m) - 1)
    m[at] ^= 1 << int(rng.integers(8))


def _set_byte(m: bytearray, rng: np.random.Generator, *_: Any) -> None:
    at = min(_place(m, rng), len(m) - 1)
    m[at] = _EDGES[int(rng.integers(len(_EDGES)))]


def _set_word(m: bytearray, rng: np.random.Generator, *_: Any) -> None:
    """Four bytes that mean something: edges of integers, NaN, infinities, huge floats."""
    words = (b"\xff\xff\xff\xff", b"\0\0\0\x80", b"\xff\xff\xff\x7f", b"\0\0\xc0\x7f",
             b"\0\0\x80\x7f", b"\0\0\x80\xff", b"\xff\xff\x7f\x7f", b"\0\0\0\0")  # fmt: skip
    at = _place(m, rng)
    m[at : at + 4] = words[int(rng.integers(len(words)))]


def _truncate(m: bytearray, rng: np.random.Generator, *_: Any) -> None:
    del m[_place(m, rng) :]


def _delete(m: bytearray, rng: np.random.Generator, *_: Any) -> None:
    at = _place(m, rng)
    del m[at : at + int(rng.integers(1, 33))]


def _repeat(m: bytearray, rng: np.random.Generator, *_: Any) -> None:
    at = _place(m, rng)
    piece = bytes(m[at : at + int(rng.integers(1, 65))])
    m[at:at] = piece * int(rng.integers(1, 5))


def _insert(m: bytearray, rng: np.random.Generator, *_: Any) -> None:
    at = _place(m, rng)
    m[at:at] = rng.bytes(int(rng.integers(1, 17)))


def _splice(
    m: bytearray, rng: np.random.Generator, corpus: Sequence[bytes], _: Sequence[bytes]
) -> None:
    if corpus:
        other = corpus[int(rng.integers(len(corpus)))]
        m[_place(m, rng) :] = other[int(rng.integers(len(other) + 1)) :]


def _put_token(
    m: bytearray, rng: np.random.Generator, _: Sequence[bytes], tokens: Sequence[bytes]
) -> None:
    """Replace a word by another of the format, or by a number that means trouble."""
    choices = [*tokens, *_NUMBERS] if rng.random() < 0.7 else _NUMBERS
    at = _place(m, rng)
    start = max(m.rfind(b" ", 0, at), m.rfind(b"\n", 0, at)) + 1
    stops = [s for s in (m.find(b" ", start), m.find(b"\n", start)) if s >= 0]
    stop = min(stops) if stops else len(m)
    if stop - start <= 64:
        m[start:stop] = choices[int(rng.integers(len(choices)))]


def _forge_number(m: bytearray, rng: np.random.Generator, *_: Any) -> None:
    """Replace a run of digits by another number."""
    at = _place(m, rng)
    while at < len(m) and not 48 <= m[at] <= 57:
        at += 1
    stop = at
    while stop < len(m) and 48 <= m[stop] <= 57:
        stop += 1
    m[at:stop] = _NUMBERS[int(rng.integers(len(_NUMBERS)))]


def _swap_lines(m: bytearray, rng: np.random.Generator, *_: Any) -> None:
    """Move, double or drop one line of the head."""
    head, tail = bytes(m[:4096]), bytes(m[4096:])
    lines = head.split(b"\n")
    line = int(rng.integers(len(lines)))
    kind = int(rng.integers(3))
    if kind == 0:
        lines.insert(int(rng.integers(len(lines))), lines.pop(line))
    elif kind == 1:
        lines.insert(line, lines[line])
    else:
        lines.pop(line)
    m[:] = b"\n".join(lines) + tail


_MUTATIONS: tuple[Callable[..., None], ...] = (
    _flip_bit, _set_byte, _set_word, _truncate, _delete, _repeat, _insert, _splice, _put_token,
    _put_token, _forge_number, _swap_lines,
)  # fmt: skip

TARGETS = {
    "gn-matrix": "gn0_trials.set_corpus:gn_matrix_target",
    "gn-matrix-json": "gn0_trials.set_corpus:json_folder_target",
    "vlnce": "gn0_trials.set_corpus:vlnce_target",
    "ply": "gn0_trials.splat_corpus:ply_target",
    "ply-packed": "gn0_trials.splat_corpus:ply_packed_target",
    "splat": "gn0_trials.splat_targets:splat_target",
    "ksplat": "gn0_trials.splat_targets:ksplat_target",
    "spz": "gn0_trials.splat_targets:spz_target",
    "sog": "gn0_trials.splat_targets:sog_target",
    "sog-folder": "gn0_trials.splat_targets:sog_folder_target",
    "gltf": "gn0_trials.splat_targets:gltf_target",
    "bvh": "gn0_trials.motion_targets:bvh_target",
    "fbx": "gn0_trials.motion_targets:fbx_target",
    "glb-skin": "gn0_trials.motion_targets:glb_skin_target",
    "motion-npz": "gn0_trials.motion_targets:motion_npz_target",
    "mhclo": "gn0_trials.people_targets:mhclo_target",
    "mhclo-mesh": "gn0_trials.people_targets:mhclo_mesh_target",
    "avatar": "gn0_trials.people_targets:avatar_target",
    "bank": "gn0_trials.people_targets:bank_target",
    "people": "gn0_trials.people_targets:people_target",
    "episodes-people": "gn0_trials.people_targets:episodes_target",
    "yaml": "gn0_trials.fuzz_yaml:yaml_target",
    "wire-reply": "gn0_trials.fuzz_wire:reply_target",
    "wire-request": "gn0_trials.fuzz_wire:request_target",
}


def find_target(name: str) -> FuzzTarget:
    """The built-in target of that name.

    Raises:
        KeyError: no such target.
    """
    module, attribute = TARGETS[name].split(":")
    target: FuzzTarget = getattr(import_module(module), attribute)()
    return target


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line: fuzz one built-in reader; exit code 1 where anything foreign came out."""
    parser = argparse.ArgumentParser(prog="python -m gn0_trials.fuzz", description=__doc__)
    parser.add_argument("reader", choices=sorted(TARGETS))
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--faults", type=Path, help="folder for the inputs that did harm")
    options = parser.parse_args(arguments)
    report = fuzz_reader(find_target(options.reader), count=options.count, seed=options.seed)
    sys.stdout.write(
        f"{options.reader}: {report.inputs} inputs, {report.accepted} read, {report.refused} "
        f"refused, {report.foreign} foreign, {report.hangs} hangs, slowest "
        f"{report.slowest_s * 1000:.0f} ms, memory +{report.peak_growth_bytes / 1e6:.0f} MB\n"
    )
    for fault in report.faults:
        sys.stdout.write(f"  input {fault.index} (from {fault.seed_name}): {fault.what}\n")
        if options.faults:
            options.faults.mkdir(parents=True, exist_ok=True)
            (options.faults / f"{options.reader}-{fault.index}").write_bytes(fault.data)
    return int(bool(report.foreign or report.hangs))


if __name__ == "__main__":
    sys.exit(main())
