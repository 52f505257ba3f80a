"""Ask a trained policy to go somewhere: it walks, and a video and a page show how.

SCENE is a scene folder, a splat file or whatever else `gn0 scene import` reads, or KIND:SEED for a
building from a seed, such as apartment:7. Without --start it begins at a free place, drawn by the
seed. No goal is known, so nothing is scored: told is how the walk ended, where, and how far the
nearest thing of the name in the text is, where the scene has labels.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import tyro

from gn0.config import Config

if TYPE_CHECKING:
    from gn0.policies.bae.policy_bae import PolicyBae
    from gn0.progress import Progress
    from gn0.scenes.scene import Scene

EXAMPLES = """  gn0 policy ask bae out/flat "go to the sofa" --out out/ask
  gn0 policy ask bae apartment:7 "find the fridge in the kitchen" --out out/fridge
  gn0 policy ask bae out/flat "go to the sofa" --inputs views --out out/seen
  gn0 policy ask out/sft/policy room.ply "walk to the window" --start 1.5,2,90 --out out/window"""
MARKER, FILM, PAGE, POSTER, SCENE = "walk.json", "walk.mp4", "index.html", "end.png", "scene"


class Args(Config, frozen=True):
    """Who is asked, where, and what.

    Attributes:
        checkpoint: the folder of a trained policy, or of its run; `bae` for the one in the box.
        scene: a scene folder, a splat file, or KIND:SEED; the last two are made a scene in OUT.
        text: what it is asked, in words.
        out: the folder for walk.mp4, index.html and walk.json.
        start: X,Y,DEGREES where it begins; a free place by the seed without.
        seed: of the start.
        steps: actions at most.
        inputs: in which of its ways a checkpoint is asked that was trained in several; its default
            when empty.
        executed: actions of an answer that are carried out; 0 for as many as the checkpoint says.
        computed_by: torch, numpy, or auto: torch where it is installed.
        backend: what draws pictures: cpu, cuda, or the best available (auto).
        overwrite: replace an earlier walk in that folder.
    """

    checkpoint: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CHECKPOINT")]
    scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")]
    text: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="TEXT")]
    out: str
    start: str = ""
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    steps: Annotated[int, msgspec.Meta(ge=1, le=5000)] = 200
    inputs: str = ""
    executed: Annotated[int, msgspec.Meta(ge=0, le=6)] = 0
    computed_by: Literal["auto", "torch", "numpy"] = "auto"
    backend: Literal["auto", "cpu", "cuda"] = "auto"
    overwrite: bool = False


def run(args: Args) -> int:
    """Walk, film and tell."""
    from gn0.cli.console import draw_progress, plain_text
    from gn0.cli.policy_show import read_pose
    from gn0.policies.bae.errand import check_errand
    from gn0.policies.bae.policy_bae import PolicyBae
    from gn0.storage import check_replaceable, write_json

    out = Path(args.out)
    start = read_pose(args.start, "--start") if args.start else None
    policy = PolicyBae(
        args.checkpoint, inputs=args.inputs, executed=args.executed, backend=args.computed_by
    )
    words = check_errand(policy, args.text)
    overwrite = args.overwrite or _is_unfinished(out)
    check_replaceable(out, overwrite=overwrite, marker=MARKER)
    check_scene(args.scene)
    write_json(out / MARKER, {"unfinished": True})  # by it the folder is known
    with draw_progress() as progress:
        scene = _open_scene(args, out / SCENE, progress)
        told = _walk(args, policy, scene, words, start, out, progress)
    for line in told:
        print(plain_text(line))
    print(f"video: {out / FILM}")
    print(f"page:  {(out / PAGE).resolve()}   (open it in a browser)")
    if (out / SCENE).is_dir() and str(out / SCENE) != args.scene:
        print(f'next:  gn0 policy ask {args.checkpoint} {out / SCENE} "…" --out {out}-2')
    return 0


def _is_unfinished(out: Path) -> bool:
    """Whether an earlier walk there was stopped, so that nothing of it is worth keeping."""
    from gn0.config import load_json
    from gn0.errors import Gn0Error

    try:
        return bool(load_json(out / MARKER, dict).get("unfinished"))
    except Gn0Error:
        return False


def _walk(
    args: Args, policy: PolicyBae, scene: Scene, words: str, start: object, out: Path,
    progress: Progress,
) -> list[str]:  # fmt: skip
    import msgspec as m

    from gn0.geometry import Pose2D
    from gn0.policies.bae.decision import StepAsked, walk_asked
    from gn0.policies.bae.errand import build_errand, end_errand
    from gn0.render.open import build_renderer, name_drawing
    from gn0.render.renderer import DrawnScene
    from gn0.sim.open import open_simulator
    from gn0.storage import write_atomic, write_bytes, write_json, write_text
    from gn0.viewer.errand_film import encode_film, render_page

    assert start is None or isinstance(start, Pose2D)
    settings = policy.questions.settings
    renderer = build_renderer(scene.gaussians, name_drawing(args.backend))
    simulator = open_simulator(
        scene,
        settings.camera,
        args.backend,
        sensors=policy.sensors,
        max_steps=args.steps,
        map_view=policy.map_view,
        renderer=DrawnScene(renderer),
    )
    errand = build_errand(simulator, words, start, args.seed)
    steps: list[StepAsked] = []
    for step in walk_asked(policy, simulator, errand):
        progress("walking", len(steps), args.steps)
        steps.append(step)
    progress("walking", args.steps, args.steps)
    end = end_errand(simulator, words, steps)
    film, last = encode_film(simulator, renderer, settings, errand, steps, end, progress=progress)
    x, y, yaw = errand.start
    facts = [
        ("scene", scene.id),
        ("start", f"{x:.3f}, {y:.3f} m, heading {yaw:.4f} rad" + ("" if start else
         f", drawn with seed {args.seed}")),
        ("most steps", str(args.steps)),
        *policy.card_rows,
        ("checkpoint", str(policy.identity()["checkpoint"])),
    ]  # fmt: skip
    write_bytes(out / FILM, film)
    write_text(out / PAGE, render_page(errand, steps, end, film, facts))
    write_atomic(out / POSTER, lambda stream: last.save(stream, "PNG"))
    write_json(
        out / MARKER,
        {
            "instruction": words,
            "scene": scene.id,
            "scene_hash": scene.content_hash,
            "start": [x, y, yaw],
            "seed": args.seed,
            "policy": dict(policy.identity()),
            "end": {
                **m.to_builtins(end),
                "distance": end.distance if end.target and end.targets else None,
            },
            "steps": [
                {
                    "pose": list(step.pose), "action": step.action, "cut_short": step.collided,
                    **({"said": step.decision.answer} if step.asked else {}),
                }
                for step in steps
            ],
        },
    )  # fmt: skip
    return list(end.lines)


def read_kind(text: str) -> tuple[str, int] | None:
    """KIND and seed of KIND:SEED; None where it is something else.

    Raises:
        ConfigError: a kind without a seed that makes sense.
    """
    from gn0.errors import ConfigError
    from gn0.scenes.procedural.kinds import KINDS

    kind, colon, seed = text.partition(":")
    if kind not in KINDS or Path(text).exists():
        return None
    if not colon or not seed.isdecimal() or int(seed) > 2**62:
        raise ConfigError(
            f"{text[:60]!r} has no seed", where="SCENE", remedy=f"give {kind}:SEED, e.g. {kind}:7"
        )
    return kind, int(seed)


def check_scene(text: str) -> None:
    """Refuse what no scene can be made of, before any work.

    Raises:
        StorageError, ConfigError: there is nothing there, or it is a suite.
    """
    from gn0.errors import ConfigError, StorageError
    from gn0.scenes.procedural.kinds import KINDS

    if read_kind(text) is not None:
        return
    place = Path(text)
    if not place.exists():
        raise StorageError(
            "no such scene",
            where=text[:200],
            remedy="give a scene folder, a splat file, or a building from a seed: "
            + ", ".join(f"{kind}:7" for kind in list(KINDS)[:3]),
        )
    if (place / "suite.json").is_file():
        raise ConfigError(
            "is a suite, not a scene",
            where=text,
            remedy=f"give one of the folders in {text}/scenes",
        )


def _open_scene(args: Args, made: Path, progress: Progress) -> Scene:
    """The scene; what is none yet becomes one in `made`."""
    from gn0.cli.console import say_aside
    from gn0.scenes.folder import load_scene

    kind = read_kind(args.scene)
    if kind is not None:
        from gn0.cli.compile_ahead import compile_ahead
        from gn0.scenes.procedural.generate import GenerateSettings, generate_scene

        settings = GenerateSettings(kind=kind[0], seed=kind[1], light="draft")  # type: ignore[arg-type]
        with compile_ahead("missions", "walk", cores=2):
            return generate_scene(settings, made, overwrite=True, progress=progress)
    place = Path(args.scene)
    if (place / "scene.json").is_file():
        return load_scene(place)
    from gn0.scenes.scene_sources import import_scene

    return import_scene(place, made, overwrite=True, progress=progress, tell=say_aside)
