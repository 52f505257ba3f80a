"""A run's policy as it is shipped: small shards, tokenizer, prompt, settings and model card."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec
import torch

from gn0.errors import CheckpointError
from gn0.policies.bae.draws import check_draw_after
from gn0.policies.bae.policy_bae import digest_checkpoint
from gn0.policies.bae.shipped import find_checkpoint
from gn0.storage import check_replaceable, plain_path, read_bytes
from gn0.training.pupil import choose_default, load_pupil
from gn0.training.runs.model_card import build_card
from gn0.training.runs.run_folder import RUN
from gn0.training.runs.stage_chain import list_stages, read_stages, write_stages
from gn0.training.study.walks_table import build_walks_table

SHARD_MB, LIMIT_MB = 15, 36  # 10⁶ bytes: of a file, of everything
_CARD_LIMIT = 2**24  # bytes


@dataclass(frozen=True)
class PackedPolicy:
    """What was written.

    Attributes:
        folder: where it lies.
        files: their names.
        size: bytes of all of them.
    """

    folder: Path
    files: tuple[str, ...]
    size: int


def pack_policy(
    run: Path | str,
    out: Path | str,
    *,
    dtype: Literal["bfloat16", "float32"] = "bfloat16",
    shard_mb: int = SHARD_MB,
    limit_mb: int = LIMIT_MB,
    tables: str = "",
    walks: Sequence[Path | str] = (),
    draw_after: int = -1,
    default: str = "",
    overwrite: bool = False,
) -> PackedPolicy:
    """Write a run's policy as it is shipped.

    Args:
        run: folder of a training run, or of a policy, whose card stays as it is.
        out: the folder to write.
        dtype: of the weights in the files.
        shard_mb: 10⁶ bytes of a file at most; a single array may be larger.
        limit_mb: more than so many 10⁶ bytes in all are refused.
        tables: Markdown for the card's numbers.
        walks: folders of walks of the run's policy, as `gn0 policy examine` writes them, for the
            card's numbers.
        draw_after: actions without getting anywhere after which the packed policy's answers are
            drawn; 0: never, -1: as the run's policy has it.
        default: which of several inputs the packed policy is asked in where none is named; that
            of the run's policy when empty.
        overwrite: replace an earlier one.

    Raises:
        CheckpointError: there is no policy, or it is larger than the limit.
        ConfigError: it has no such input.
        TrainingError: walks are missing or unfinished, or of another policy.
        StorageError: the folder cannot be written, or holds something else.
    """
    home, folder = plain_path(run), plain_path(out)
    source = find_checkpoint(str(run))
    check_replaceable(folder, overwrite=overwrite, marker="shards.json")
    pupil = load_pupil(source)
    before = pupil.settings.draw_after
    drawn = check_draw_after(draw_after, before)
    if drawn != before:  # the run's numbers are of what it was then
        was = f"drawn after {before} actions without getting anywhere" if before else "never drawn"
        tables = f"In these walks answers were {was}.\n\n{tables}"
    if walks:  # else gigabytes need not be read
        tables = f"{build_walks_table(walks, digest_checkpoint(source))}\n{tables}"
    pupil = replace(pupil, settings=msgspec.structs.replace(pupil.settings, draw_after=drawn))
    if default not in ("", pupil.settings.input):
        was = pupil.settings.input
        pupil = choose_default(pupil, default)
        tables = f"In the table above, what has no input in its name is of `{was}`.\n\n{tables}"
    kind = torch.float32 if dtype == "float32" else torch.bfloat16
    weights = sum(array.numel() for array in pupil.model.parameters())
    size = weights * kind.itemsize + (source / "tokenizer.json").stat().st_size
    if size > limit_mb * 1_000_000:
        raise CheckpointError(
            f"the policy takes {size / 1e6:.1f} MB, at most {limit_mb} are shipped",
            where=source,
            remedy=f"give --limit-mb {-(-size // 1_000_000) + 1} if it is meant",
        )
    if (home / RUN).is_file():
        card = build_card(
            home, pupil.settings, name=folder.resolve().name, weights=weights, tables=tables
        )
        stages = list_stages(home)
    else:
        stages = read_stages(source)
        own = source / "README.md"
        card = read_bytes(own, _CARD_LIMIT).decode("utf-8", "replace") if own.is_file() else ""
        card += f"\n{tables.strip()}\n" if tables.strip() else ""
    pupil.save(folder, card=card, shard_mb=shard_mb, dtype=kind, overwrite=overwrite)
    if stages:
        write_stages(folder, stages)
    files = sorted(path for path in folder.iterdir() if path.is_file())
    total = sum(path.stat().st_size for path in files)
    return PackedPolicy(folder, tuple(path.name for path in files), total)
