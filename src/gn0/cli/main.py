"""The `gn0` command: finds the verb, parses its settings strictly, and reports errors plainly.

Nothing heavy is imported before the verb is known, so `gn0 --help` answers at once.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

# verb -> (module, one line); the order is the order of --help
VERBS: dict[str, tuple[str, str]] = {
    "demo": ("demo", "generate an apartment, run four policies through it, write the report"),
    "doctor": ("doctor", "what is installed here, which renderer would run, and why"),
    "scene generate": ("scene_generate", "a furnished building from a seed: homes, offices, halls"),
    "scene import": ("scene_import", "a splat file, InteriorGS folder or Gazebo world as a scene"),
    "scene corpus": ("scene_corpus", "many scenes with train, unseen and test splits"),
    "scene furniture": (
        "scene_furniture",
        "draw the catalogue of furniture of generated scenes",
    ),
    "scene check": ("scene_check", "say in plain words what is wrong with a scene"),
    "scene show": ("scene_show", "draw a sheet: plan, bird's-eye view, four views"),
    "scene light": ("scene_light", "see a scene by day, dusk and lamplight; write a variant"),
    "scene visible": ("scene_visible", "find which splats show from where, for quicker pictures"),
    "scene inspect": ("scene_inspect", "what a splat file of any format holds"),
    "scene convert": ("scene_convert", "any splat file as .ply or .compressed.ply"),
    "avatar generate": ("avatar_generate", "dressed people from a seed, and a page of them"),
    "avatar show": ("avatar_show", "draw an avatar, or a page of a bank of them"),
    "avatar animate": ("avatar_animate", "let an avatar walk, wave, sit or move by a file"),
    "avatar import": (
        "avatar_import",
        "a person of yours: splats of LHM, or a mesh (.glb)",
    ),
    "avatar check": ("avatar_check", "skin through clothes, feet off the floor, wrong colours"),
    "view": ("view", "walk through a scene in the browser, or replay runs side by side"),
    "bench run": ("bench_run", "run a policy over a suite, or over a scene folder"),
    "bench report": ("bench_report", "one HTML page from one or more runs"),
    "bench compare": (
        "bench_compare",
        "whether run A is better or worse than run B, or too close to tell",
    ),
    "bench replay": ("bench_replay", "drive a run's actions again and compare every byte"),
    "bench suite": ("bench_suite", "build a suite of goal episodes from scene folders"),
    "missions generate": ("missions_generate", "goals, paths and instructions in your scenes"),
    "missions import": ("missions_import", "GN-Matrix or VLN-CE episodes as a suite"),
    "missions export": ("missions_export", "a suite as GN-Matrix or VLN-CE episodes"),
    "missions show": ("missions_show", "draw episodes over map and bird's-eye view"),
    "missions describe": ("missions_describe", "routes in words: steps, landmarks, texts, checks"),
    "data build": ("data_build", "walk, label and draw the episodes of a suite as a dataset"),
    "data merge": ("data_merge", "join the shards of a dataset that several machines built"),
    "data render": ("data_render", "draw the pictures of a dataset again, bit for bit"),
    "data show": ("data_show", "draw a sample sheet: pictures, waypoints, actions"),
    "data prompt": ("data_prompt", "print what a model is asked at a sample, and its answer"),
    "data stats": ("data_stats", "one page about paths, turns, actions, words, goals, scenes"),
    "data verify": ("data_verify", "read every byte again and name what is damaged"),
    "data repair": ("data_repair", "rebuild what is damaged, byte for byte"),
    "data balance": ("data_balance", "balance the actions of a dataset to the paper's shares"),
    "data dagger": ("data_dagger", "states that a policy visits, labelled by the expert"),
    "train sft": ("train_sft", "a policy that does what the expert would do"),
    "train dagger": ("train_dagger", "a policy that learns where its own walks lead"),
    "train dapo": ("train_dapo", "a policy that learns from where its answers lead"),
    "train rl": ("train_rl", "a policy that learns from where its own walks end"),
    "train baseline": ("train_baseline", "CMA or Seq2Seq to compare with, retrained, small"),
    "train tokenizer": ("train_tokenizer", "words of suites and datasets as tokens of a policy"),
    "train page": ("train_page", "a page of a run: curves, examinations, recipe and hashes"),
    "policy ask": ("policy_ask", "say where to go in a scene; see the walk as a video"),
    "policy show": ("policy_show", "one decision of a trained policy, or cases of a run, to see"),
    "policy examine": ("policy_examine", "a policy walks a suite on a device, thousands at once"),
    "policy study": ("policy_study", "one page of many policies: intervals and verdicts"),
    "policy pack": ("policy_pack", "a run's policy as it is shipped: small files, model card"),
    "copy": ("copy_folder", "a folder to or from an object store: s3://, gs://, hf://"),
    "export": ("export", "a dataset for VLN-CE, LeRobot, NaVid, StreamVLN, NavDP and others"),
    "export check": ("export_check", "check an export for everything its reader assumes"),
    "list": ("list_names", "policies, presets, sensors, exports, formats: the names to type"),
    "completion": ("completion", "let bash, zsh or fish complete verbs, flags and their values"),
    "figures": ("figures", "measure the figures of merit and write the board"),
}
# verb -> the jobs of `gn0.kernels.kernel_list` whose kernels it may need: compiled beside it, on
# idle cores
KERNELS: dict[str, tuple[str, ...]] = {
    "scene generate": ("scene",),
    "scene corpus": ("scene",),
    "view": ("walk",),
    "bench run": ("walk", "follow"),
    "missions generate": ("missions",),
    "data build": ("data",),
    "data dagger": ("data",),
    "train sft": ("device", "train"),
    "train dagger": ("device", "train"),
    "train dapo": ("device", "train"),
    "train rl": ("device", "train"),
    "policy examine": ("device",),
}
GROUPS = {
    "scene": "make, import, check and look at scenes",
    "avatar": "people for scenes: make, look at, move, check",
    "missions": "generate, import and look at episodes",
    "data": "make samples for training, balance and check them",
    "bench": "run policies, compare and report",
    "train": "train policies; needs the extra `train`",
    "policy": "look at trained policies, ask, examine, compare and ship them",
}
EXAMPLES = """examples:
  gn0 demo --out out/demo
  gn0 scene generate --kind apartment --seed 7 --out out/flat
  gn0 scene import path/to/world --out out/house
  gn0 bench run out/house --policy oracle --workers 2 --out out/house-oracle"""
_TOLD_ELSEWHERE = ("text", "motion")  # where these are empty, their verbs say more


def top_help(group: str = "") -> str:
    """Help of the whole command, or of one group of verbs."""
    lines = [f"usage: gn0 {group or 'VERB'} ... [--help]", ""]
    if not group:
        lines += ["Embodied navigation in 3D Gaussian Splatting scenes.", ""]
    verbs = {v: t for v, (_, t) in VERBS.items() if not group or v.split()[0] == group}
    width = max(map(len, verbs)) + 2
    lines += ["verbs:", *(f"  {verb:<{width}}{text}" for verb, text in verbs.items()), ""]
    lines.append(EXAMPLES if not group else f"gn0 {group} VERB --help says more.")
    return "\n".join(lines)


def find_verb(argv: Sequence[str]) -> tuple[str, list[str]]:
    """The verb at the start of `argv` and the arguments left; verb "" when there is none."""
    for length in (2, 1):
        verb = " ".join(argv[:length])
        if len(argv) >= length and verb in VERBS:
            return verb, list(argv[length:])
    return "", list(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 well, 1 a finding, 2 an error, 130 stopped."""
    argv = list(sys.argv[1:] if argv is None else argv)
    verb, rest = find_verb(argv)
    if not verb:
        return _no_verb(argv)
    module = import_module(f"gn0.cli.{VERBS[verb][0]}")
    from gn0.cli.console import plain_streams, plain_text
    from gn0.errors import Gn0Error

    try:
        args = parse_arguments(module, verb, rest)
        with plain_streams():
            return _run(module, verb, args)
    except Gn0Error as error:
        print(plain_text(format_error(error), lines=True), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\ngn0: stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output went away
        sys.stderr.close()
        return 141


def _run(module: Any, verb: str, args: Any) -> int:
    """Run a verb; URLs among its arguments are local paths to it."""
    values = [getattr(args, name) for name in args.__struct_fields__]
    if "://" not in repr(values):
        return _run_here(module, verb, args)
    from gn0.cli.urls import bring_here, publish_made

    args, target = bring_here(verb, args)
    code = _run_here(module, verb, args)
    if target and code in (0, 1):
        publish_made(args, target)
    return code


def _run_here(module: Any, verb: str, args: Any) -> int:
    """Run a verb while idle cores compile the kernels that it will need, once a machine."""
    if verb not in KERNELS:
        return int(module.run(args) or 0)
    from gn0.cli.compile_ahead import compile_ahead

    with compile_ahead(*KERNELS[verb]):
        return int(module.run(args) or 0)


def _no_verb(argv: list[str]) -> int:
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(top_help())
        return 0
    if argv[0] == "--version":
        from gn0 import __version__

        print(f"gn0 {__version__}")
        return 0
    if argv[0] in GROUPS and (len(argv) == 1 or argv[1] in ("-h", "--help")):
        print(top_help(argv[0]))
        return 0
    said = " ".join(argv[:2] if argv[0] in GROUPS else argv[:1])
    near = suggest_verb(argv)
    hint = f"did you mean `gn0 {near}`?" if near else "see `gn0 --help`"
    print(f"gn0: no verb {said!r}; {hint}", file=sys.stderr)
    return 2


def suggest_verb(argv: Sequence[str]) -> str:
    """The verb nearest to what was typed, over whole verbs; "" when none is near.

    Compared are the first word and the first two, also in the other order (`generate scene`), with
    the verbs and with their last words alone (`replay`).
    """
    words = [word.lower() for word in argv[:2] if not word.startswith("-")]
    typed = {" ".join(words), " ".join(reversed(words)), words[0] if words else ""} - {""}
    best: tuple[float, str] = (0.0, "")
    for verb in VERBS:
        for name in {verb, verb.replace(" ", ""), verb.replace(" ", "-"), verb.rpartition(" ")[2]}:
            for text in typed:
                far = 0 if len(text) > 2 and name.startswith(text) else edit_distance(text, name)
                if far <= max(1, min(len(text), len(name)) // 3):
                    # a whole verb rather than its last word, and the longer text, which tells more
                    score = 1.0 + len(text) - 2.0 * far + (0.5 if name == verb else 0.0)
                    best = max(best, (score, verb), key=lambda found: found[0])
    return best[1]


def edit_distance(a: str, b: str) -> int:
    """Letters to insert, remove, replace or swap with the next to turn one into the other."""
    rows = [list(range(len(b) + 1))]
    for i, letter in enumerate(a, 1):
        row = [i]
        for j, other in enumerate(b, 1):
            least = min(rows[-1][j] + 1, row[-1] + 1, rows[-1][j - 1] + (letter != other))
            if i > 1 and j > 1 and letter == b[j - 2] and a[i - 2] == other:
                least = min(least, rows[-2][j - 2] + 1)
            row.append(least)
        rows.append(row)
    return rows[-1][-1]


def parse_arguments(module: Any, verb: str, rest: list[str]) -> Any:
    """Parse and check a verb's `Args`; exits with usage and code 2 when they do not fit."""
    import msgspec
    import tyro

    from gn0.config import check_config
    from gn0.errors import ConfigError

    doc = (module.__doc__ or "").strip()
    args = tyro.cli(
        module.Args,
        prog=f"gn0 {verb}",
        description=f"{doc}\n\nexamples:\n{module.EXAMPLES}",
        args=rest,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    for given in msgspec.structs.fields(module.Args):
        if given.name in _TOLD_ELSEWHERE or not given.required:
            continue
        if getattr(args, given.name) == "":  # Path("") would be the folder here
            raise ConfigError(
                "it is empty",
                where=f"--{given.name.replace('_', '-')}" if given.name == "out" else given.name,
                remedy="give a name; a shell variable that is not set leaves it empty",
            )
    try:
        return check_config(args)
    except ConfigError as error:
        what, _, field = error.what.partition(" - at `$.")
        flag = "--" + field.rstrip("`").replace("_", "-") if field else verb
        raise ConfigError(what, where=flag, remedy=f"see `gn0 {verb} --help`") from None


def format_error(error: Any) -> str:
    """An error as the user reads it: code, place, what, and the remedy on its own line."""
    place = f"{error.where}: " if error.where else ""
    text = f"gn0: error [{error.code}] {place}{error.what}"
    return text + (f"\n  → {error.remedy}" if error.remedy else "")


def entry() -> None:
    """Console-script entry point."""
    raise SystemExit(main())


if __name__ == "__main__":
    entry()
