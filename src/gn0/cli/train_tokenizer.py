"""Train a tokenizer on the language of suites and datasets, for policies trained from scratch.

Byte-level BPE on their instructions and on GN0's own prompts, then Qwen's special tokens and the
1,006 navigation tokens. The folder is one that stock transformers loads; the same texts in any
order give the same files. Says how many tokens an instruction and each prompt take.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 train tokenizer out/missions --out out/words
  gn0 train tokenizer out/missions out/dagger --merges 800 --out out/words"""
TOKENIZER = "tokenizer.json"


class Args(Config, frozen=True):
    """Whose language, and how fine.

    Attributes:
        sources: suite and dataset folders; name those of training, and of evaluation where its
            phrasings are known.
        out: the folder to write.
        merges: pairs of bytes or tokens that become a token; fewer where the texts have no more.
        overwrite: replace a tokenizer that is there.
    """

    sources: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="SOURCE", help_behavior_hint="(required)"),
    ]
    out: str
    merges: Annotated[int, msgspec.Meta(ge=0, le=200_000)] = 1500
    overwrite: bool = False


def run(args: Args) -> int:
    """Read, train, write, count."""
    from gn0.cli.console import draw_progress
    from gn0.cli.train_packages import check_packages
    from gn0.errors import ConfigError
    from gn0.storage import check_replaceable
    from gn0.training.streams.source_texts import prompt_texts, read_instructions

    if not args.sources:
        raise ConfigError(
            "no source", where="SOURCE", remedy="name a suite or a dataset, or several"
        )
    check_replaceable(args.out, overwrite=args.overwrite, marker=TOKENIZER)
    instructions, prompts = read_instructions(args.sources), prompt_texts()
    check_packages()
    from gn0.policies.bae.tokenizer import read_token_ids, save_tokenizer, train_tokenizer
    from gn0.policies.bae.tokenizer_file import TokenizerFile

    with draw_progress("training the tokenizer"):
        tokenizer = train_tokenizer([*instructions, *prompts.values()], args.merges)
        ids = read_token_ids(tokenizer)
        save_tokenizer(args.out, tokenizer, overwrite=args.overwrite)
    words = TokenizerFile(tokenizer.backend_tokenizer)
    counts = sorted(len(words.encode(text)) for text in instructions)
    letters = sum(map(len, instructions))
    print(
        f"{len(instructions):,} instructions, {len(set(instructions)):,} different: "
        f"{sum(counts) / len(counts):.1f} tokens on average, 95 % have at most "
        f"{counts[-(-95 * len(counts) // 100) - 1]}, the longest {counts[-1]}; "
        f"{letters / sum(counts):.1f} characters a token"
    )
    told = {name: len(words.encode(text)) for name, text in prompts.items() if name != "fields"}
    print("tokens of prompts without their fields:")
    width = max(map(len, told)) + 2
    for name, count in told.items():
        print(f"  {name:<{width}}{count}")
    first = ids.vocabulary.number
    print(f"{len(words):,} tokens, <0> to <999> from {first:,} on; written to {args.out}")
    return 0
