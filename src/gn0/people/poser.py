"""People posed where they are drawn: keys go to the process that draws, which opens the bank.

Who asks says whom (identity, digest of the avatar, folder and hash of the bank) once, then clip,
frame, blend, head and level of detail: all that a posed cloud depends on, in some 60 bytes.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Hashable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable
from weakref import WeakValueDictionary

import msgspec

from gn0.avatars.bank import AvatarBank
from gn0.avatars.posed_bank import BUDGET, PosedBank
from gn0.avatars.posed_device import HoldsParts, PosedBankDevice
from gn0.errors import EpisodeError, FormatError, RenderError, brief
from gn0.people.cast import Actor, Cast
from gn0.people.person import drawn_identity
from gn0.people.shown import PoseShown, Shown
from gn0.render.cpu_posed import PosedPacked
from gn0.render.renderer import Renderer

BANKS = 4  # open at a time
AT_ONCE, AT_ONCE_DEVICE = 96, 600  # clouds of a call: all of them fit in the budget
_HOW = tuple[str, int, str, int, int, int, int, float, int, int, int]  # `Shown`, and the level


class Whom(msgspec.Struct, frozen=True):
    """Somebody, and where it is found.

    Attributes:
        identity: name in the bank, or of a drawn person.
        avatar: digest of the avatar.
        bank: folder of the bank; "" for a drawn person.
        hash: content hash of the bank.
    """

    identity: str
    avatar: str
    bank: str = ""
    hash: str = ""


@runtime_checkable
class NamesPosed(Protocol):
    """A renderer whose other side may pose people itself: `RendererShared`."""

    @property
    def poses(self) -> bool:
        """Whether it does."""
        ...

    def name_posed(self, source: Mapping[str, Any], how: tuple[str | int | float, ...]) -> str:
        """A name for `Instance` of somebody in a pose."""
        ...


@runtime_checkable
class TakesPacked(Protocol):
    """A renderer that may take clouds posed as it draws them: `RendererCpu`, `RendererHost`."""

    @property
    def takes_packed(self) -> bool:
        """Whether it does."""
        ...

    def name_packed(self, name: str, posed: PosedPacked) -> None:
        """Make one known by a name."""
        ...


class _NamesClouds(Protocol):
    def name_cloud(self, name: str, cloud: Any) -> None: ...


class PosedThere:
    """Posed people of whom only keys are sent; see `PosedBank` for those that are posed here.

    Args:
        renderer: asks the process that draws.
        bank: where named people are found.
    """

    def __init__(self, renderer: NamesPosed, bank: AvatarBank | None) -> None:
        self._renderer, self._bank = renderer, bank
        self._known: dict[str, dict[str, Any]] = {}

    def name(self, pose: PoseShown) -> str:
        """The name of a pose, for `Instance`."""
        who = self._known.get(pose.actor.digest)
        if who is None:
            who = self._known[pose.actor.digest] = self._find(pose.actor)
        return self._renderer.name_posed(who, (*pose.shown, pose.level))

    def _find(self, actor: Actor) -> dict[str, Any]:
        whom = Whom(actor.name, actor.digest)
        if drawn_identity(actor.name) is None:
            assert self._bank is not None
            folder = str(self._bank.folder.resolve())
            whom = Whom(actor.name, actor.digest, folder, self._bank.content_hash)
        plain: dict[str, Any] = msgspec.to_builtins(whom)
        return plain


Posed = PosedBank | PosedBankDevice | PosedThere


def open_posed(renderer: object, bank: AvatarBank | None = None, budget: int = BUDGET) -> Posed:
    """What poses people for a renderer: a bank on its device, one here, or the other process."""
    if isinstance(renderer, HoldsParts):
        return PosedBankDevice(renderer, budget)
    if isinstance(renderer, NamesPosed) and renderer.poses:
        return PosedThere(renderer, bank)
    packed = isinstance(renderer, TakesPacked) and renderer.takes_packed
    return PosedBank(budget, packed=packed)


def name_posed(
    posed: Posed, renderer: _NamesClouds, wanted: Sequence[tuple[Hashable, PoseShown]]
) -> list[str]:
    """Names by which a renderer knows the clouds of one call, until the next.

    Raises:
        ConfigError: together they are larger than the budget.
    """
    if isinstance(posed, PosedThere):
        return [posed.name(pose) for _, pose in wanted]
    if isinstance(posed, PosedBankDevice):
        return [posed.name(slot) for slot in posed.fetch(wanted)]
    clouds = posed.fetch(wanted)
    posed.tell(renderer, clouds)
    return [each.name for each in clouds]


class PeoplePoser:
    """Poses people in the process that draws: a `gn0.render.share.request.Poser`.

    Args:
        renderer: draws them; on a card they are posed there.
        budget: bytes of posed clouds.

    Attributes:
        at_once: how many clouds fit into a call.
    """

    def __init__(self, renderer: Renderer, budget: int = BUDGET) -> None:
        self._renderer = renderer
        self._posed = open_posed(renderer, budget=budget)
        self.at_once = AT_ONCE_DEVICE if isinstance(self._posed, PosedBankDevice) else AT_ONCE
        self._casts: OrderedDict[tuple[str, str], Cast] = OrderedDict()
        self._ready: WeakValueDictionary[Whom, Actor] = WeakValueDictionary()
        self._lock = threading.Lock()

    def prepare(self, source: Mapping[str, Any]) -> None:
        """Get somebody ready to be posed, in any thread.

        Raises:
            EpisodeError: the bank is another than the one that is meant, or has nobody so.
            StorageError, FormatError: the bank is missing or damaged.
        """
        self._find(source)

    def pose(
        self, wanted: Sequence[tuple[Mapping[str, Any], tuple[str | int | float, ...]]]
    ) -> list[str]:
        """Names of somebody in a pose each, for instances of one call; of the drawing thread.

        Raises:
            ConfigError: together they are larger than the budget.
            FormatError, RenderError: a pose is none.
            EpisodeError, StorageError: see `prepare`.
        """
        poses = [self._read(self._find(source), how) for source, how in wanted]
        keys = [((pose.actor.digest, pose.shown, pose.level), pose) for pose in poses]
        try:
            return name_posed(self._posed, self._renderer, keys)
        except (KeyError, IndexError, ValueError) as error:
            raise RenderError(
                f"somebody cannot be posed: {type(error).__name__}: {error}", where="posed"
            ) from None

    def _read(self, actor: Actor, how: tuple[str | int | float, ...]) -> PoseShown:
        try:
            *shown, level = msgspec.convert(how, _HOW)
        except msgspec.ValidationError as error:
            raise FormatError(f"{brief(how)} is not a pose: {error}", field="how") from None
        if not 0 <= level < len(actor.levels):
            raise FormatError(f"level of detail {level}", field="how")
        return PoseShown(actor, Shown(*shown), level)

    def _find(self, source: Mapping[str, Any]) -> Actor:
        try:
            whom = msgspec.convert(source, Whom)
        except msgspec.ValidationError as error:
            raise FormatError(f"{brief(source)} is nobody: {error}", field="source") from None
        actor = self._ready.get(whom)
        if actor is not None:
            return actor
        with self._lock:
            actor = self._open(whom).find(whom.identity)
            if actor.digest != whom.avatar:
                raise EpisodeError(
                    f"{whom.identity!r} is not who is meant: its avatar is {actor.digest}, not "
                    f"{whom.avatar}",
                    where=whom.bank or "the drawing process",
                    remedy="start again: the bank or GN0 has changed meanwhile",
                )
            self._ready[whom] = actor
        return actor

    def _open(self, whom: Whom) -> Cast:
        key = (whom.bank, whom.hash)
        if key not in self._casts:
            bank = AvatarBank(whom.bank) if whom.bank else None
            if bank is not None and bank.content_hash != whom.hash:
                raise EpisodeError(
                    f"{whom.identity!r} is of bank {whom.hash}, this is {bank.content_hash}",
                    where=whom.bank,
                    remedy="give the bank that the episodes were made with",
                )
            self._casts[key] = Cast(bank)
        self._casts.move_to_end(key)
        while len(self._casts) > BANKS:
            self._casts.popitem(last=False)
        return self._casts[key]


def open_poser(renderer: Renderer) -> PeoplePoser:
    """What poses people in the process that draws, by its renderer."""
    return PeoplePoser(renderer)
