"""What GN0 makes from fixed seeds, as digests: what a change of structure must leave alone.

    python tests/golden/content.py                 # say what differs from tests/golden.json
    python tests/golden/content.py --write         # write all of it again
    python tests/golden/content.py --write exports # write one part again

Everything is made by commands, which stay, and not by Python paths, which move. A commit that
changes a digest says in its body which, and why.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import os
import platform
import re
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path

import numpy as np

FILE = Path(__file__).parent.parent / "golden.json"
KINDS = ("apartment", "residence", "office", "corridor", "supermarket", "warehouse", "courtyard")
FORMATS = (
    "gn-matrix", "gn-matrix-json", "interndata-n1", "lerobot-v3", "navdp", "navid", "navila",
    "streamvln", "uninavid", "vln-pe", "vlnce-r2r", "vlnce-rxr",
)  # fmt: skip
RUN_FILES = ("results.jsonl", "trajectories.jsonl", "summary.json")  # the others hold times
LEFT_OUT = {".lock"}
VIEWS = 10  # a camera
_VERSION = re.compile(rb"\d+\.\d+\.\d+\+[0-9a-f]{12}")  # as `gn0.bench.protocol` writes it
PACKAGES = ("numpy", "numba", "llvmlite", "scipy", "pillow", "pyarrow", "av")


def made_with() -> dict[str, str]:
    """What may change a byte and is not ours: versions, and the processor code is compiled for."""
    from llvmlite import binding

    found = dict.fromkeys(PACKAGES, "absent")
    for name in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    version = ".".join(platform.python_version_tuple()[:2])
    return {"python": version, "processor": binding.get_host_cpu_name(), **found}


def digest(data: bytes) -> str:
    """Sixteen hexadecimal digits."""
    return hashlib.blake2b(data, digest_size=8).hexdigest()


def read_file(path: Path) -> bytes:
    """A file's bytes, without the version of the code that it names."""
    return _VERSION.sub(rb"", path.read_bytes()) if path.suffix == ".json" else path.read_bytes()


def digest_folder(folder: Path) -> dict[str, str]:
    """One digest for the files of each kind, by the ends of their names."""
    kinds: dict[str, list[bytes]] = defaultdict(list)
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name not in LEFT_OUT:
            name = path.relative_to(folder).as_posix()
            kinds[path.suffix or path.name].append(f"{name} {digest(read_file(path))}".encode())
    return {kind: f"{len(lines)} {digest(b' '.join(lines))}" for kind, lines in kinds.items()}


def command(*words: object) -> None:
    """Run a verb in this process, and mind its exit code."""
    from gn0.cli.main import main

    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = main([str(word) for word in words])
    if code not in (0, 1):  # 1: something is said about the result
        raise AssertionError(f"gn0 {' '.join(map(str, words))}: exit {code}\n{said.getvalue()}")


def make_flat(root: Path) -> Path:
    """The example flat, which is there without a command."""
    from gn0.scenes.example import build_example_scene
    from gn0.scenes.folder import save_scene

    if not (root / "flat").is_dir():
        save_scene(build_example_scene(), root / "flat")
    return root / "flat"


def make_suite(root: Path) -> Path:
    """Three goal episodes in it."""
    out = root / "suite"
    if not out.is_dir():
        command(
            "bench", "suite", make_flat(root), "--episodes", 3, "--seed", 5, "--minimum-length", 2,
            "--out", out,
        )  # fmt: skip
    return out


def make_missions(root: Path) -> Path:
    """Goals, routes and words in it."""
    out = root / "missions"
    if not out.is_dir():
        command(
            "missions", "generate", make_flat(root), "--per-scene", 4, "--seed", 2, "--lights", 2,
            "--minimum-length", 2.5, "--out", out,
        )  # fmt: skip
    return out


def make_data(root: Path, layout: str) -> Path:
    """The walks of the suite."""
    out = root / f"data-{layout}"
    if not out.is_dir():
        command("data", "build", make_suite(root), "--layout", layout, "--backend", "cpu",
                "--depth", "--out", out)  # fmt: skip
    return out


def scene(kind: str, root: Path) -> dict[str, str]:
    """A generated scene of a kind."""
    out = root / kind
    command("scene", "generate", "--kind", kind, "--seed", 3, "--size", "small", "--density", 5000,
            "--light", "draft", "--out", out)  # fmt: skip
    return digest_folder(out)


def suites(root: Path) -> dict[str, str]:
    """A suite that shows all of the map, and one of an unknown flat with another body and track."""
    other = root / "other"
    command("bench", "suite", make_flat(root), "--episodes", 3, "--seed", 6, "--minimum-length", 2,
            "--map-mode", "explored", "--track", "point+pose", "--radius", 0.25, "--camera",
            "rgbd_224", "--out", other)  # fmt: skip
    found = {f"goals {k}": v for k, v in digest_folder(make_suite(root)).items()}
    return found | {f"points {k}": v for k, v in digest_folder(other).items()}


def missions(root: Path) -> dict[str, str]:
    """Generated missions."""
    return digest_folder(make_missions(root))


def data(root: Path) -> dict[str, str]:
    """A dataset in both layouts."""
    return {
        f"{layout} {kind}": value
        for layout in ("webdataset", "lerobot")
        for kind, value in digest_folder(make_data(root, layout)).items()
    }


def exports(root: Path) -> dict[str, str]:
    """Every export of it."""
    found = {}
    source = make_data(root, "webdataset")
    for name in FORMATS:
        more = ("--merge-turns",) if name in ("navid", "uninavid") else ()
        command("export", name, source, "--out", root / name, *more)
        found |= {f"{name} {k}": v for k, v in digest_folder(root / name).items()}
    return found


def runs(root: Path) -> dict[str, str]:
    """Runs of three policies, in two profiles of scoring."""
    found = {}
    for policy in ("oracle", "random", "wall_follower"):
        out = root / f"run-{policy}"
        command("bench", "run", make_suite(root), "--policy", policy, "--backend", "cpu",
                "--out", out)  # fmt: skip
        found |= {f"{policy} {name}": digest(read_file(out / name)) for name in RUN_FILES}
    return found


def pictures(root: Path, backend: str) -> dict[str, str]:
    """Forty pictures of a backend: three cameras inside, one from above; RGB, depth, alpha."""
    from gn0.geometry import view_from_pose
    from gn0.render.bev import bev_camera
    from gn0.render.camera import Camera
    from gn0.render.open import build_renderer
    from gn0.scenes.example import build_example_scene

    flat = build_example_scene()
    renderer = build_renderer(flat.gaussians, backend)
    free = np.argwhere(flat.grid.cells == 0)
    spots = flat.grid.centres_of(free[:: max(1, len(free) // VIEWS)][:VIEWS])
    views = np.stack([
        view_from_pose(x, y, 1.25, 0.7 * k, -0.1) for k, (x, y) in enumerate(spots.tolist())
    ])  # fmt: skip
    found = {}
    for width, height, field in ((64, 48, 90.0), (56, 56, 79.0), (97, 33, 120.0)):
        camera = Camera.from_hfov(width, height, field)
        drawn = renderer.render(camera, views)
        found |= _digest_pictures(f"{width}x{height}", drawn)
    above, view = bev_camera(flat.bounds, 0.15, 1.6)
    tops = np.tile(view, (VIEWS, 1, 1))
    tops[:, 0, 3] += 0.05 * np.arange(VIEWS)
    return found | _digest_pictures("above", renderer.render(above, tops))


def _digest_pictures(name: str, drawn: object) -> dict[str, str]:
    found = {}
    for part in ("rgb", "depth", "alpha"):
        values = getattr(drawn, part)
        for k, picture in enumerate(np.asarray(values)):
            found[f"{name} {k} {part}"] = digest(np.ascontiguousarray(picture).tobytes())
    return found


def bev(root: Path) -> dict[str, str]:
    """The sheet of a scene: plan, map picture, views."""
    out = root / "sheet.png"
    command("scene", "show", make_flat(root), "--out", out)
    from PIL import Image

    return {"sheet": digest(np.asarray(Image.open(out)).tobytes())}


def wire(root: Path) -> dict[str, str]:
    """What a policy server is sent, and answers, in an episode of three steps."""
    from gn0.policies.remote.server import PolicyServer
    from gn0.policies.simple import PolicyRandom

    frames: list[bytes] = []
    answers = PolicyServer._answer

    def listen(self: PolicyServer, session: object, frame: bytes, who: object) -> bytes:
        reply = answers(self, session, frame, who)  # type: ignore[arg-type]
        frames.extend((frame, reply))  # type: ignore[arg-type]
        return reply  # type: ignore[return-value]

    PolicyServer._answer = listen  # type: ignore[assignment, method-assign]
    try:
        with PolicyServer(PolicyRandom, port=0, token="") as server:
            frames.append(server._greeting)
            url = f"url={server.url}"
            command("bench", "run", make_suite(root), "--policy", "remote", "--policy-option", url,
                    "--limit", 1, "--backend", "cpu", "--out", root / "remote")  # fmt: skip
    finally:
        PolicyServer._answer = answers  # type: ignore[method-assign]
    return {f"frame {k:03d}": digest(frame) for k, frame in enumerate(frames[:12])} | {
        "frames": f"{len(frames)} {digest(b''.join(frames))}"
    }


def _of_kind(kind: str) -> Callable[[Path], dict[str, str]]:
    return lambda root: scene(kind, root)


def _cuda(root: Path) -> dict[str, str]:
    with variable("GN0_DEVICE", "host"):
        return pictures(root, "cuda")


PARTS: dict[str, Callable[[Path], dict[str, str]]] = {
    **{f"scene {kind}": _of_kind(kind) for kind in KINDS},
    "suites": suites,
    "missions": missions,
    "data": data,
    "exports": exports,
    "runs": runs,
    "bev": bev,
    "pictures cpu": lambda root: pictures(root, "cpu"),
    "pictures cuda": _cuda,
    "wire": wire,
}


@contextlib.contextmanager
def variable(name: str, value: str) -> Iterator[None]:
    """An environment variable for a while."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def differences(part: str, found: dict[str, str]) -> list[str]:
    """Names whose digests differ from the file's, and names that only one side has."""
    wanted = json.loads(FILE.read_text())["parts"].get(part, {})
    return sorted(k for k in wanted.keys() | found.keys() if wanted.get(k) != found.get(k))


def main() -> int:
    """Compare or write."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    golden = json.loads(FILE.read_text()) if FILE.exists() else {"made with": {}, "parts": {}}
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in asked.parts or PARTS:
            found = PARTS[name](Path(folder))
            if asked.write:
                golden["parts"][name] = found
            else:
                different = differences(name, found)
                wrong += len(different)
                print(f"{name}: {', '.join(different) or 'as before'}", flush=True)
    if asked.write:
        golden["made with"] = made_with()
        FILE.write_text(json.dumps(golden, indent=1, ensure_ascii=False) + "\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
