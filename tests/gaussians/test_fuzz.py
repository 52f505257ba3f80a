"""No mutant of a sound file makes a splat reader hang, leak an exception or lie."""

from __future__ import annotations

from pathlib import Path

import pytest

from gn0.errors import FormatError
from gn0.seeds import random_stream
from gn0_trials.fuzz import TARGETS, FuzzTarget, find_target, fuzz_reader, main, mutate

# files that take milliseconds each: hundreds with every change, thousands by the slow run
DEAR = {"fbx": 300, "episodes-people": 300, "bank": 300, "glb-skin": 500, "avatar": 500}


@pytest.mark.parametrize("tenths", [(0, 1), pytest.param((1, 10), marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", sorted(TARGETS))
def test_thousands_of_mutants(name, tenths):
    """The slow run goes on where the other ends."""
    first, end = (DEAR.get(name, 1_000) * tenth for tenth in tenths)
    count = end - first
    report = fuzz_reader(find_target(name), count=count, seed=2026, first=first)
    assert [f"{f.index}: {f.what}" for f in report.faults] == []
    assert report.foreign == 0 and report.hangs == 0
    assert report.accepted + report.refused == count
    assert report.accepted > 0.03 * count, "mutants too wild to reach the decoders"
    assert report.peak_growth_bytes < 64e6


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", sorted(TARGETS))
def test_a_million_mutants(name):
    report = fuzz_reader(find_target(name), count=1_000_000, seed=1)
    assert report.foreign == 0 and report.hangs == 0


def test_a_campaign_may_begin_at_any_input():
    """So one goes on where another ended."""

    sound = {"a": b"sound", "b": b"text"}

    def read(path: Path) -> None:
        if path.read_bytes() not in sound.values():
            raise IndexError("leak")

    target = FuzzTarget("bad", read, sound)
    whole = fuzz_reader(target, count=12, seed=7).faults
    again = fuzz_reader(target, count=8, seed=7, first=4).faults
    assert again and again == tuple(fault for fault in whole if fault.index >= 4)


def test_inputs_depend_on_seed_and_index_alone():
    corpus = list(find_target("ply").corpus.values())[:3]
    a = [mutate(corpus[0], random_stream(0, "m", i), corpus) for i in range(50)]
    b = [mutate(corpus[0], random_stream(0, "m", i), corpus) for i in reversed(range(50))]
    assert a == b[::-1] and len(set(a)) > 40


def test_the_fuzzer_sees_faults(tmp_path):
    """A reader that leaks, one that accepts nonsense and one that refuses without naming a file."""

    def read(path: Path) -> bytes:
        data = path.read_bytes()
        if data == b"sound":
            return data
        if len(data) % 3 == 0:
            raise IndexError("leak")
        if len(data) % 3 == 1:
            raise FormatError("no file named")
        return data

    def check(value: bytes) -> None:
        assert value == b"sound", "unsound"

    report = fuzz_reader(FuzzTarget("bad", read, {"a": b"sound"}, check), count=300, work=tmp_path)
    seen = {fault.what.split(":")[0] for fault in report.faults}
    assert seen == {"IndexError", "AssertionError", "refusal without file or remedy"}
    assert report.accepted + report.refused + report.foreign == 300


def test_command(capsys):
    assert main(["ply", "--count", "50"]) == 0
    assert "50 inputs" in capsys.readouterr().out
    assert set(TARGETS) >= {"ply", "ply-packed", "splat", "ksplat", "spz", "sog", "gltf"}


def test_files_beside_the_input_and_a_last_step(tmp_path):
    """A target may have files beside its input, and repair every mutant."""

    def read(path: Path) -> bytes:
        assert (path.parent / "deep/beside").read_bytes() == b"sound"
        return path.read_bytes()

    def check(value: bytes) -> None:
        assert value.endswith(b"!")

    target = FuzzTarget(
        "beside",
        read,
        {"a": b"text!"},
        check,
        beside={"deep/beside": b"sound"},
        finish=lambda data, rng: data + b"!",
    )
    report = fuzz_reader(target, count=50, work=tmp_path)
    assert report.accepted == 50 and not report.faults
