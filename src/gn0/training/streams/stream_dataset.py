"""Samples of dataset folders as a stream: shuffled, weighted, for several workers and ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray

from gn0.data.balance import SELECTION_FILE, load_balance, load_selection
from gn0.data.codec import EgoFrame
from gn0.data.dataset import EPISODE_FILE, Dataset, open_dataset
from gn0.data.picture_cache import load_manifest
from gn0.errors import ConfigError, DataError, brief
from gn0.policies.bae.prompt_fields import PromptState
from gn0.sim.ego_map import MapView, read_map_view
from gn0.sim.sensors import MapFrame
from gn0.storage import content_hash
from gn0.training.streams.picture_jitter import PictureJitter
from gn0.training.streams.sample_order import Place, Rows, SampleOrder
from gn0.training.streams.sample_reader import LABELS, PictureWish, SampleReaders
from gn0.training.streams.sample_workers import SampleWorkers
from gn0.training.streams.samples import LabelledStates, pack_frames

BLACKOUT = 0.1  # of mosaics, so that black carries no meaning
AHEAD = 2  # batches that workers read before they are asked for


class StreamDataset:
    """Labelled states of one dataset or several, in an order that the seed decides.

    Every sample of an epoch is given once over all ranks, or as often as its weight says (see
    `sample_order.py`); an epoch follows the other without end. The order and every pixel are the
    same for any number of workers, and a stream goes on exactly where its `state` was taken, on
    any number of ranks.

    Args:
        dataset: a dataset, or its folder; or several of one camera, whose parts come mixed.
        pictures: names of what is shown: `rgb`, `history`, `bev`, `occupancy`, `goal_picture`, and
            the squares of the ego map: `near`, `far`, `square_2`, ….
        map_view: those squares, and whether the agent is an arrow on the occupancy picture.
        map_size: (width, height) [px] that `bev` and `occupancy` of all scenes are brought to.
        seed: of order, blackout and jitter.
        buffer: samples that are shuffled together; parts come in an order of their own.
        weighted: whether `selection.parquet` is obeyed; None: where there is one.
        shares: of the samples, one a dataset; they need not sum up to 1. None: by their sizes.
        workers: processes that read ahead; 0 reads here.
        rank, ranks: which share of the samples, of how many.
        blackout: share of samples whose mosaic is black.
        jitter: of colour and light of the camera's pictures.
        device: where states are put.

    Raises:
        ConfigError: an unknown picture, or a number out of range.
        DataError: the dataset has no samples, or no weights that are asked for.
        StorageError, FormatError: it is missing or damaged.
    """

    def __init__(
        self,
        dataset: Dataset | Path | str | Sequence[Dataset | Path | str],
        pictures: Sequence[str],
        *,
        map_view: MapView | Mapping[str, Any] | None = None,
        map_size: tuple[int, int] | None = None,
        seed: int = 0,
        buffer: int = 8192,
        weighted: bool | None = None,
        shares: Sequence[float] | None = None,
        workers: int = 0,
        rank: int = 0,
        ranks: int = 1,
        blackout: float = BLACKOUT,
        jitter: PictureJitter | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        if not (0 <= rank < ranks and 0 <= workers <= 1024):
            raise ConfigError(
                f"rank {rank} of {ranks}, {workers} workers",
                remedy="give a rank from 0 to ranks − 1, and 0 to 1024 workers",
            )
        given = [dataset] if isinstance(dataset, Dataset | Path | str) else list(dataset)
        self.datasets = tuple(
            one if isinstance(one, Dataset) else open_dataset(one) for one in given
        )
        view = read_map_view(map_view)
        wish = PictureWish(tuple(pictures), view, map_size, blackout, jitter, seed)
        self._reader = SampleReaders(self.datasets, wish)
        self._shares = None if shares is None else tuple(map(float, shares))
        self._each = [_read_weights(one, weighted) for one in self.datasets]
        self._weights = _join_weights(self.datasets, self._each, self._shares)
        sizes = [part.rows for one in self.datasets for part in one.about.parts]
        self.order = SampleOrder(sizes, self._weights, seed, buffer)
        self.rank, self.ranks, self.device = rank, ranks, torch.device(device)
        self._count, self._place = workers, Place()
        self._workers: SampleWorkers | None = None
        self._asked: list[tuple[int, Place]] = []  # slabs in order, and where they begin

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """Instructions by episode number."""
        return tuple(one.episode(name).instruction for one in self.datasets for name in one.sampled)

    @cached_property
    def frames(self) -> tuple[MapFrame, ...]:
        """Map picture of each episode's scene, by episode number.

        Raises:
            BenchError, StorageError, FormatError: a scene cannot be read.
        """
        frames: list[MapFrame] = []
        for dataset in self.datasets:
            found: dict[str, MapFrame] = {}
            for name in dataset.sampled:
                scene = dataset.episode(name).scene_id
                if scene not in found:
                    found[scene] = MapFrame.of_grid(dataset.scene(scene).grid)
                frames.append(found[scene])
        return tuple(frames)

    @property
    def maps(self) -> NDArray[np.float64]:
        """`frames` as `SampleMaker` takes them."""
        return pack_frames(self.frames)

    def prompt_states(self, frame: EgoFrame | None = None) -> tuple[PromptState, ...]:
        """What prompts say of each episode; on its scene's map where no `frame` is given."""
        if frame is not None:
            return tuple(PromptState(text, frame) for text in self.texts)
        return tuple(PromptState(*one) for one in zip(self.texts, self.frames, strict=True))

    @cached_property
    def hash(self) -> str:
        """Digest of everything that decides the samples: labels, words, scenes, weights, files."""
        if len(self.datasets) == 1:
            return _hash_dataset(self.datasets[0], self._each[0] is not None)
        return content_hash(
            *(
                _hash_dataset(one, weights is not None)
                for one, weights in zip(self.datasets, self._each, strict=True)
            ),
            repr(self._shares),
        )

    def sizes(self) -> dict[str, tuple[int, int]]:
        """(width, height) [px] of each picture, by name."""
        layout = self._reader.layout
        return {name: layout[name][0][1::-1] for name in self._reader.wish.names}  # type: ignore[misc]

    def draw(self, count: int) -> LabelledStates:
        """The next states of this rank.

        Raises:
            ConfigError: fewer than one.
            DataError, StorageError, FormatError: a sample is missing or damaged.
            JobError: a worker died.
        """
        if count < 1:
            raise ConfigError(f"{count} samples", where="count", remedy="give 1 or more")
        try:
            arrays = self._read_ahead(count) if self._count else self._read(count)
        except BaseException:
            self.close()
            raise
        self._place = self.order.advance(self._place, count * self.ranks)
        tensors = {name: torch.from_numpy(one).to(self.device) for name, one in arrays.items()}
        if self._count and self.device.type == "cpu":  # the slab is written again
            tensors = {name: one.clone() for name, one in tensors.items()}
        labels = {name: tensors.pop(name) for name in LABELS}
        return LabelledStates(**labels, pictures=tensors)

    def _take(self, place: Place, count: int) -> Rows:
        return self.order.take(place, count, self.rank, self.ranks)

    def _read(self, count: int) -> dict[str, NDArray[Any]]:
        layout = self._reader.layout
        out = {name: np.empty((count, *shape), kind) for name, (shape, kind) in layout.items()}
        self._reader.read(self._take(self._place, count), out)
        return out

    def _read_ahead(self, count: int) -> dict[str, NDArray[Any]]:
        if self._workers is None or self._workers.count != count:
            self.close()
            reader = self._reader
            self._workers = SampleWorkers(
                [one.folder for one in self.datasets],
                reader.wish,
                self.order,
                reader.layout,
                count,
                AHEAD + 1,
                self._count,
            )
        workers, asked = self._workers, self._asked
        if asked and asked[0][1] != self._place:  # it was put elsewhere
            for slab, _ in asked:
                workers.wait(slab)
            asked.clear()
        slab = asked[0][0] if asked else 0
        place = self._place
        for k in range(AHEAD + 1):
            if k == len(asked):
                asked.append(((slab + k) % workers.slabs, place))
                workers.ask(asked[-1][0], self._take(place, count))
            place = self.order.advance(place, count * self.ranks)
        asked.pop(0)
        return workers.wait(slab)

    def state(self) -> dict[str, Any]:
        """Where it stands: epoch and place over all ranks, and what must be the same then."""
        return {"epoch": self._place.epoch, "place": self._place.place, **self._fixed()}

    def _fixed(self) -> dict[str, Any]:
        weighted = self._weights is not None
        return {
            "dataset": self.hash,
            "seed": self.order.seed,
            "buffer": self.order.buffer,
            "weighted": weighted,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state`, of this rank or another.

        Raises:
            DataError: it is of another dataset, or this one changed.
            ConfigError: it is of another order, or no state.
        """
        own = self._fixed()
        if state.get("dataset") != own["dataset"]:
            raise DataError(
                "not the dataset that training was on: its content hash is another",
                where=", ".join(str(one.folder) for one in self.datasets),
                remedy="give the dataset of before, unchanged, or begin a new run",
            )
        for name, value in own.items():
            if state.get(name) != value:
                raise ConfigError(
                    f"{name} was {brief(state.get(name))}, now it is {value}",
                    where="state of the samples",
                    remedy=f"give the {name} of before, or begin a new run",
                )
        epoch, place = state.get("epoch"), state.get("place")
        if not (type(epoch) is int and type(place) is int and epoch >= 0 and place >= 0):
            raise ConfigError(
                f"epoch {brief(epoch)}, place {brief(place)}",
                where="state of the samples",
                remedy="give what `state` said",
            )
        self._place = self.order.advance(Place(epoch, place), 0)

    def close(self) -> None:
        """End the workers; the next draw starts new ones."""
        if self._workers is not None:
            self._workers.close()
            self._workers = None
        self._asked.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _hash_dataset(dataset: Dataset, weighted: bool) -> str:
    """Digest of everything that decides a dataset's samples."""
    about, folder = dataset.about, dataset.folder
    episodes = [one.digest for one in about.files if one.path == EPISODE_FILE]
    cache = load_manifest(folder, "webdataset")
    return content_hash(
        about.camera,
        about.settings.pictures.drawn_by,
        *(f"{part.name} {part.labels}" for part in about.parts),
        *(f"{scene.id} {scene.hash}" for scene in about.scenes),
        *episodes,
        load_balance(folder).selection if weighted else "",
        "" if cache is None else cache.seal,
    )


def _join_weights(
    datasets: Sequence[Dataset],
    weights: Sequence[NDArray[np.float64] | None],
    shares: Sequence[float] | None,
) -> NDArray[np.float64] | None:
    """Weight of each row over all datasets, so that each has its share; None where all count one.

    Raises:
        ConfigError: not one share a dataset, or one that is not above 0.
        DataError: all rows of a dataset weigh nothing.
    """
    if shares is None and all(one is None for one in weights):
        return None
    sizes = [sum(part.rows for part in dataset.about.parts) for dataset in datasets]
    each = [np.ones(size) if one is None else one for one, size in zip(weights, sizes, strict=True)]
    if shares is None:
        return np.concatenate(each)
    if len(shares) != len(datasets) or not all(0 < share < np.inf for share in shares):
        raise ConfigError(
            f"shares {', '.join(f'{share:g}' for share in shares)} of {len(datasets)} datasets",
            where="shares",
            remedy="give one number above 0 a dataset",
        )
    for dataset, own in zip(datasets, each, strict=True):
        if not own.any():
            raise DataError(
                "has no samples to draw", where=dataset.folder, remedy="build more episodes"
            )
    scale = sum(sizes) / sum(shares)
    return np.concatenate(
        [own * (share * scale / own.sum()) for own, share in zip(each, shares, strict=True)]
    )


def _read_weights(dataset: Dataset, weighted: bool | None) -> NDArray[np.float64] | None:
    """Weight of each row over all parts; None where all count the same.

    Raises:
        DataError: weights are asked for, and there are none.
    """
    there = (dataset.folder / SELECTION_FILE).is_file()
    if weighted and not there:
        raise DataError(
            f"has no {SELECTION_FILE}",
            where=dataset.folder,
            remedy="run `gn0 data balance` on it, or leave `weighted` out",
        )
    if not there or weighted is False:
        return None
    table = load_selection(dataset.folder)
    begins, end = {}, 0
    for part in dataset.about.parts:
        begins[part.name], end = end, end + part.rows
    column = table.column("part").combine_chunks()
    first = np.array([begins[name] for name in column.dictionary.to_pylist()], np.int64)
    rows = first[column.indices.to_numpy()] + table.column("row").to_numpy()
    weights = np.zeros(end)
    weights[rows] = table.column("weight").to_numpy()
    return weights
