"""NVRTC compiles every kernel of the package for every generation of cards, without one."""

from __future__ import annotations

import logging
import re
from pathlib import Path

import pytest

from gn0.device import nvrtc
from gn0.device.arguments import parse_prototypes
from gn0.device.compile import cache_path, compile_source, load_image, read_image
from gn0.device.device import KernelSource
from gn0.device.launch import _differs
from gn0.device.nvrtc import NvrtcFile, find_nvrtc, open_nvrtc
from gn0.device.sources import kernel_files, kernel_sources
from gn0.errors import DeviceError

compiler = pytest.mark.skipif(find_nvrtc() is None, reason="NVRTC: pip install -e '.[gpu]'")


@pytest.fixture
def small(tmp_path: Path) -> KernelSource:
    path = tmp_path / "small.cu"
    path.write_text("KERNEL(small)(int *a, float b) { a[threadIdx.x] = fmaf(b, 2.0f, WIDTH); }\n")
    return KernelSource("small", (path,), (("WIDTH", 3),))


def test_every_kernel_file_is_in_a_source() -> None:
    """Else it would be neither checked here nor compiled ahead of time by `gn0 doctor`."""
    named = {path for source in kernel_sources() for path in source.files}
    assert set(kernel_files()) <= named


LARGE = next(source for source in kernel_sources() if source.name == "parts")


@pytest.mark.slow
@compiler
@pytest.mark.parametrize(
    ("source", "arch"),
    [
        pytest.param(source, arch, id=f"{source.name}-{source.digest[:4]}-{arch}")
        for source in kernel_sources()
        # text differs before sm_80 only
        for arch in ("sm_75", "sm_90", *(["sm_100"] if source is LARGE else []))
    ],
)
def test_every_source_compiles(source: KernelSource, arch: str) -> None:
    assert compile_source(source, arch).startswith(b"\x7fELF")


_BYTES = {"8": 1, "16": 2, "32": 4, "64": 8}
# of each text one source; the others differ in sizes, and in no parameter
FIRSTS = {source.files: source for source in reversed(kernel_sources())}
OTHERS = [source for source in kernel_sources() if source not in FIRSTS.values()]


@compiler
@pytest.mark.parametrize(
    "source",
    [*FIRSTS.values(), *(pytest.param(source, marks=pytest.mark.slow) for source in OTHERS)],
    ids=lambda s: f"{s.name}-{s.digest[:4]}",
)
def test_kernels_take_the_parameters_that_their_prototypes_say(source: KernelSource) -> None:
    """As they are read from the text: a launch puts each at an address by these.

    What is wrong in the text of a source is told here; machine code of each card is made later.
    """
    text = compile_source(source, "compute_90").decode()
    taken = {
        name: [
            int(many[0]) if (many := re.findall(r"\[(\d+)\]", one)) else
            _BYTES[re.findall(r"\.[usbf](8|16|32|64)\b", one)[0]]
            for one in re.findall(r"\.param [^,]*", inside)
        ]
        for name, inside in re.findall(r"\.entry (\w+)\(([^)]*)\)", text)
    }  # fmt: skip
    said = parse_prototypes(source.text)
    assert taken.keys() == said.keys()
    for name, parameters in said.items():
        types = [kind for _, kind in parameters]
        assert len(types) == len(taken[name])
        assert not any(map(_differs, types, taken[name])), (name, types, taken[name])


@compiler
def test_an_error_names_file_and_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.cu"
    path.write_text("KERNEL(broken)(int *a) {\n  a[0] = nonsense;\n}\n")
    with pytest.raises(DeviceError, match=r"module broken.*\n.*broken\.cu\(2\).*nonsense"):
        compile_source(KernelSource("broken", (path,)), "sm_90")


@compiler
def test_newer_cards_get_ptx_and_older_ones_an_error(small: KernelSource) -> None:
    compiler = open_nvrtc()
    newest = compiler.architectures[-1]
    assert compiler.target((9, 0)) == ("sm_90", True)
    assert compiler.target((newest // 10 + 3, 0)) == (f"compute_{newest}", False)
    with pytest.raises(DeviceError, match="too old"):
        compiler.target((3, 5))
    assert b".visible .entry small" in compile_source(small, f"compute_{newest}")


@compiler
def test_compiled_kernels_are_kept(
    small: KernelSource,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    compiler = open_nvrtc()
    image = load_image(small, (9, 0), compiler)
    path = cache_path(small, "sm_90", compiler)
    assert read_image(path) == image and path.parent == tmp_path / "cache" / "cuda"
    monkeypatch.setattr("gn0.device.compile.compile_source", lambda *_: b"made again")
    assert load_image(small, (9, 0), compiler) == image
    assert load_image(small, (9, 0), compiler, fresh=True) == b"made again"
    for damage in (b"", b"short", path.read_bytes()[:-1], path.read_bytes()[:-1] + b"x"):
        path.write_bytes(damage)
        with caplog.at_level(logging.WARNING):
            assert load_image(small, (9, 0), compiler) == b"made again"
        assert read_image(path) == b"made again"
    assert "damaged" in caplog.text


@compiler
def test_what_it_depends_on_is_in_the_name(small: KernelSource) -> None:
    compiler = open_nvrtc()
    other = KernelSource("small", small.files, (("WIDTH", 4),))
    paths = {cache_path(s, a, compiler) for s in (small, other) for a in ("sm_80", "sm_90")}
    assert len(paths) == 4


@compiler
def test_a_cache_that_cannot_be_written_costs_a_warning(
    small: KernelSource,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    (tmp_path / "cache").write_text("a file, not a folder")
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    with caplog.at_level(logging.WARNING):
        assert load_image(small, (9, 0), open_nvrtc()).startswith(b"\x7fELF")
    assert "not cached" in caplog.text


def test_a_compiler_newer_than_the_driver_is_the_last_choice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    files = (NvrtcFile("a", 12), NvrtcFile("b", 13))
    monkeypatch.setattr(nvrtc, "_candidates", lambda: files)
    assert find_nvrtc() == files[1] and find_nvrtc(13) == files[1]
    assert find_nvrtc(12) == files[0] and find_nvrtc(11) == files[1]
    monkeypatch.setattr(nvrtc, "_candidates", tuple)
    assert find_nvrtc() is None
    with pytest.raises(DeviceError, match=r"no CUDA compiler.*pip install -e '\.\[gpu\]'"):
        open_nvrtc.__wrapped__()


@compiler
def test_a_compiler_that_cannot_be_loaded_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    good, bad = find_nvrtc(), tmp_path / "libnvrtc.so.99"
    bad.write_bytes(b"not a library")
    assert good is not None
    monkeypatch.setattr(nvrtc, "_candidates", lambda: (NvrtcFile(str(bad), 99), good))
    assert open_nvrtc.__wrapped__().path == good.path
    assert "cannot be used" in caplog.text and good.path in caplog.text
    monkeypatch.setattr(nvrtc, "_candidates", lambda: (NvrtcFile(str(bad), 99),))
    with pytest.raises(DeviceError, match=r"cannot be used"):
        open_nvrtc.__wrapped__()


def test_compilers_are_found_in_wheels_and_toolkits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("site/lib/libnvrtc.so.13", "home/lib64/libnvrtc.so.12.4.127"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).touch()
    for name in ("libnvrtc.alt.so.13", "libnvrtc-builtins.so.13.0"):
        (tmp_path / "site" / "lib" / name).touch()
    folders = [tmp_path / "site" / "lib", tmp_path / "home" / "lib64"]
    monkeypatch.setattr(nvrtc, "_folders", lambda: iter(folders))
    monkeypatch.setattr(nvrtc.sys, "platform", "linux")
    found = nvrtc._candidates.__wrapped__()
    assert [(Path(file.path).name, file.major) for file in found] == [
        ("libnvrtc.so.13", 13),
        ("libnvrtc.so.12.4.127", 12),
    ]


@compiler
def test_the_compilers_second_library_is_loaded_from_beside_it(tmp_path: Path) -> None:
    """CUDA 13's does not look beside itself, and without it nothing compiles."""
    found = find_nvrtc()
    assert found is not None
    if Path(found.path).is_absolute():
        assert open_nvrtc()._builtins
    (tmp_path / "libnvrtc-builtins.so.13.0").write_bytes(b"not a library")
    assert nvrtc._load_builtins(tmp_path / "libnvrtc.so.13") == []


def test_a_damaged_compiler_says_so(tmp_path: Path) -> None:
    path = tmp_path / "libnvrtc.so.12"
    path.write_bytes(b"not a library")
    with pytest.raises(DeviceError, match=r"cannot be used.*pip install"):
        nvrtc.Nvrtc(NvrtcFile(str(path), 12))


@compiler
def test_machine_code_in_a_folder_that_others_may_write_is_not_run(
    small: KernelSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    compiler = open_nvrtc()
    load_image(small, (9, 0), compiler)
    path = cache_path(small, "sm_90", compiler)
    kept = path.read_bytes()
    monkeypatch.setattr("gn0.device.compile.compile_source", lambda *_: b"made here")
    assert load_image(small, (9, 0), compiler) != b"made here"
    path.parent.chmod(0o777)
    assert load_image(small, (9, 0), compiler) == b"made here"
    assert path.read_bytes() == kept, "and nothing is written there either"
