"""Cached code is run: it is taken only from a folder that nobody else can write."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gn0.cache import find_strangers, trust_folder
from gn0.cli import doctor

ROOT = os.geteuid() == 0 if hasattr(os, "geteuid") else False
pytestmark = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="rights are no mode bits here")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("GN0_CACHE_REFUSED", raising=False)
    return tmp_path / "cache"


def test_a_folder_of_ours_is_made_for_us_alone(cache: Path) -> None:
    folder = cache / "numba"
    before = os.umask(0)
    try:
        assert trust_folder(folder)
    finally:
        os.umask(before)
    assert folder.is_dir()
    assert {path.stat().st_mode & 0o777 for path in (cache, folder)} == {0o700}
    (folder / "x.nbi").write_bytes(b"x")
    assert trust_folder(folder)


@pytest.mark.parametrize(("mode", "words"), [(0o777, "everybody may write"), (0o775, "group ")])
@pytest.mark.parametrize("which", ["cache/numba", "cache", "."])
def test_a_folder_that_others_may_write_is_refused(
    cache: Path, mode: int, words: str, which: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gn0.cache._is_private", lambda _: False)
    (cache / "numba").mkdir(parents=True)
    (cache.parent / which).chmod(mode)
    why = find_strangers(cache / "numba")
    assert why.startswith(words) and str((cache.parent / which).resolve()) in why
    assert not trust_folder(cache / "numba")


def test_under_a_folder_like_tmp_it_is_safe_but_not_as_one(cache: Path) -> None:
    cache.mkdir()
    cache.chmod(0o1777)
    assert trust_folder(cache / "numba")
    (cache / "numba").chmod(0o1777)
    assert "everybody may write" in find_strangers(cache / "numba")


def test_a_group_of_our_own_is_nobody_else(cache: Path) -> None:
    import grp
    import pwd

    me = pwd.getpwuid(os.geteuid())
    if grp.getgrgid(me.pw_gid).gr_name != me.pw_name:
        pytest.skip("this user has no group of its own")
    (cache / "numba").mkdir(parents=True)
    (cache / "numba").chmod(0o775)
    assert trust_folder(cache / "numba")


@pytest.mark.skipif(not ROOT, reason="only root can give files away")
@pytest.mark.parametrize("which", ["cache/numba/index.nbi", "cache/numba", "cache"])
def test_what_belongs_to_somebody_else_is_refused(cache: Path, which: str) -> None:
    (cache / "numba").mkdir(parents=True, mode=0o700)
    (cache / "numba" / "index.nbi").write_bytes(b"cos\nsystem\n")
    os.chown(cache.parent / which, 1, 1)
    assert f"{(cache.parent / which).resolve()} belongs to " in find_strangers(cache / "numba")
    assert not trust_folder(cache / "numba")


def test_a_link_counts_as_what_it_points_to(cache: Path, tmp_path: Path) -> None:
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    cache.symlink_to(tmp_path / "open")
    assert "everybody may write" in find_strangers(cache / "numba")


def test_it_is_said_once_with_the_way_out(
    cache: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache.mkdir()
    cache.chmod(0o777)
    with caplog.at_level(logging.WARNING):
        assert not trust_folder(cache / "numba") and not trust_folder(cache / "numba")
    (record,) = caplog.records
    text = record.getMessage()
    assert "not cached: everybody may write to" in text and "docs/install.md" in text


_KERNEL = """
import os, sys
from gn0.jit import kernel_cache, njit

@njit
def twice(x: float) -> float:
    return 2.0 * x

twice(1.5)
print(kernel_cache())
assert not kernel_cache() or "scipy.linalg" not in sys.modules, "which takes long to import"
"""


def start(tmp_path: Path, **more: str) -> subprocess.CompletedProcess[str]:
    """A process of its own: where kernels are kept is settled when the package is imported."""
    known = {
        k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "GN0_CACHE_REFUSED")
    }
    script = tmp_path / "kernel.py"
    script.write_text(_KERNEL)
    return subprocess.run(
        [sys.executable, script], env={**known, **more}, capture_output=True, text=True, check=True
    )


def test_a_numba_cache_dir_that_is_not_there_yet_is_made_and_used(tmp_path: Path) -> None:
    place = tmp_path / "not" / "yet"
    done = start(tmp_path, NUMBA_CACHE_DIR=str(place))
    assert done.stdout.strip() == str(place) and not done.stderr
    assert list(place.glob("*twice-*/*.nbi"))


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "GN0_CACHE"])
def test_without_a_cache_kernels_run_and_nothing_is_left_in_the_open(
    tmp_path: Path, variable: str
) -> None:
    place = tmp_path / "open"
    place.mkdir()
    place.chmod(0o777)
    done = start(tmp_path, **{variable: str(place)})
    assert done.stdout.strip() == "None" and not list(place.rglob("*.nb*"))
    assert done.stderr.count("compiled kernels are not cached") == 1


def test_doctor_shows_whose_it_is(cache: Path) -> None:
    told, well = doctor._kernel_cache()
    assert well and told.endswith("which nobody else can write")
    (cache / "cuda").mkdir(parents=True, exist_ok=True)
    (cache / "cuda").chmod(0o777)
    told, well = doctor._kernel_cache()
    assert not well and "not used: everybody may write to" in told and "GN0_CACHE" in told
