"""Moving parts: clouds that a renderer knows by name and draws where an instance says they stand.

No splat moves. A renderer turns the view into the part's frame instead: an eye at `view @ pose`
sees the part as the eye at `view` sees it at `pose`, spherical harmonics included.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gn0.errors import RenderError, brief
from gn0.gaussians.cloud import SH_C0, GaussianCloud
from gn0.gaussians.transform import transform_cloud
from gn0.geometry import F32, F64, rotation_from_quaternion
from gn0.storage import content_hash

if TYPE_CHECKING:
    from gn0.device.device import DeviceArray

PARTS_MAX = 32  # instances a view: 5 bits of a key
PART_SPLATS_MAX = 2**22  # splats of an instance's cloud: 22 bits
NEARER_MOST = 1.0  # m: more would show through walls
_TOLERANCE = 1e-4  # how far a pose's rotation may be from orthonormal, as for a view


@dataclass(frozen=True, eq=False)
class Instance:
    """A named cloud at a pose, for the duration of a picture.

    The arrays are copied, and checked by `check_parts`.

    Attributes:
        cloud: name of the cloud, as the renderer knows it.
        pose: part-to-world, rigid, float64 [4, 4] m.
        gain: colour gain, float32: None, [3] or [4, 3] (rows: constant, then along world x, y, z).
            A splat of world normal n shows max(g0 + gx·n.x + gy·n.y + gz·n.z, 0) times its colour
            of never less than 0, channel by channel.
        nearer: its splats are blended as if they were so much nearer to the camera [m], but by no
            more than half of their depth; where they show and how deep they lie stays. Large
            splats of a floor come before shoes else, whose middles are nearer to the camera.
    """

    cloud: str
    pose: F64
    gain: F32 | None = None
    nearer: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", _frozen(self.pose, np.float64))
        if self.gain is not None:
            object.__setattr__(self, "gain", _frozen(self.gain, np.float32))

    @cached_property
    def fault(self) -> tuple[str, str] | None:
        """What is wrong with it, and the remedy; None if nothing is."""
        if not isinstance(self.cloud, str):
            return f"cloud is {brief(self.cloud)}, not a name", "give the name the renderer knows"
        if self.pose.shape != (4, 4):
            return f"pose has shape {self.pose.shape}, expected [4, 4]", "part to world"
        if not np.isfinite(self.pose).all():
            return "pose is not finite", "give a rotation and a translation, part to world"
        rotation = self.pose[:3, :3]
        off = np.abs(rotation @ rotation.T - np.eye(3)).max()
        off = max(off, np.abs(self.pose[3] - (0, 0, 0, 1)).max())
        if off >= _TOLERANCE or np.linalg.det(rotation) <= 0:
            return "pose is not a rigid transform", "give a rotation and a translation, no scale"
        if self.gain is not None:
            if self.gain.shape not in ((3,), (4, 3)):
                return f"gain has shape {self.gain.shape}, expected [3] or [4, 3]", "or give None"
            if not np.isfinite(self.gain).all():
                return "gain is not finite", "1, 1, 1 changes nothing"
        if not isinstance(self.nearer, int | float) or not 0.0 <= self.nearer <= NEARER_MOST:
            return f"nearer is {brief(self.nearer)}", f"give metres from 0 to {NEARER_MOST:g}"
        return None

    @property
    def whole_gain(self) -> F32:
        """The gain [4, 3] in the world; that of plain colours where there is none."""
        whole = np.zeros((4, 3), np.float32)
        if self.gain is None:
            whole[0] = 1.0
        else:
            whole[: 1 if self.gain.ndim == 1 else 4] = self.gain
        return whole

    @cached_property
    def part_gain(self) -> F32 | None:
        """The gain [4, 3] for normals in the part's frame; None if there is no gain.

        Rows 1 to 3 are turned by the pose's inverse, so that no splat's normal has to be turned.
        """
        if self.gain is None:
            return None
        turned = self.whole_gain
        if self.gain.ndim == 2:
            turned[1:] = self.pose[:3, :3].T @ self.gain[1:].astype(np.float64)
        turned.setflags(write=False)
        return turned


@dataclass(frozen=True, eq=False)
class PartsDevice:
    """Instances of a call whose poses lie on the device, beside its views.

    Attributes:
        names: names of their clouds; None: `chosen` are slots of the renderer's own table.
        poses: part-to-world, float64 [I, 4, 4].
        chosen: int32 [I], numbers into `names`, or slots; -1 stands nowhere, and costs nothing.
        firsts: int32 [V + 1], where the instances of each view begin, and the end of all; or how
            many each view has, those of one view after those of another.
        gains: float32 [I, 4, 3] as in `Instance`, or None.
        nearer: float32 [I] as in `Instance`, or None.
        settle: called when some of many views were handed to the device, or before any, perhaps
            again: only then are `chosen`, and the clouds in those slots, what they are to be. It
            says in how many views somebody was not there till then.
        late: int32 [V] in which views that is, of calls with `settle`: these are drawn last. None:
            all wait for `settle`.
        meanwhile: called once all views were handed to the device, while it draws them; not by
            calls that the host arranges. What they show must stay as it is.
    """

    names: Sequence[str] | None
    poses: DeviceArray
    chosen: DeviceArray
    firsts: DeviceArray | int
    gains: DeviceArray | None = None
    nearer: DeviceArray | None = None
    settle: Callable[[], int] | None = None
    late: DeviceArray | None = None
    meanwhile: Callable[[], None] | None = None


Parts = Sequence[Instance] | Sequence[Sequence[Instance]]


def check_parts(
    parts: Parts | None, views: int, known: Container[str] | None = None
) -> list[tuple[Instance, ...]]:
    """The instances of each of `views` views, in the order in which they are drawn at ties.

    Args:
        parts: one sequence of instances for all views, or one such sequence a view.
        views: number of views.
        known: names of clouds that the renderer knows; None: do not ask.

    Raises:
        RenderError: too many instances, or one whose cloud is unknown, or whose pose or gain has
            no meaning; as many sequences as there are views are expected.
    """
    if parts is None or (isinstance(parts, Sequence) and not parts):
        return [()] * views
    if not isinstance(parts, Sequence) or isinstance(parts, str):
        raise _no_parts(parts)
    if isinstance(parts[0], Instance):
        return [_check_view(parts, "", known)] * views
    if len(parts) != views:
        raise RenderError(
            f"parts of {len(parts)} views, but {views} views",
            where="parts",
            remedy="give one sequence of instances per view, or one for all",
        )
    checked: dict[int, tuple[Instance, ...]] = {}  # agents of one scene share their sequence
    result = []
    for view, row in enumerate(parts):
        if id(row) not in checked:
            if not isinstance(row, Sequence) or isinstance(row, str):
                raise _no_parts(row, f"view {view}")
            checked[id(row)] = _check_view(row, f"view {view}, ", known)
        result.append(checked[id(row)])
    return result


def _check_view(
    row: Sequence[object], view: str, known: Container[str] | None
) -> tuple[Instance, ...]:
    for number, instance in enumerate(row):
        where = f"{view}instance {number}"
        if number == PARTS_MAX:
            raise RenderError(
                f"{len(row)} instances in one view",
                where=where,
                remedy=f"draw at most {PARTS_MAX}: leave out what is far or out of sight",
            )
        if not isinstance(instance, Instance):
            raise _no_parts(instance, where)
        if instance.fault is not None:
            what, remedy = instance.fault
            raise RenderError(what, where=where, remedy=remedy)
        if known is not None and instance.cloud not in known:
            raise RenderError(
                f"no cloud is named {brief(instance.cloud)}",
                where=where,
                remedy="hand it to the renderer's name_cloud first",
            )
    return tuple(row)  # type: ignore[arg-type]


def _no_parts(value: object, where: str = "parts") -> RenderError:
    return RenderError(
        f"{brief(value)} is not an instance, nor a sequence of instances",
        where=where,
        remedy="give a list of gn0.render.instance.Instance",
    )


def check_name(name: object) -> None:
    """Refuse what cannot be the name of a cloud.

    Raises:
        RenderError: it is no word, or an empty one.
    """
    if not isinstance(name, str) or not name:
        raise RenderError(f"{brief(name)} is not the name of a cloud", where="name_cloud")


def check_named(name: str, cloud: GaussianCloud) -> None:
    """Whether a renderer may take a cloud under a name.

    Raises:
        RenderError: no name, or a cloud of too many splats or with normals that are not finite.
    """
    check_name(name)
    where = f"cloud {brief(name)}"
    if len(cloud) > PART_SPLATS_MAX:
        raise RenderError(
            f"{len(cloud):,} splats are too many for a moving part",
            where=where,
            remedy=f"merge them to at most {PART_SPLATS_MAX:,}",
        )
    if cloud.normal is not None and not np.isfinite(cloud.normal).all():
        raise RenderError("normals are not finite", where=where, remedy="leave them out")


def digest_part(cloud: GaussianCloud) -> str:
    """Digest of all that a picture of a part depends on: its splats, normals and labels."""
    digest = cloud.content_hash
    if cloud.normal is not None:
        digest = content_hash(digest, cloud.normal)
    if cloud.label is not None:
        table = np.zeros(0, np.int32) if cloud.categories is None else cloud.categories
        digest = content_hash("labels", digest, cloud.label, table, cloud.categories is None)
    return digest


def find_normals(cloud: GaussianCloud) -> F32:
    """Unit normals [N, 3] in the cloud's own frame.

    The cloud's own where it has them, else each splat's axis of least scale (the first of equals),
    pointing away from the mean of all centres.
    """
    if cloud.normal is not None:
        return cloud.normal
    if not len(cloud):
        return np.zeros((0, 3), np.float32)
    quats = cloud.quats.astype(np.float64)
    length = np.linalg.norm(quats, axis=1, keepdims=True)
    # no rotation stored: the axes of the world, as renderers take it
    quats = np.where(length > 0, quats / np.where(length > 0, length, 1.0), (1.0, 0.0, 0.0, 0.0))
    thin = np.argmin(cloud.scales, axis=1)
    axes = rotation_from_quaternion(quats)[np.arange(len(cloud)), :, thin]
    means = cloud.means.astype(np.float64)
    outward = np.einsum("nk,nk->n", axes, means - means.mean(axis=0))
    axes[outward < 0] *= -1.0
    return axes.astype(np.float32)


def move_instance(cloud: GaussianCloud, instance: Instance) -> GaussianCloud:
    """The cloud with every splat moved to where an instance stands, its gain in its colours.

    What a renderer shows of the instance, it must show of this cloud handed in as `extra`, unless
    it is to be `nearer`: moved splats are as far as they are. Slow: for comparisons and for
    renderers of others.

    Raises:
        RenderError: the instance's pose or gain has no meaning.
    """
    check_parts([instance], 1)
    u, _, vt = np.linalg.svd(instance.pose[:3, :3])
    moved = transform_cloud(cloud, rotation=u @ vt, shift=instance.pose[:3, 3])
    if instance.part_gain is None:
        return moved
    turned = instance.part_gain.astype(np.float64)
    gain = np.maximum(turned[0] + find_normals(cloud).astype(np.float64) @ turned[1:], 0.0)
    sh = moved.sh * gain[:, None]
    # a colour is 0.5 + SH: gain · max(0.5 + SH, 0) = max(0.5 + gain · SH + 0.5 (gain - 1), 0)
    sh[:, 0] += 0.5 * (gain - 1.0) / SH_C0
    return replace(moved, sh=sh.astype(np.float32))


def _frozen(value: object, dtype: type) -> NDArray[np.floating]:
    array: NDArray[np.floating]
    try:
        with np.errstate(over="ignore"):  # infinite: refused when it is checked
            array = np.array(value, dtype)
    except (TypeError, ValueError):
        array = np.empty(0, dtype)  # of no shape that anything has
    array.setflags(write=False)
    return array
