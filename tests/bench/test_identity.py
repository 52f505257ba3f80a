"""Whose numbers a run holds: an edited policy or another model never shows earlier scores."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from gn0.bench import runner
from gn0.bench.identity import digest_modules, digest_policy, read_identity
from gn0.bench.report import write_report
from gn0.bench.results import RunSummary, load_results, load_summary
from gn0.bench.runner import run_suite
from gn0.cli import bench_run
from gn0.cli.main import main
from gn0.errors import BenchError, ConfigError, PolicyError
from gn0.policies.remote.client import RemoteClient
from gn0.policies.remote.extension import read_greeting
from gn0.policies.remote.server import PolicyServer
from gn0.policies.remote.wire import decode_message, encode_message
from gn0.policies.simple import PolicyRandom
from gn0.suites.suite import Suite
from gn0_trials.rogue_servers import serve_bare

pytestmark = pytest.mark.usefixtures("workers_here")

SOURCE = """
from gn0.plugins import _registered, register
from gn0.sim.state import Action
{more}
class Mine:
    name = "mine"
    sensors = frozenset()
    def reset(self, instruction, rng):
        self.left = {turns}
    def act(self, observation):
        self.left -= 1
        {fault}
        return Action.LEFT if self.left > 0 else Action.STOP
_registered.pop(("policy", "mine"), None)
register("policy", "mine", Mine)
"""


@pytest.fixture(scope="module", autouse=True)
def still_code() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "code_version", lambda: "1.0+still")
        yield


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Path]]:
    """Writes the plug-in `mine_plugin` as a user's editor would."""
    folder = tmp_path / "code"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def edit(turns: int = 3, more: str = "", fault: str = "") -> Path:
        path = folder / "mine_plugin.py"
        path.write_text(SOURCE.format(turns=turns, more=more, fault=fault))
        sys.modules.pop("mine_plugin", None)
        return path

    yield edit
    sys.modules.pop("mine_plugin", None)


def run_mine(suite: Suite, out: Path, **more: Any) -> tuple[RunSummary, list[str]]:
    said: list[str] = []
    more = {"max_episodes": 2, "plugin_modules": ("mine_plugin",), "tell": said.append} | more
    return run_suite(suite, "mine", out, **more), said


def test_an_edited_policy_does_not_show_the_scores_of_the_one_before(
    flats_suite: Suite, tmp_path: Path, write: Callable[..., Path]
) -> None:
    out = tmp_path / "run"
    write(turns=3)
    first, said = run_mine(flats_suite, out)
    card = dict(first.protocol)
    assert first.metrics["steps"].mean == 3 and not said
    assert card["policy identity"].endswith("; none declared")
    before = (out / "results.jsonl").read_bytes()
    write(turns=5)
    with pytest.raises(BenchError, match=r"another source of policy 'mine' \(\w+, now \w+\)") as no:
        run_mine(flats_suite, out)
    assert "another --out" in str(no.value) and "--fresh" in str(no.value)
    digest = card["policy identity"].split()[1].rstrip(";")
    assert digest in str(no.value) and (out / "results.jsonl").read_bytes() == before
    assert run_mine(flats_suite, out, resume=False)[0].metrics["steps"].mean == 5
    write(turns=5)  # saved again, nothing changed
    assert run_mine(flats_suite, out)[1][0].endswith("; nothing was run")


def test_with_nothing_left_to_do_it_says_so_and_when_that_was_done(
    flats_suite: Suite,
    tmp_path: Path,
    write: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    write()
    args = bench_run.Args(
        suite=str(flats_suite.folder), out=str(tmp_path / "run"), policy="mine", limit=2,
        plugin=("mine_plugin",), no_report=True,
    )  # fmt: skip
    bench_run.run(args)
    assert "already" not in capsys.readouterr().out
    bench_run.run(args)
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("2 of 2 episodes were there already, finished ")
    assert first.endswith("; nothing was run") and ":" in first


def test_whatever_the_plugin_is_made_of_counts_and_nothing_else(
    tmp_path: Path, write: Callable[..., Path]
) -> None:
    path = write(more="def late():\n    import nets.model\n")
    folder = path.parent
    (folder / "nets" / "weights").mkdir(parents=True)
    (folder / "nets" / "model.py").write_text("DEPTH = 3\n")
    (folder / "notes").mkdir()
    import_module("mine_plugin")

    def digest() -> str:
        return digest_modules(["mine_plugin"])

    seen = [digest()]
    for name, counts in (
        ("beside.py", True),
        ("nets/model.py", True),
        ("nets/more.py", True),
        ("notes/unrelated.py", False),
        ("nets/weights/w.bin", False),
    ):
        (folder / name).write_text("DEPTH = 4\n")
        assert (digest() != seen[-1]) == counts, name
        seen.append(digest())
    assert digest() == digest_policy("mine"), "that of its class's module"
    assert digest_policy("random") == "", "ours are told by the digest of the code"
    sys.modules.pop("mine_plugin")
    assert digest() == seen[-1] and "mine_plugin" not in sys.modules, "it is not imported for that"


def test_a_plugin_whose_file_vanished_between_runs_is_told_and_its_results_stay(
    flats_suite: Suite, tmp_path: Path, write: Callable[..., Path]
) -> None:
    out = tmp_path / "run"
    path = write()
    run_mine(flats_suite, out)
    before = {p.name: p.read_bytes() for p in out.iterdir()}
    path.unlink()
    with pytest.raises(ConfigError, match="the source of a plug-in cannot be read") as gone:
        run_mine(flats_suite, out)  # still in the memory of this process
    assert str(path) in str(gone.value)
    sys.modules.pop("mine_plugin")
    with pytest.raises(ConfigError, match="cannot import the plug-in 'mine_plugin'"):
        run_mine(flats_suite, out)
    assert {p.name: p.read_bytes() for p in out.iterdir()} == before


CHECKPOINT = """
from pathlib import Path
def identity(self):
    return {{"checkpoint": Path({0!r}).read_text(), "version": 3}}
"""


def test_another_checkpoint_is_another_policy_also_when_nothing_is_left_to_run(
    flats_suite: Suite, tmp_path: Path, write: Callable[..., Path]
) -> None:
    weights = tmp_path / "weights.txt"
    weights.write_text("aa11")
    path = write()
    path.write_text(
        path.read_text() + CHECKPOINT.format(str(weights)) + "Mine.identity = identity\n"
    )
    summary, _ = run_mine(flats_suite, tmp_path / "run")
    assert "checkpoint aa11, version 3" in dict(summary.protocol)["policy identity"]
    assert run_mine(flats_suite, tmp_path / "run")[1][0].endswith("nothing was run")
    weights.write_text("bb22")
    for _ in range(2):
        with pytest.raises(BenchError, match=r"checkpoint aa11.*; now checkpoint bb22") as no:
            run_mine(flats_suite, tmp_path / "run")
    assert "--fresh" in str(no.value)
    weights.unlink()
    summary, said = run_mine(flats_suite, tmp_path / "run")
    assert summary.ok and "could not be asked" in said[1] and "weights.txt" in said[1]


@pytest.mark.parametrize("said", [None, "v3", {"net": object()}, {3: "x"}, {"a": ["b"]}])
def test_an_identity_that_is_none_is_refused(said: Any) -> None:
    class Odd(PolicyRandom):
        def identity(self) -> Any:
            return said

    with pytest.raises(PolicyError, match=r"identity\(\) of policy 'random' is not a map"):
        read_identity(Odd())


# Servers.


def serving(greeting: dict[str, Any] | None, broken: str = "") -> Any:
    """A bare server that walks a little; `broken` is an episode that it cannot do."""

    def handle(connection: Any) -> None:
        if greeting is not None:
            connection.send(encode_message(greeting))
        for frame in connection:
            request = decode_message(frame)
            if broken and request.get("session_id", "") == broken:
                connection.send("no such layer")
            else:
                connection.send(encode_message({"actions": [2, 2, 0]}))

    return handle


def model(name: str) -> dict[str, Any]:
    return {
        "gn0": {
            "version": 1,
            "name": "lab",
            "model": name,
            "model_version": 2,
            "wants": ["ranges"],
        }
    }


def ask(suite: Suite, out: Path, url: str, **more: Any) -> tuple[RunSummary, list[str]]:
    options = {"url": url, "connect_timeout": 5.0, "metadata_timeout": 0.5}
    said: list[str] = []
    more = {"max_episodes": 3, "tell": said.append} | more
    return run_suite(suite, "remote", out, policy_options=options, **more), said


def test_another_model_behind_the_same_address_is_refused(
    flats_suite: Suite, tmp_path: Path
) -> None:
    with serve_bare(serving(model("navid-7b"))) as url:
        summary, _ = ask(flats_suite, tmp_path, url)
        assert ask(flats_suite, tmp_path, url)[1][0].endswith("nothing was run")
    assert dict(summary.protocol)["policy identity"] == "server lab, model navid-7b, version 2"
    port = int(url.rpartition(":")[2])
    for other, said in ((model("navid-13b"), "model navid-13b"), ({"hi": 1}, "unidentified")):
        with (
            serve_bare(serving(other), port=port),
            pytest.raises(BenchError, match=f"model navid-7b, version 2; now .*{said}"),
        ):
            ask(flats_suite, tmp_path, url)
    again, said_now = ask(flats_suite, tmp_path, url)  # nobody is there any more
    assert again == summary and "no policy server at" in said_now[1]


def test_a_server_that_says_nothing_of_itself_is_called_unidentified() -> None:
    assert read_greeting({}).identity == () == read_greeting({"gn0": 3, "x": "y"}).identity
    plain = read_greeting({"name": "bare", "model": b"\x00", "version": [1], "metadata": {}})
    assert plain.identity == (("server", "bare"),) and not plain.extended
    long = read_greeting({"name": "a\nb\x1b[2J" + "c" * 9999, "version": 1.5})
    assert "\x1b" not in long.identity[0][1] and len(long.identity[0][1]) <= 200


def test_a_served_policy_greets_with_its_model_and_its_own_identity() -> None:
    class Served(PolicyRandom):
        def identity(self) -> dict[str, str]:
            return {"checkpoint": "ab12"}

    with PolicyServer(Served, port=0, model="tiny", version="7") as server:
        client = RemoteClient(server.url, metadata_timeout=5.0)
        client.connect()
        client.close()
    assert read_greeting(client.metadata).identity == (
        ("server", "random"), ("model", "tiny"), ("version", "7"), ("checkpoint", "ab12"),
    )  # fmt: skip


# What failed.


def test_a_mended_server_is_asked_again_for_what_failed_and_for_nothing_else(
    flats_suite: Suite, tmp_path: Path
) -> None:
    bad = flats_suite.episodes[1].id
    with serve_bare(serving(model("m"), broken=bad)) as url:
        first, _ = ask(flats_suite, tmp_path, url)
    assert [r.episode for r in first.failed] == [bad] and "no such layer" in first.failed[0].reason
    scored = [r for r in load_results(tmp_path) if r.status == "valid"]
    asked: list[str] = []

    def mended(connection: Any) -> None:
        connection.send(encode_message(model("m")))
        for frame in connection:
            request = decode_message(frame)
            asked.extend(filter(None, [request.get("session_id", "")]))
            connection.send(encode_message({"actions": [2, 0]}))

    with serve_bare(mended, port=int(url.rpartition(":")[2])):
        kept, said = ask(flats_suite, tmp_path, url, keep_failed=True)
        assert kept == first and said[0].endswith("1 of them failed and are kept so")
        assert not asked
        summary, said = ask(flats_suite, tmp_path, url)
    assert summary.ok and set(asked) == {bad}
    assert said[0].startswith("2 of 3 episodes were there already, done in the run of ")
    assert said[1].startswith("1 episode failed in the run of ") and "--keep-failed" in said[1]
    assert [r for r in load_results(tmp_path) if r.episode != bad] == scored
    assert json.loads((tmp_path / "run.json").read_text())["episodes"][bad]["attempts"] == 1


def test_a_policy_that_never_finished_an_episode_may_be_mended_without_more_ado(
    flats_suite: Suite, tmp_path: Path, write: Callable[..., Path]
) -> None:
    write(fault="raise ValueError('typo')")
    first, _ = run_mine(flats_suite, tmp_path / "run")
    assert len(first.failed) == 2
    write()
    with pytest.raises(BenchError, match="another source"):
        run_mine(flats_suite, tmp_path / "run", keep_failed=True)
    assert run_mine(flats_suite, tmp_path / "run")[0].ok


# Names.


def test_a_name_of_your_own_is_shown_everywhere_and_runs_nothing_again(
    flats_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(out: str, name: str) -> str:
        bench_run.run(
            bench_run.Args(
                suite=str(flats_suite.folder), out=str(tmp_path / out), policy="random", name=name,
                limit=2, no_report=True,
            )
        )  # fmt: skip
        return capsys.readouterr().out

    assert "baseline" in run("a", "baseline")
    again = run("a", "chance <b>")
    assert "chance <b>" in again and "nothing was run" in again and "baseline" not in again
    run("b", "")
    assert dict(load_summary(tmp_path / "a").protocol)["policy"] == "chance <b> (policy 'random')"
    assert main(["bench", "compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    said = capsys.readouterr().out
    assert "A: chance <b> (" in said and "B: random (" in said
    page = write_report([tmp_path / "a", tmp_path / "b"], tmp_path / "x.html", videos=0).read_text()
    assert "chance &lt;b&gt;" in page and "chance <b>" not in page
    for wrong in (" ", "x" * 81, "two\nlines", "\x1b[2J"):
        with pytest.raises(ConfigError, match="cannot be shown"):
            run("c", wrong)
    assert not (tmp_path / "c").exists()


def test_the_name_option_of_a_remote_policy_has_an_effect(
    flats_suite: Suite, tmp_path: Path
) -> None:
    with serve_bare(serving(model("m"))) as url:
        options = {"url": url, "metadata_timeout": 0.5, "name": "navid-7b"}
        summary = run_suite(flats_suite, "remote", tmp_path, policy_options=options, max_episodes=1)
    assert summary.label == load_summary(tmp_path).label == "navid-7b"
    assert summary.policy == "remote"
