"""Documents tell the truth: every command block runs, every link and picture exists."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
PAGES = [*(ROOT / "docs").glob("*.md"), *(ROOT / "benchmarks").glob("*.md")]
DOCUMENTS = sorted([ROOT / "README.md", *PAGES])
FENCE = re.compile(r"^```(\w*)([^\n]*)\n(.*?)^```", re.M | re.S)


def blocks_of(document: Path) -> list[tuple[str, str]]:
    """(language, text) of the command blocks; `make` lines and GPU blocks are left out.

    Those that train are run where the extra `train` is: `make bae`.
    """
    blocks = []
    for language, mark, text in FENCE.findall(document.read_text()):
        if language not in ("bash", "python") or "gpu" in mark:
            continue
        if "train" in mark and not (find_spec("torch") and find_spec("transformers")):
            continue
        lines = [line for line in text.splitlines() if not line.startswith("make ")]
        if any(line.strip() and not line.startswith("#") for line in lines):
            blocks.append((language, "\n".join(lines)))
    return blocks


@pytest.fixture(scope="session")
def commands(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The path of commands of a reader, with a `gn0` that generates no scene twice."""
    made = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        made = made.parent  # of all who run documents side by side
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    if os.name != "posix" or not (real := shutil.which("gn0", path=path)):
        return path
    once = [sys.executable, "-IS", str(Path(__file__).with_name("generate_once.py"))]
    command = shlex.join([*once, real, str(made / "generated_once")])
    gn0 = tmp_path_factory.mktemp("bin") / "gn0"
    gn0.write_text(f'#!/bin/sh\nexec {command} "$@"\n')
    gn0.chmod(0o700)
    return f"{gn0.parent}{os.pathsep}{path}"


@pytest.mark.slow
@pytest.mark.timeout(1200)  # a page that trains takes minutes, and others run beside it
@pytest.mark.parametrize("document", [d for d in DOCUMENTS if blocks_of(d)], ids=lambda d: d.name)
def test_every_command_block_runs(document: Path, tmp_path: Path, commands: str) -> None:
    """Blocks of one document run in order in one empty folder, as a reader would type them."""
    env = {**os.environ, "PATH": commands}
    env.pop("GN0_DATA", None)  # a stranger has none
    for language, text in blocks_of(document):
        command = (
            ["bash", "-euo", "pipefail", "-c"] if language == "bash" else [sys.executable, "-c"]
        )
        done = subprocess.run(
            [*command, text], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=1100
        )
        assert done.returncode == 0, f"{document.name}:\n{text}\n{done.stdout}\n{done.stderr}"


def test_what_was_generated_is_laid_where_the_same_is_typed_again(tmp_path: Path) -> None:
    """Once for a command, wherever to; never in place of what lies there or of other verbs."""
    real = tmp_path / "real"
    real.write_text(
        '#!/bin/sh\necho "$@" >> "$LOG"\necho made $5\nmkdir -p $5 && echo "$3" > $5/scene'
    )
    real.chmod(0o700)

    def type_in(page: str, *typed: str) -> str:
        (tmp_path / page).mkdir(exist_ok=True)
        once = [sys.executable, "-IS", str(Path(__file__).with_name("generate_once.py"))]
        done = subprocess.run(
            [*once, str(real), str(tmp_path / "kept"), *typed],
            cwd=tmp_path / page, env={**os.environ, "LOG": str(tmp_path / "log")},
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert (tmp_path / page / typed[4] / "scene").read_text() == f"{typed[2]}\n"
        return done.stdout

    flat = ("scene", "generate", "--seed=3", "--out", "out/flat")
    home = (*flat[:-1], "out/home")
    capture = (*flat[:-1], "out/scan.splat")
    for page, *typed in (("a", *flat), ("b", *flat), ("b", *home), ("b", *flat), ("b", *capture)):
        assert type_in(page, *typed) == f"made {typed[-1]}\n"
    for page in ("a", "b"):
        type_in(page, "bench", "suite", "--seed=3", "--out", "out/suite")
    run = [line.rpartition("/")[2] for line in (tmp_path / "log").read_text().splitlines()]
    assert run == ["flat", "flat", "scan.splat", "suite", "suite"]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda d: d.name)
def test_a_stranger_has_all_that_a_command_names(document: Path) -> None:
    """No block, of whatever language or mark, asks for a folder of data that only we have."""
    for _, _, text in FENCE.findall(document.read_text()):
        assert "GN0_DATA" not in text, text


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda d: d.name)
def test_every_link_and_picture_exists(document: Path) -> None:
    text = FENCE.sub("", document.read_text())
    for target in re.findall(r"\]\(([^)#\s]+)", text) + re.findall(r'src="([^"]+)"', text):
        if not target.startswith(("http:", "https:", "mailto:")):
            assert (document.parent / target).exists(), f"{document.name} points to {target}"


def test_documents_name_no_workplace() -> None:
    for document in DOCUMENTS:
        assert f"{ROOT.parent}/" not in document.read_text(), document.name


@pytest.mark.slow
@pytest.mark.parametrize("example", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name)
def test_every_example_runs(example: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(example)], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


@pytest.mark.slow
@pytest.mark.parametrize(
    "notebook", sorted((ROOT / "examples").glob("*.ipynb")), ids=lambda p: p.name
)
def test_every_notebook_runs(notebook: Path, tmp_path: Path) -> None:
    """Its cells in one process, in order, as a kernel runs them; kept without outputs."""
    content = json.loads(notebook.read_text("utf-8"))
    cells = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
    assert content["nbformat"] == 4 and cells
    assert not any(cell["outputs"] or cell["execution_count"] for cell in cells)
    code = "\n\n".join("".join(cell["source"]) for cell in cells)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert "success=" in done.stdout
