"""Balance the actions of samples: fewer straight steps, more turns, more stops.

Walks are mostly straight, so a model that learns them as they are learns to go straight. The paper
(appendix, action balancing) trains on 67 % FORWARD, 15 % LEFT, 15 % RIGHT and 3 % STOP. A sample
counts by the first action of its label: what is to be done there.

STOP in a sample of following stands still and ends nothing. It is what a follower says that is
quicker than the person, so such samples keep the share that they have, and the wanted shares are
those of the others.

Two ways lead there; neither touches the samples:

    weights: every sample is kept, and drawn with the weight target share over found share of its
        class. Nothing is lost; rare classes repeat.
    selection: samples of the common classes are left out until the shares fit. Every sample counts
        once; as many are kept as can be.

Both write `selection.parquet` (part, row, episode_id, step, weight) and `balance.json` beside the
samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gn0.config import Config, load_json
from gn0.data.dataset import Dataset, open_dataset
from gn0.data.sample_table import has_people
from gn0.errors import ConfigError, DataError, FormatError
from gn0.geometry import F32, F64
from gn0.missions.episode_files import read_table
from gn0.paper import ACTION_SHARES, ACTIONS_AHEAD
from gn0.progress import Progress, no_progress
from gn0.seeds import random_stream
from gn0.sim.state import Action
from gn0.storage import content_hash, write_atomic, write_json

Method = Literal["weights", "selection"]
BALANCE_FILE, SELECTION_FILE = "balance.json", "selection.parquet"
BALANCE_LAYOUT = 1
NAMES = tuple(action.name for action in Action)  # STOP, FORWARD, LEFT, RIGHT: by code
STANDS = len(NAMES)  # class of a STOP that stands still
CLASSES = (*NAMES, "standing still")
TASKS = ("PLANNING", "TRACKING")
PAPER = {NAMES[action]: share for action, share in ACTION_SHARES.items()}  # percent
REPEATS = 10.0  # a weight above this repeats its samples so often that it is said
_SCHEMA = pa.schema(
    [
        pa.field("part", pa.dictionary(pa.int32(), pa.string()), nullable=False),
        pa.field("row", pa.int32(), nullable=False),
        pa.field("episode_id", pa.dictionary(pa.int32(), pa.string()), nullable=False),
        pa.field("step", pa.int32(), nullable=False),
        pa.field("weight", pa.float32(), nullable=False),
    ],
    metadata={"gn0.selection": str(BALANCE_LAYOUT)},
)


class BalanceSettings(Config, frozen=True):
    """What the shares should be, and how they are reached.

    Attributes:
        method: weights or selection, see the module.
        forward, left, right, stop: shares of the labels' first actions [percent].
        tolerance: how far off a share may be [percentage points]; a selection uses it to keep more.
        seed: seed of the choice of samples that are left out.
        tracking: share of TRACKING samples among all [percent], reached by weights; unset: as many
            as there are.
    """

    method: Method = "weights"
    forward: Annotated[float, msgspec.Meta(ge=0, le=100)] = PAPER["FORWARD"]
    left: Annotated[float, msgspec.Meta(ge=0, le=100)] = PAPER["LEFT"]
    right: Annotated[float, msgspec.Meta(ge=0, le=100)] = PAPER["RIGHT"]
    stop: Annotated[float, msgspec.Meta(ge=0, le=100)] = PAPER["STOP"]
    tolerance: Annotated[float, msgspec.Meta(ge=0, le=50)] = 0.5
    seed: int = 0
    tracking: Annotated[float, msgspec.Meta(ge=0, le=100)] | msgspec.UnsetType = msgspec.UNSET

    def __post_init__(self) -> None:
        if self.tracking is not msgspec.UNSET and self.method != "weights":
            raise ConfigError(
                "a selection has the tasks that the samples have",
                where="tracking",
                remedy="balance tasks by weights, or leave the share of TRACKING samples out",
            )

    @property
    def target(self) -> F64:
        """Shares [4] that sum to 1, by action code.

        Raises:
            DataError: they do not sum to 100 percent.
        """
        shares = np.array([self.stop, self.forward, self.left, self.right]) / 100.0
        if abs(shares.sum() - 1.0) > 1e-6:
            raise DataError(
                f"the shares sum to {shares.sum():.4%}",
                where="--forward, --left, --right, --stop",
                remedy="give percentages that sum to 100",
            )
        return shares


class ActionShare(Config, frozen=True):
    """Samples of an action: how many, or with weights how much; and their share [percent]."""

    count: float
    percent: float


class BalanceFile(Config, frozen=True):
    """The content of `balance.json`.

    Attributes:
        layout: version of this file's layout.
        settings: what was asked for.
        samples: how many the dataset has.
        kept: how many can be drawn.
        effective: how many independent samples the weights are worth (Kish).
        before: by action, as the samples are.
        after: by action, as they are drawn.
        weights: mean weight of each action's samples; 1 or 0 a sample for a selection.
        notes: what a reader should know, in words.
        labels: digest of the labels that were balanced, part by part.
        selection: digest of `selection.parquet`'s columns.
        tasks: by task, as samples are drawn; unset where their share was not asked for.
    """

    layout: int
    settings: BalanceSettings
    samples: int
    kept: int
    effective: float
    before: dict[str, ActionShare]
    after: dict[str, ActionShare]
    weights: dict[str, float]
    notes: tuple[str, ...]
    labels: str
    selection: str
    tasks: dict[str, ActionShare] | msgspec.UnsetType = msgspec.UNSET


def balance_dataset(
    dataset: Dataset,
    settings: BalanceSettings | None = None,
    *,
    progress: Progress = no_progress,
) -> BalanceFile:
    """Write `selection.parquet` and `balance.json` into a dataset's folder.

    Earlier ones are replaced; the samples themselves are not touched. The same settings give the
    same bytes.

    Raises:
        DataError: the shares cannot be reached with these samples; says why.
        StorageError, FormatError: the dataset cannot be read, or the folder not be written.
    """
    asked = settings or BalanceSettings()
    target = asked.target
    classes, tracking, columns = _read_samples(dataset, progress)
    tasks: dict[str, ActionShare] | msgspec.UnsetType = msgspec.UNSET
    counts = np.bincount(classes, minlength=len(NAMES))
    apart, wanted = stand_apart(classes, tracking, target)
    of_each = np.bincount(apart, minlength=len(wanted))
    notes = _note_standing(apart, tracking)
    if asked.tracking is not msgspec.UNSET:
        chosen = np.arange(len(classes))
        weights = plan_tasks(classes, tracking, target, asked.tracking / 100.0)
        after = np.bincount(classes, weights=weights.astype(np.float64), minlength=len(NAMES))
        per_class = np.divide(after, counts, out=np.zeros(len(NAMES)), where=counts > 0)
        notes += _note_repeats(counts, per_class)
        drawn = [float(weights[tracking == task].sum()) for task in (False, True)]
        tasks = _shares(np.array(drawn), TASKS)
    elif asked.method == "weights":
        per_class = plan_weights(of_each, wanted)
        chosen, weights = np.arange(len(classes)), per_class[apart].astype(np.float32)
        after = np.bincount(classes, weights=weights.astype(np.float64), minlength=len(NAMES))
        notes += _note_repeats(of_each, per_class)
        if len(per_class) > STANDS:  # a STOP is of two classes
            per_class = np.divide(after, counts, out=np.zeros(len(NAMES)), where=counts > 0)
    else:
        kept = plan_selection(of_each, wanted, asked.tolerance / 100.0)
        chosen = _choose(apart, kept, asked.seed)
        weights = np.ones(len(chosen), np.float32)
        after = np.bincount(classes[chosen], minlength=len(NAMES)).astype(np.float64)
        per_class = np.divide(after, counts, out=np.zeros(len(NAMES)), where=counts > 0)
        notes += _note_scarce(of_each, kept, wanted)
    table = _table(columns, chosen, weights)
    about = BalanceFile(
        layout=BALANCE_LAYOUT,
        settings=asked,
        samples=len(classes),
        kept=len(chosen),
        effective=_effective(weights),
        before=_shares(counts.astype(np.float64)),
        after=_shares(np.asarray(after, np.float64)),
        weights={name: float(weight) for name, weight in zip(NAMES, per_class, strict=True)},
        notes=tuple(notes),
        labels=_label_digest(dataset),
        selection=_digest(table),
        tasks=tasks,
    )
    write_atomic(
        dataset.folder / SELECTION_FILE,
        lambda stream: pq.write_table(table, stream, compression="zstd", write_statistics=False),
    )
    write_json(dataset.folder / BALANCE_FILE, msgspec.to_builtins(about))
    return about


def stand_apart(
    classes: NDArray[np.integer], tracking: NDArray[np.bool_], target: F64
) -> tuple[NDArray[np.integer], F64]:
    """Classes [N] and wanted shares with the STOPs of following as a class of their own.

    It keeps the share that it has, and the others have what is wanted of the rest. Where none of
    them says STOP, none is wanted: nothing ends where everybody follows. Both are given back as
    they are where nobody stands still.
    """
    stands = tracking & (classes == Action.STOP)
    if not stands.any():
        return classes, target
    apart = np.where(stands, STANDS, classes)
    rest = target.copy()
    if rest[Action.STOP] < 1.0 and not (apart == Action.STOP).any():
        rest[Action.STOP] = 0.0
    share = float(stands.mean())
    return apart, np.append(rest * ((1.0 - share) / rest.sum()), share)


def plan_weights(counts: NDArray[np.integer], target: F64) -> F64:
    """Weight [C] of a sample of each class, 1 on average over the samples.

    Args:
        counts: samples [C] of each class.
        target: wanted shares [C].

    Raises:
        DataError: a class is wanted and has no samples.
    """
    _check_classes(counts, target, 0.0)
    total = int(counts.sum())
    return np.divide(target * total, counts, out=np.zeros(len(counts)), where=counts > 0)


def plan_tasks(
    classes: NDArray[np.integer], tracking: NDArray[np.bool_], target: F64, share: float
) -> F32:
    """Weights [N], 1 on average, that give each task its share and its actions theirs.

    Args:
        classes: action [N] of each sample.
        tracking: whether it is a TRACKING one [N].
        target: wanted shares of the actions [4].
        share: wanted share of TRACKING samples.

    Raises:
        DataError: samples of a task, or of an action of it, are wanted and there are none.
    """
    weights = np.zeros(len(classes))
    for name, mine, part in zip(TASKS, (~tracking, tracking), (1.0 - share, share), strict=True):
        if not part:
            continue
        if not mine.any():
            raise DataError(
                f"{part:.1%} of the samples should be {name} ones, and none is",
                remedy="give another --tracking, or build a dataset of both kinds of missions",
            )
        apart, wanted = stand_apart(classes[mine], tracking[mine], target)
        per_class = plan_weights(np.bincount(apart, minlength=len(wanted)), wanted)
        weights[mine] = per_class[apart] * (part * len(classes) / int(mine.sum()))
    return weights.astype(np.float32)


def plan_selection(counts: NDArray[np.integer], target: F64, tolerance: float) -> NDArray[np.int64]:
    """How many samples [C] of each class are kept: as many as the shares allow.

    Args:
        counts: samples [C] of each class.
        target: wanted shares [C].
        tolerance: how far off a share may be.

    Raises:
        DataError: no selection has these shares.
    """
    _check_classes(counts, target, tolerance)
    total = int(counts.sum())
    least, most = np.maximum(target - tolerance, 0.0), np.minimum(target + tolerance, 1.0)
    for size in range(_largest(counts, least, most, total), 0, -1):
        low = np.ceil(least * size - 1e-9).astype(np.int64)
        high = np.minimum(np.floor(most * size + 1e-9).astype(np.int64), counts)
        if (low <= high).all() and low.sum() <= size <= high.sum():
            return _fill(low, high, target * size, size)
    shares = ", ".join(f"{CLASSES[i]} {counts[i]}" for i in range(len(counts)))
    raise DataError(
        f"no selection of these samples has the wanted shares within {tolerance:.2%}: {shares}",
        remedy="build more episodes, allow more --tolerance, or use --method weights",
    )


def _largest(counts: NDArray[np.integer], least: F64, most: F64, total: int) -> int:
    """The largest selection that the shares allow, but for rounding to whole samples."""
    low, high = 0.0, float(total)
    for _ in range(80):
        size = (low + high) / 2
        fits = (counts >= least * size).all() and np.minimum(counts, most * size).sum() >= size
        low, high = (size, high) if fits else (low, size)
    return min(math.ceil(high), total)


def _fill(
    low: NDArray[np.int64], high: NDArray[np.int64], wanted: F64, size: int
) -> NDArray[np.int64]:
    """Whole numbers between low and high that sum to `size`, as near to the wanted as can be."""
    kept = np.clip(np.floor(wanted + 0.5).astype(np.int64), low, high)
    while kept.sum() != size:
        step = 1 if kept.sum() < size else -1
        room = kept < high if step > 0 else kept > low
        gap = np.where(room, step * (wanted - kept), -np.inf)
        kept[int(np.argmax(gap))] += step
    return kept


def _check_classes(counts: NDArray[np.integer], target: F64, tolerance: float) -> None:
    if not counts.sum():
        raise DataError("the dataset has no samples", remedy="build it from more episodes")
    for code, (count, share) in enumerate(zip(counts, target, strict=True)):
        if count == 0 and share - tolerance > 0:
            raise DataError(
                f"{share:.1%} of the samples should say {CLASSES[code]}, and none does",
                remedy=f"give --{CLASSES[code].lower()} 0, or samples that say it",
            )


def _choose(classes: NDArray[np.integer], kept: NDArray[np.int64], seed: int) -> NDArray[np.int64]:
    """Rows to keep, in order: of each class so many, drawn by a stream of its own."""
    rows = []
    for code, count in enumerate(kept.tolist()):
        own = np.flatnonzero(classes == code)
        rng = random_stream(seed, "balance", CLASSES[code])
        rows.append(own[rng.permutation(len(own))[:count]])
    return np.sort(np.concatenate(rows))


def _read_samples(
    dataset: Dataset, progress: Progress
) -> tuple[NDArray[np.int8], NDArray[np.bool_], dict[str, pa.Array]]:
    """The class of each sample, whether it is a TRACKING one, and what names it, part by part."""
    tracking: list[NDArray[np.bool_]] = []
    classes, parts, sizes, rows, ids, steps = [], [], [], [], [], []
    count = len(dataset.about.parts)
    for number, (part, table) in enumerate(
        zip(dataset.about.parts, dataset.sample_tables(), strict=True)
    ):
        progress("reading samples", number, count)
        actions = table.column("actions").combine_chunks()
        flat = actions.flatten().to_numpy(zero_copy_only=False)
        classes.append(np.asarray(flat, np.int8).reshape(table.num_rows, ACTIONS_AHEAD)[:, 0])
        if has_people(table):
            tracking.append(np.asarray(table.column("person").to_numpy()) > 0)
        else:
            tracking.append(np.zeros(table.num_rows, np.bool_))
        parts += [part.name] * bool(table.num_rows)
        sizes += [table.num_rows] * bool(table.num_rows)
        rows.append(np.arange(table.num_rows, dtype=np.int32))
        ids.append(table.column("episode_id").combine_chunks().dictionary_encode())
        steps.append(table.column("step").combine_chunks())
    progress("reading samples", count, count)
    if not classes:
        return np.empty(0, np.int8), np.empty(0, np.bool_), {}
    return (
        np.concatenate(classes),
        np.concatenate(tracking),
        {
            "part": pa.DictionaryArray.from_arrays(
                np.repeat(np.arange(len(parts), dtype=np.int32), sizes),
                pa.array(parts, pa.string()),
            ),
            "row": pa.array(np.concatenate(rows)),
            "episode_id": pa.chunked_array(ids).unify_dictionaries().combine_chunks(),
            "step": pa.chunked_array(steps).combine_chunks(),
        },
    )


def _table(columns: Mapping[str, pa.Array], chosen: NDArray[np.int64], weights: F32) -> pa.Table:
    picked = {name: column.take(pa.array(chosen)) for name, column in columns.items()}
    picked["weight"] = pa.array(weights, pa.float32())
    return pa.table([picked[field.name] for field in _SCHEMA], schema=_SCHEMA)


def _digest(table: pa.Table) -> str:
    parts: list[Any] = []
    for name in _SCHEMA.names:
        column = table.column(name).combine_chunks()
        if pa.types.is_dictionary(column.type):
            parts += ["\n".join(column.dictionary.to_pylist()), column.indices.to_numpy()]
        else:
            parts.append(column.to_numpy())
    return content_hash(*parts)


def _effective(weights: F32) -> float:
    """How many equally weighted samples these are worth: (Σw)² / Σw² (Kish)."""
    w = weights.astype(np.float64)
    return round(float(w.sum() ** 2 / (w * w).sum()), 1)


def _shares(counts: NDArray[np.floating], names: Sequence[str] = NAMES) -> dict[str, ActionShare]:
    total = float(counts.sum())
    return {
        name: ActionShare(count=round(float(n), 3), percent=round(100 * float(n) / total, 4))
        for name, n in zip(names, counts, strict=True)
    }


def _note_standing(apart: NDArray[np.integer], tracking: NDArray[np.bool_]) -> list[str]:
    stands = int((apart == STANDS).sum())
    if not stands:
        return []
    return [
        f"{stands:,} of {int(tracking.sum()):,} samples of following say STOP, which stands still "
        "and ends nothing: they keep their share, and the wanted ones are those of the others"
    ]


def _note_repeats(counts: NDArray[np.integer], weights: F64) -> list[str]:
    return [
        f"{CLASSES[i]} is rare: each of its {int(counts[i])} samples is drawn {weights[i]:.1f} "
        "times as often as on average; more episodes would say it with more variety"
        for i in range(len(counts))
        if weights[i] > REPEATS
    ]


def _note_scarce(counts: NDArray[np.integer], kept: NDArray[np.int64], target: F64) -> list[str]:
    left_out = 1.0 - float(kept.sum()) / float(counts.sum())
    used = np.divide(kept, counts, out=np.zeros(len(counts)), where=counts > 0)
    scarce = int(np.argmax(np.where(target > 0, used, -1.0)))
    if left_out < 0.05:
        return []
    return [
        f"{CLASSES[scarce]} is scarce ({int(counts[scarce])} samples): for its share to fit "
        f"{left_out:.0%} of all samples are left out; --method weights keeps them"
    ]


def load_balance(folder: Path | str) -> BalanceFile:
    """`balance.json` of a dataset folder.

    Raises:
        StorageError: there is none.
        FormatError: it is damaged or of another layout.
    """
    path = Path(folder) / BALANCE_FILE
    about = load_json(path, BalanceFile)
    if about.layout != BALANCE_LAYOUT:
        raise FormatError(
            f"layout {about.layout}, this version reads {BALANCE_LAYOUT}",
            file=path,
            field="layout",
            remedy="run `gn0 data balance` again",
        )
    return about


def load_selection(folder: Path | str) -> pa.Table:
    """`selection.parquet` of a dataset folder: part, row, episode_id, step, weight.

    Raises:
        StorageError: there is none.
        FormatError: it is damaged, or not the one that `balance.json` names.
        DataError: the dataset's labels are others than those that were balanced.
    """
    path = Path(folder) / SELECTION_FILE
    about = load_balance(folder)
    table = read_table(path)
    if not table.schema.equals(_SCHEMA) or table.num_rows != about.kept:
        raise FormatError(
            "not the selection that balance.json names",
            file=path,
            remedy="run `gn0 data balance` again",
        )
    if _digest(table) != about.selection:
        raise FormatError("damaged", file=path, remedy="run `gn0 data balance` again")
    if about.labels != _label_digest(open_dataset(folder)):
        raise DataError(
            "was made for other labels than the dataset has now",
            where=path,
            remedy="run `gn0 data balance` again",
        )
    return table


def _label_digest(dataset: Dataset) -> str:
    return content_hash(*(part.labels for part in dataset.about.parts))


def describe_balance(about: BalanceFile) -> str:
    """Before and after in a small table of plain text."""
    lines = [f"{'action':<10}{'before':>10}{'after':>10}{'weight':>10}"]
    for name in ("FORWARD", "LEFT", "RIGHT", "STOP"):
        before, after = about.before[name], about.after[name]
        lines.append(
            f"{name:<10}{before.percent:>9.1f}%{after.percent:>9.1f}%{about.weights[name]:>10.3g}"
        )
    lines.append(f"{about.kept:,} of {about.samples:,} samples are used")
    if about.settings.method == "weights":
        lines[-1] += f"; drawn so they are worth {about.effective:,.0f} independent ones"
    if about.tasks is not msgspec.UNSET:
        told = (f"{name} {own.percent:.1f} %" for name, own in about.tasks.items())
        lines.append(f"tasks: {', '.join(told)}; the actions of each as above")
    return "\n".join([*lines, *about.notes])


def draw_rows(weights: Sequence[float] | F32, count: int, seed: int) -> NDArray[np.int64]:
    """Rows [count] drawn with these weights, the way a loader would; for checks and examples."""
    edges = np.cumsum(np.asarray(weights, np.float64))
    draws = random_stream(seed, "draw").random(count) * edges[-1]
    return np.minimum(np.searchsorted(edges, draws, side="right"), len(edges) - 1)
