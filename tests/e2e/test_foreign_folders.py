"""A folder that a stranger sent is looked at and never obeyed, whichever verb opens it.

Each folder is as hostile as its format lets it be: it names a server to dial, a module to import,
files outside itself, and links that lead there. Every verb that opens such a folder runs on it.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gn0.avatars.bank_build import generate_bank
from gn0.bench.runner import run_suite
from gn0.cli.main import VERBS, main
from gn0.data.build import build_dataset, build_shard
from gn0.data.collect import build_dagger
from gn0.data.dataset import FileRecord, compute_seal, file_digest, load_dataset_file
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
from gn0.data.shard import load_shard
from gn0.errors import StorageError
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.storage import check_contained
from gn0.suites.known_suites import known_suites
from gn0.suites.suite import build_suite, load_suite

MODULE = "a_strangers_module"
OUTSIDE = "outside-of-it"

# what opens a folder that others may have made, with that folder as {it}
RUNS = {
    "bench replay": ["{it}"],
    "bench replay --policy": ["{it}", "--policy", "remote"],
    "bench report": ["{it}", "--out", "{new}.html"],
    "bench compare": ["{it}", "{run}"],
    "train page": ["{it}"],
    "view": ["{it}", "--check", "--no-browser", "--port", "0"],
    "view --results": ["{scene}", "--results", "{it}", "--check", "--no-browser", "--port", "0"],
    "bench run into it": ["{suite}", "--policy", "random", "--no-report", "--out", "{it}"],
    "policy show --from": ["bae", "{suite}", "--from", "{it}", "--pick=1", "--out", "{new}.png"],
}
SUITES = {
    "bench run": ["{it}", "--episodes", "1", "--no-report", "--out", "{new}"],
    "missions show": ["{it}", "--out", "{new}"],
    "missions describe": ["{it}"],
    "missions export": ["{it}", "--format", "gn-matrix", "--out", "{new}.parquet"],
    "data build": ["{it}", "--layout", "none", "--out", "{new}"],
    "data dagger": ["{it}", "--policy", "random", "--out", "{new}"],
    "bench replay --suite": ["{run}", "--suite", "{it}"],
    "bench report --suite": ["{run}", "--suite", "{it}", "--out", "{new}.html"],
    "missions generate": ["{it}/scenes/example-flat", "--per-scene", "1", "--out", "{new}"],
    "missions import": ["{it}", "--scenes", "{scene}", "--out", "{new}"],
    "bench suite": ["{it}/scenes/example-flat", "--episodes", "1", "--out", "{new}"],
    "data repair --suite": ["{data}", "--suite", "{it}"],
    "train tokenizer": ["{it}", "--out", "{new}"],
    "train sft": ["{it}", "--samples", "4", "--out", "{new}"],
    "train dagger": ["{it}", "--start", "{it}", "--out", "{new}"],
    "train dapo": ["{it}", "--start", "{it}", "--out", "{new}"],
    "policy examine": ["{new}", "{it}", "--device", "host", "--out", "{new}-walks"],
    "train rl": ["{it}", "--start", "{new}", "--out", "{new}"],
    "train baseline": ["{it}", "--samples", "4", "--out", "{new}"],
    "view": ["{it}", "--check", "--no-browser", "--port", "0"],
    "policy show": ["bae", "{it}", "--out", "{new}.png"],
}
DATASETS = {
    "data show": ["{it}", "--out", "{new}.png"],
    "data prompt": ["{it}", "--prompt", "paper_planning"],
    "data stats": ["{it}"],
    "data verify": ["{it}"],
    "data repair": ["{it}"],
    "data balance": ["{it}"],
    "data render": ["{it}"],
    "export": ["vlnce-r2r", "{it}", "--out", "{new}"],
    "data build into it": ["{suite}", "--layout", "none", "--out", "{it}"],
    "copy": ["{it}", "{new}"],
    "train tokenizer": ["{it}", "--out", "{new}"],
}
SHARDS = {
    "data merge": ["{it}", "--balance", "weights", "--out", "{new}"],
    "data build into it": ["{suite}", "--layout", "none", "--shard", "1/1", "--out", "{it}"],
}
BANKS = {
    "avatar show": ["{it}", "--out", "{new}.png"],
    "avatar animate": ["{it}", "--motion", "wave", "--fps", "5", "--out", "{new}"],
    "avatar check": ["{it}"],
    "avatar generate into it": ["--count", "2", "--density", "0.05", "--no-sheet", "--out", "{it}"],
}
EXPORTS = {
    "export check": ["{it}"],
    "export into it": ["vlnce-r2r", "{data}", "--out", "{it}"],
}
# verbs that open none of these: they make things, look at single files, or speak of this machine
OTHERS = {
    "demo", "doctor", "figures", "scene generate", "scene import", "scene corpus", "scene check",
    "scene show", "scene light", "scene visible", "scene inspect", "scene convert", "list",
    "scene furniture", "completion", "avatar import", "policy ask", "policy pack", "policy study",
}  # fmt: skip
CASES = [
    (kind, case, links)
    for kind, cases in (
        ("run", RUNS),
        ("suite", SUITES),
        ("data", DATASETS),
        ("export", EXPORTS),
        ("shard", SHARDS),
        ("bank", BANKS),
    )
    for case in cases
    for links in (False, True)
]


def verb_of(case: str) -> list[str]:
    return case.split(" --")[0].removesuffix(" into it").split(" ")


def test_every_verb_is_held_to_it_or_opens_no_such_folder() -> None:
    held = {" ".join(verb_of(case)) for _, case, _ in CASES}
    assert held | OTHERS >= set(VERBS), "a new verb: say here what it opens"


class Watch:
    """Notes what is dialled, and what is opened outside of a stranger's folder."""

    def __init__(self, outside: Path) -> None:
        self.outside = str(outside)
        self.on = False
        self.seen: list[str] = []
        sys.addaudithook(self._look)

    def _look(self, event: str, given: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event in ("open", "os.listdir", "os.scandir", "os.remove", "os.rename", "import"):
            told = os.fsdecode(given[0]) if isinstance(given[0], str | bytes) else ""
            if OUTSIDE in os.path.realpath(told) or MODULE in told:
                self.seen.append(f"{event} {told}")
        elif event in ("socket.connect", "socket.getaddrinfo"):
            self.seen.append(f"{event} {given[1:]}")


@pytest.fixture(scope="module")
def canary(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """A server that counts who calls, a module that says when it is imported, files to be read."""
    root = tmp_path_factory.mktemp("canary")
    outside = root / OUTSIDE
    outside.mkdir()
    (outside / "secret.txt").write_text("SECRET-LINE\n")
    marker = root / "imported"
    (root / f"{MODULE}.py").write_text(f"open({str(marker)!r}, 'w').close()\n")
    server = socket.create_server(("127.0.0.1", 0))
    calls: list[bytes] = []

    def listen() -> None:
        while True:
            try:
                caller, _ = server.accept()
            except OSError:
                return
            caller.settimeout(1.0)
            calls.append(caller.recv(4096))
            caller.close()

    threading.Thread(target=listen, daemon=True).start()
    watch = Watch(outside)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")]))
        patch.syspath_prepend(str(root))
        patch.setenv("GN0_TOKEN", "SECRET-TOKEN")
        if "NUMBA_CACHE_DIR" in os.environ:
            patch.setenv("NUMBA_CACHE_DIR", os.environ["NUMBA_CACHE_DIR"])
        patch.setenv("GN0_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield {
            "url": f"ws://127.0.0.1:{server.getsockname()[1]}", "outside": outside,
            "marker": marker, "calls": calls, "watch": watch,
        }  # fmt: skip
    server.close()


@pytest.fixture(scope="module")
def home(canary: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Sound folders of every kind, small."""
    root = tmp_path_factory.mktemp("home")
    save_scene(build_example_scene(), root / "flat")
    suite = build_suite([root / "flat"], root / "suite", 2, max_steps=40)
    run_suite(suite, "random", root / "run")
    plain = BuildSettings(pictures=PictureSettings(layout="none"))
    build_dataset(suite, root / "sound", plain)
    build_shard(suite, root / "shard", "1/1", plain)
    driven = DaggerSettings(policy="random", max_steps=20, halting="none")
    build_dagger(suite, root / "data", msgspec.structs.replace(plain, dagger=driven))
    assert main(["export", "vlnce-r2r", str(root / "sound"), "--out", str(root / "export")]) == 0
    generate_bank(root / "bank", count=2, density=0.05)
    return {
        name: root / name
        for name in ("flat", "suite", "run", "data", "export", "sound", "shard", "bank")
    }


def edit(path: Path, change: Callable[[Any], None]) -> None:
    value = json.loads(path.read_text())
    change(value)
    path.write_text(json.dumps(value))


def spoil(kind: str, it: Path, canary: dict[str, Any]) -> None:
    """Name a server, a module and files outside, wherever the format has a word for them."""
    outside = str(canary["outside"])
    options = {"url": canary["url"], "connect_timeout": 1, "path": outside}
    if kind == "run":

        def change(about: dict[str, Any]) -> None:
            about.update(suite_folder=outside, suite_relative=os.path.relpath(outside, it))
            about["settings"].update(
                policy="remote", plugin_modules=[MODULE], options=options, camera=f"{outside}/eye",
                drawing=canary["url"],
            )  # fmt: skip

        shutil.copytree(it.parent / "suite", canary["outside"] / "suite", dirs_exist_ok=True)
        edit(it / "run.json", change)
        # of a suite that nobody here has run, so that the folder's own word is all there is
        edit(it / "summary.json", lambda s: s.update(policy="remote", suite_hash="0" * 32))
    elif kind == "suite":
        edit(it / "suite.json", lambda about: about["scenes"][0].update(folder=outside))
    elif kind == "data":
        about = load_dataset_file(it)
        dagger = DaggerSettings(policy="remote", options=options, plugins=(MODULE,), max_steps=20)
        settings = msgspec.structs.replace(about.settings, dagger=dagger)
        about = msgspec.structs.replace(about, settings=settings)
        sealed = msgspec.structs.replace(about, seal=compute_seal(about))
        (it / "dataset.json").write_bytes(msgspec.json.encode(sealed))
        for table in (it / "samples").iterdir():  # to be made again, by whoever drove
            table.write_bytes(table.read_bytes()[:-9])
    elif kind == "shard":
        spoil("data", it, canary)
        shard = load_shard(it)
        driven = load_dataset_file(it)
        secret = canary["outside"] / "secret.txt"
        stolen = FileRecord(
            path=os.path.relpath(secret, it),
            size=secret.stat().st_size,
            digest=file_digest(secret.read_bytes()),
        )
        about = msgspec.structs.replace(driven, files=(stolen, *driven.files))
        shard = msgspec.structs.replace(shard, about=about)
        shard = msgspec.structs.replace(shard, seal=compute_seal(shard))
        (it / "shard.json").write_bytes(msgspec.json.encode(shard))
    elif kind == "bank":
        secret = os.path.relpath(canary["outside"] / "secret", it)
        edit(it / "bank.json", lambda about: about["avatars"][0].update(name=secret))
    else:
        edit(it / "export.json", lambda about: about.update(format=f"{MODULE}:Exporter"))


def link(it: Path, outside: Path) -> None:
    """Every file outside, with links in their places, and a link of each name that is written."""
    for number, path in enumerate(sorted(p for p in it.rglob("*") if p.is_file())):
        there = outside / f"linked-{number}"
        shutil.move(path, there)
        path.symlink_to(there)
    for name in (".gn0-probe", ".lock", "journal.jsonl"):
        (it / name).unlink(missing_ok=True)
        (it / name).symlink_to(outside / "secret.txt")


@pytest.mark.parametrize(("kind", "case", "links"), CASES)
def test_a_strangers_folder_neither_dials_nor_imports_nor_reads_outside_itself(
    kind: str,
    case: str,
    links: bool,
    home: dict[str, Path],
    canary: dict[str, Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("suite", "run", "data", "sound", "export", "shard", "bank"):
        shutil.copytree(home[name], tmp_path / name)
    it = tmp_path / kind
    if links:
        link(it, canary["outside"])
    else:
        spoil(kind, it, canary)
    if case == "data repair --suite":  # which needs the suite for what is gone
        (tmp_path / "sound" / "episodes.parquet").unlink()
    places = {name: str(tmp_path / name) for name in ("suite", "run", "new")}
    places |= {"it": str(it), "data": str(tmp_path / "sound"), "scene": str(home["flat"])}
    tables = {"run": RUNS, "suite": SUITES, "data": DATASETS, "export": EXPORTS, "shard": SHARDS}
    tables["bank"] = BANKS
    told = [word.format(**places) for word in tables[kind][case]]
    watch: Watch = canary["watch"]
    watch.seen.clear()
    watch.on = True
    try:
        code = main([*verb_of(case), *told])
    except SystemExit as error:  # usage: this test is out of date
        raise AssertionError(capsys.readouterr().err) from error
    finally:
        watch.on = False
    said = capsys.readouterr()
    assert not watch.seen, watch.seen
    assert not canary["calls"] and not canary["marker"].exists()
    assert "SECRET" not in said.out + said.err and "Traceback" not in said.err
    assert (canary["outside"] / "secret.txt").read_text() == "SECRET-LINE\n"
    assert code in (0, 1, 2)
    if links and (kind, case) != ("suite", "view"):  # which shows no suite, and reads none
        assert code and "link that leads out of its folder" in said.out + said.err, said.err


def test_what_the_run_names_is_shown_with_the_way_on(
    home: dict[str, Path], canary: dict[str, Any], tmp_path: Path, capsys: Any
) -> None:
    run = Path(shutil.copytree(home["run"], tmp_path / "run"))

    def change(about: dict[str, Any]) -> None:
        about["settings"].update(plugin_modules=[MODULE], options={"url": "ws://gpu", "token": "x"})

    edit(run / "run.json", change)
    assert main(["bench", "replay", str(run), "--policy", "oracle"]) == 2
    text = capsys.readouterr().err
    assert "is a run of another policy than 'oracle'" in text
    assert "--policy-option token=(not kept) --policy-option url=ws://gpu" in text
    assert f"--plugin {MODULE}" in text
    assert main(["bench", "replay", str(run), "--policy", "random"]) == 0
    text = capsys.readouterr().out
    assert "asked again: --policy random\nit was recorded with --policy random --policy-opt" in text
    assert main(["bench", "replay", str(run), "--plugin", MODULE]) == 2
    assert "add --policy NAME" in capsys.readouterr().err
    assert not canary["marker"].exists()


def test_a_suite_is_known_again_by_its_hash_and_only_where_somebody_here_named_it(
    home: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    suite = load_suite(home["suite"])
    assert home["suite"].resolve() in known_suites(suite.hash)
    assert known_suites("../../etc/passwd") == []
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "other"))
    assert main(["bench", "replay", str(home["run"])]) == 2
    text = capsys.readouterr().err
    assert f"run.json says it was at '{str(home['suite'])[:20]}" in text and "--suite DIR" in text
    assert main(["bench", "replay", str(home["run"]), "--suite", str(home["suite"])]) == 0
    assert main(["bench", "replay", str(home["run"])]) == 0, "named once, known from then on"
    (tmp_path / "other" / "suites").chmod(0o777)
    assert main(["bench", "replay", str(home["run"])]) == 2, "others may have written there"


def test_links_that_stay_inside_are_harmless_and_pipes_are_not(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x").write_text("x")
    (tmp_path / "a" / "y").symlink_to("x")
    check_contained(tmp_path)
    check_contained(tmp_path / "nothing")
    os.mkfifo(tmp_path / "a" / "pipe")
    with pytest.raises(StorageError, match=r"pipe: is not a plain file"):
        check_contained(tmp_path)
    with pytest.raises(StorageError, match=r"scene.json is missing"):
        load_scene(tmp_path)  # no scene: nothing in it is to be removed
