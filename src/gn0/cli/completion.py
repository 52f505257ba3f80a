"""Completion of verbs, flags and their values in bash, zsh and fish.

The script is printed; its first lines say how to load it. It contains this version's verbs and
flags, so print it again after an update.
"""

from __future__ import annotations

import re
from importlib import import_module
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 completion bash > ~/.local/share/bash-completion/completions/gn0
  gn0 completion zsh >> ~/.zshrc
  gn0 completion fish > ~/.config/fish/completions/gn0.fish"""


class Args(Config, frozen=True):
    """For which shell.

    Attributes:
        shell: bash, zsh or fish.
    """

    shell: Annotated[
        Literal["bash", "zsh", "fish"], tyro.conf.Positional, tyro.conf.arg(metavar="SHELL")
    ]


def run(args: Args) -> int:
    """Print the script."""
    words = list_words()
    print({"bash": _bash, "zsh": _zsh, "fish": _fish}[args.shell](words), end="")
    return 0


def list_words() -> dict[str, dict[str, tuple[str, ...]]]:
    """Values by verb and flag; empty where any will do. Those of positionals stand under "".

    The verbs of a group stand under the group's name, as the values of "".
    """
    from gn0.cli.main import GROUPS, VERBS

    found: dict[str, dict[str, tuple[str, ...]]] = {
        "": {"": tuple(dict.fromkeys(verb.split()[0] for verb in VERBS))}
    }
    for group in GROUPS:
        found[group] = {"": tuple(v.split()[1] for v in VERBS if v.startswith(group + " "))}
    for verb, (module, _) in VERBS.items():
        found.setdefault(verb, {}).update(_flags(import_module(f"gn0.cli.{module}").Args))
    found["export"][""] = (*_names("dataset_exporter"), "check")
    return found


def _flags(settings: Any) -> dict[str, tuple[str, ...]]:
    flags: dict[str, tuple[str, ...]] = {"--help": ()}
    for name, hint in get_type_hints(settings, include_extras=True).items():
        if name not in settings.__struct_fields__:
            continue
        marks = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
        values = _values(hint) or _KNOWN.get(name, tuple)()
        if any(mark is tyro.conf.Positional or "Positional" in str(mark) for mark in marks):
            flags[""] = flags.get("", ()) + values
            continue
        flags[f"--{name.replace('_', '-')}"] = values
        for mark in marks:
            for alias in getattr(mark, "aliases", None) or ():
                flags[alias] = values
    return flags


def _values(hint: Any) -> tuple[str, ...]:
    """Choices of a `Literal`, also within unions and annotations."""
    if get_origin(hint) is Literal:
        return tuple(str(value) for value in get_args(hint) if value)
    return tuple(value for part in get_args(hint) for value in _values(part))


def _names(kind: Any) -> tuple[str, ...]:
    from gn0.plugins import plugin_names

    return tuple(plugin_names(kind))


def _presets() -> tuple[str, ...]:
    from gn0.sim.presets import preset_names

    return tuple(preset_names())


_KNOWN = {"policy": lambda: _names("policy"), "camera": _presets}


def _bash(words: dict[str, dict[str, tuple[str, ...]]]) -> str:
    cases = []
    for verb, flags in words.items():
        for flag, values in flags.items():
            if flag and values:
                cases.append(f'    "{verb} {flag}") words="{" ".join(values)}" ;;')
    offers = []
    for verb, flags in words.items():
        plain = " ".join([*flags.get("", ()), *(flag for flag in flags if flag)])
        offers.append(f'    "{verb}") words="{plain}" ;;')
    return f"""# bash completion of gn0: save as ~/.local/share/bash-completion/completions/gn0
_gn0() {{
  local word="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" verb="" words=""
  if [ "$COMP_CWORD" -gt 1 ]; then
    verb="${{COMP_WORDS[1]}}"
    case "$verb ${{COMP_WORDS[2]}}" in
      {"|".join(f'"{verb}"' for verb in words if " " in verb)})
        [ "$COMP_CWORD" -gt 2 ] && verb="$verb ${{COMP_WORDS[2]}}" ;;
    esac
  fi
  case "$verb $before" in
{chr(10).join(cases)}
  esac
  local files=yes; [ -n "$words" ] && files=""
  if [ -z "$words" ]; then case "$verb" in
{chr(10).join(offers)}
  esac; fi
  case "$files$word" in yes-*) ;; yes*) COMPREPLY=($(compgen -f -- "$word")) ;; esac
  COMPREPLY+=($(compgen -W "$words" -- "$word"))
}}
complete -o filenames -F _gn0 gn0
"""


def _zsh(words: dict[str, dict[str, tuple[str, ...]]]) -> str:
    return (
        "# zsh completion of gn0: append to ~/.zshrc\n"
        "autoload -Uz +X compinit bashcompinit && compinit && bashcompinit\n" + _bash(words)
    )


def _fish(words: dict[str, dict[str, tuple[str, ...]]]) -> str:
    lines = ["# fish completion of gn0: save as ~/.config/fish/completions/gn0.fish"]
    groups = [name for name in words if name and words[name].get("") and " " not in name]
    for verb, flags in words.items():
        first, _, second = verb.partition(" ")
        if not verb:
            where = "test (count (commandline -opc)) -eq 1"
        elif second:
            where = f"__fish_seen_subcommand_from {first}; and __fish_seen_subcommand_from {second}"
        elif verb in groups:
            where = (
                f"__fish_seen_subcommand_from {first}; and test (count (commandline -opc)) -eq 2"
            )
        else:
            where = f"__fish_seen_subcommand_from {first}"
        for flag, values in flags.items():
            if not flag:
                if values:
                    lines.append(f"complete -c gn0 -n '{where}' -a '{' '.join(values)}'")
                continue
            given = f" -xa '{' '.join(values)}'" if values else ""
            lines.append(f"complete -c gn0 -n '{where}' -l {re.sub('^--', '', flag)}{given}")
    return "\n".join(lines) + "\n"
