"""A folder of avatars: one file each, a list of who they are, one hash of all.

bank.json            names, records, digests of files, hash of the bank
NAME.npz             a person at rest: splats, skin weights, joints
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from gn0.avatars.avatar import Avatar
from gn0.avatars.npz_arrays import ArrayFile, write_arrays
from gn0.avatars.skinning import SkinWeights
from gn0.avatars.splat_person import load_splat_person
from gn0.config import Config
from gn0.errors import ConfigError, DataError, FormatError, StorageError
from gn0.storage import (
    check_contained,
    content_hash,
    plain_path,
    read_bytes,
    safe_join,
    write_atomic,
)

BANK_FILE = "bank.json"
LAYOUT = 1
_LIST_MOST = 64 * 2**20
_RANGES = {
    "scales": (-255.0, 0.0),
    "opacities": (0.0, 255.0),
    "albedo": (0.0, 255.0),
    "weight": (0.0, 255.0),
}
_METRE, _QUAT, _LOG = 1e-4, 32_767.0, 16.0  # steps of stored places, turns and sizes
_REMEDY = "make the bank again with `gn0 avatar generate`"


class BankEntry(Config, frozen=True):
    """One avatar of a bank: name, number of splats, digest of its content, record of words."""

    name: str
    splats: int
    digest: str
    record: dict[str, str] = msgspec.field(default_factory=dict)
    source: str = "gn0"
    licence: str = "CC0-1.0"


class BankList(Config, frozen=True):
    """What `bank.json` holds: layout, how it was made, its avatars, hash of all."""

    layout: int
    made: dict[str, int | float | str]
    avatars: list[BankEntry]
    hash: str


def save_avatar(path: Path | str, avatar: Avatar) -> Avatar:
    """Write an avatar, and give it back as it will be read.

    Raises:
        DataError: a splat lies farther off than a file can hold, 3.27 m.
        StorageError: the file cannot be written.
    """
    if len(avatar) and not np.abs(avatar.points).max() / _METRE < 32_767.0:
        row = int(np.abs(avatar.points).max(axis=1).argmax())
        raise DataError(
            f"splat {row} lies farther off than {_METRE * 32_767:.2f} m",
            where=f"avatar {avatar.name}",
            remedy="leave out what is not of the person",
        )
    arrays = _pack(avatar)
    write_atomic(path, lambda stream: write_arrays(stream, arrays))
    return load_avatar(path)


def _pack(avatar: Avatar) -> dict[str, np.ndarray]:
    return {
        "points": np.round(avatar.points / _METRE).astype(np.int16),
        "normals": np.round(avatar.normals * 127.0).astype(np.int8),
        "quats": np.round(avatar.quats * _QUAT).astype(np.int16),
        "scales": np.clip(np.round(np.log2(avatar.scales) * _LOG), -255, 0).astype(np.int16),
        "opacities": np.round(avatar.opacities * 255.0).astype(np.uint8),
        "albedo": np.round(np.sqrt(avatar.albedo) * 255.0).astype(np.uint8),
        "part": avatar.part.astype(np.uint8),
        "joint": avatar.weights.joint,
        "weight": np.round(avatar.weights.weight * 255.0).astype(np.uint8),
        "joints": avatar.joints,
        "betas": avatar.betas,
        "about": np.frombuffer(
            msgspec.json.encode(
                {
                    "name": avatar.name, "shape_space": avatar.shape_space,
                    "record": avatar.record, "source": avatar.source, "licence": avatar.licence,
                }
            ),
            np.uint8,
        ),
    }  # fmt: skip


class _About(Config, frozen=True):
    name: str
    shape_space: str
    record: dict[str, str]
    source: str
    licence: str


def load_avatar(path: Path | str) -> Avatar:
    """An avatar from its file.

    Raises:
        StorageError: the file cannot be read.
        FormatError: it is not an avatar, or damaged.
    """
    arrays = ArrayFile(path)
    arrays.require(
        ("points", "normals", "quats", "scales", "opacities", "albedo", "part", "joint", "weight",
         "joints", "betas", "about"),
        "an avatar of GN0", _REMEDY,
    )  # fmt: skip
    points = _bounded(arrays, "points", (None, 3))
    count = len(points)

    def floats(name: str, *shape: int | None) -> np.ndarray:
        return _bounded(arrays, name, (count, *shape))

    quats = floats("quats", 4)
    length = np.linalg.norm(quats, axis=1, keepdims=True)
    joint = floats("joint", None)
    weight = floats("weight", joint.shape[1])
    total = weight.sum(axis=1, keepdims=True)
    if count and (not length.all() or not total.all() or joint.min() < 0 or joint.max() > 54):
        raise FormatError(
            "a splat has no orientation, or hangs on no joint", file=path, remedy=_REMEDY
        )
    try:
        about = msgspec.json.decode(arrays.read("about").tobytes(), type=_About)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise FormatError(f"no record: {error}", file=path, field="about", remedy=_REMEDY) from None
    normals = floats("normals", 3)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return Avatar(
        name=about.name,
        points=(points * _METRE).astype(np.float32),
        normals=normals.astype(np.float32),
        quats=(quats / length).astype(np.float32),
        scales=np.exp2(floats("scales", 3) / _LOG).astype(np.float32),
        opacities=(floats("opacities") / 255.0).astype(np.float32),
        albedo=((floats("albedo", 3) / 255.0) ** 2).astype(np.float32),
        part=floats("part").astype(np.int32),
        weights=SkinWeights(joint.astype(np.uint8), weight / total),
        joints=arrays.read_floats("joints", (55, 3)),
        betas=arrays.read_floats("betas", (None,)),
        shape_space=about.shape_space,
        record=about.record,
        source=about.source,
        licence=about.licence,
    )


def _bounded(arrays: ArrayFile, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """Numbers that an avatar's file can hold: no larger than those that are written."""
    values = arrays.read_floats(name, shape)
    low, high = _RANGES.get(name, (-32_768.0, 32_767.0))
    if values.size and not low <= values.min() <= values.max() <= high:
        raise FormatError(
            f"a value is not within {low:g} and {high:g}", file=arrays.path, field=name,
            remedy=_REMEDY,
        )  # fmt: skip
    return values


def digest_avatar(avatar: Avatar) -> str:
    """Digest of all of an avatar that a picture or a move depends on."""
    return content_hash(
        avatar.points, avatar.normals, avatar.quats, avatar.scales, avatar.opacities, avatar.albedo,
        avatar.part, avatar.weights.joint, avatar.weights.weight, avatar.joints,
    )  # fmt: skip


class AvatarBank:
    """Avatars of a folder, each read when it is asked for.

    Args:
        folder: holds `bank.json`.

    Raises:
        StorageError: the folder cannot be read.
        FormatError: the list is damaged, or of a newer layout.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = plain_path(folder)
        check_contained(self.folder)
        path = self.folder / BANK_FILE
        if not path.is_file():
            what = (
                f"is not a bank of people: it has no {BANK_FILE}" if self.folder.is_dir()
                else "is a file, and no bank of people" if self.folder.exists()
                else "there is no such bank of people"
            )  # fmt: skip
            raise StorageError(
                what,
                where=self.folder,
                remedy="make one with `gn0 avatar generate --count 20 --out DIR`",
            )
        try:
            self.list = msgspec.json.decode(read_bytes(path, _LIST_MOST), type=BankList)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise FormatError(
                f"this is not a bank of avatars: {error}", file=path, remedy=_REMEDY
            ) from None
        if self.list.layout != LAYOUT:
            raise FormatError(
                f"layout {self.list.layout}, this GN0 reads {LAYOUT}", file=path, field="layout",
                remedy="update GN0" if self.list.layout > LAYOUT else _REMEDY,
            )  # fmt: skip
        self._known: dict[str, Avatar] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all avatars, in order."""
        return tuple(entry.name for entry in self.list.avatars)

    @property
    def content_hash(self) -> str:
        """Hash of all of its avatars."""
        return self.list.hash

    def entry(self, name: str) -> BankEntry:
        """What the list says of an avatar.

        Raises:
            FormatError: there is none of that name.
        """
        for entry in self.list.avatars:
            if entry.name == name:
                return entry
        more = " …" if len(self.names) > 6 else ""
        raise FormatError(
            f"no avatar is named {name!r}", file=self.folder / BANK_FILE, field=name,
            remedy=f"choose one of {', '.join(self.names[:6])}{more}",
        )  # fmt: skip

    def load(self, name: str) -> Avatar:
        """One avatar.

        Raises:
            StorageError, FormatError: it cannot be read, or is another than the list says.
        """
        if name not in self._known:
            entry = self.entry(name)
            path = safe_join(self.folder, f"{name}.npz")
            avatar = load_avatar(path)
            if digest_avatar(avatar) != entry.digest:
                raise FormatError(
                    "this avatar is another than the bank's list says", file=path,
                    field=f"digest of {name!r} in {BANK_FILE}", remedy=_REMEDY,
                )  # fmt: skip
            self._known[name] = avatar
        return self._known[name]


def open_avatars(source: Path | str, name: str = "", *, first: bool = False) -> list[Avatar]:
    """The avatars of a bank, one of them by its name or its first alone, or that of a file.

    A file is one of ours (`.npz`), or splats with a `binding.npz` beside them.

    Raises:
        StorageError, FormatError: there is nothing of that name, or it is damaged.
        ConfigError: a name is given beside the file of one avatar.
    """
    path = plain_path(source)
    if path.is_file():
        if name:
            raise ConfigError(
                f"{name[:80]!r} is chosen, and {path} is the file of one avatar",
                where="--name",
                remedy="leave the name out, or give the folder of the bank",
            )
        return [load_avatar(path) if path.suffix == ".npz" else load_splat_person(path)]
    bank = AvatarBank(path)
    if not bank.names:
        raise FormatError("lists nobody", file=path / BANK_FILE, remedy=_REMEDY)
    chosen = [name] if name else bank.names[:1] if first else bank.names
    return [bank.load(one) for one in chosen]
