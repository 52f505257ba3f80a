"""The renderer protocol: many scenes by key, many views per call, and what a renderer can do.

`Renderer` draws scenes that were added to it; `DrawnScene` is one of them. What a renderer can do
is a value, `Traits`. Opening one by name is the business of `gn0.render.open`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.config import Config
from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import F32, F64
from gn0.maps.grid import OccupancyGrid
from gn0.progress import Progress, no_progress
from gn0.render.camera import Camera
from gn0.render.depth import to_millimetres
from gn0.render.instance import Parts

if TYPE_CHECKING:
    from gn0.device.device import Device
    from gn0.render.encoding import DrawnViews, Encode, MapPicture
    from gn0.render.visible_files import VisibleFiles
    from gn0.render.who import WhoPictures

ALPHA_CAP = 0.99  # gsplat main and the original 3DGS; gsplat 1.5.3 caps at 0.999
ALPHA_MIN = 1.0 / 255.0
TRANSMITTANCE_STOP = 1e-4
DILATION = 0.3  # px², added to both diagonal terms of the 2D covariance ("eps2d")
EXTENT_MAX = 3.33  # standard deviations

VISIBLE = "cpu-visible"  # backend name of the CPU renderer with visible sets
VISIBLE_CUDA = "cuda-visible"  # of the CUDA renderer with visible sets
VISIBLE_BACKENDS = {VISIBLE: "cpu", VISIBLE_CUDA: "cuda"}  # and who draws for them
VISIBLE_OF = {drawn: name for name, drawn in VISIBLE_BACKENDS.items()}
VIEW_TOLERANCE = 1e-4  # how far a view's rotation may be from orthonormal

Output = Literal["rgb", "depth", "alpha", "semantic", "instance"]
OUTPUTS: tuple[Output, ...] = ("rgb", "depth", "alpha")  # what is drawn where nobody says
LABELS: tuple[Output, ...] = ("semantic", "instance")
ALL_OUTPUTS: tuple[Output, ...] = (*OUTPUTS, *LABELS)
Colour = tuple[float, float, float]
Load = Callable[[], GaussianCloud]
ALONE = ""  # key of the scene of a renderer that was built for one


class RenderOptions(Config, frozen=True):
    """Image-formation settings.

    Attributes:
        background: colour behind everything, 0..1.
        antialiased: compensate opacity for the dilation (gsplat "antialiased" mode).
        rgb_float: return RGB as float32 (not clamped) instead of uint8.
        threads: worker threads; 0 means all. Never changes a byte of the result.
    """

    background: Colour = (0.0, 0.0, 0.0)
    antialiased: bool = False
    rgb_float: bool = False
    threads: int = 0


@dataclass(frozen=True, eq=False)
class RenderResult:
    """Pictures of V views; a field is None when it was not asked for.

    Attributes:
        rgb: uint8 [V, H, W, 3], or float32 with `rgb_float`.
        depth: camera z of the expected surface [V, H, W] float32 m; +inf where alpha < 0.5. As
            uint16 millimetres where those were asked for, see `gn0.render.depth`.
        alpha: accumulated opacity [V, H, W] float32 in 0..1.
        semantic: category number [V, H, W] uint32 of what is seen, see `gn0.render.labels`.
        instance: object number [V, H, W] uint32 seen there, from 1; 0 without an object.
    """

    rgb: NDArray[np.uint8] | F32 | None
    depth: F32 | None
    alpha: F32 | None
    semantic: NDArray[np.uint32] | None = None
    instance: NDArray[np.uint32] | None = None

    def numpy(self) -> RenderResult:
        """The same: these are in host memory."""
        return self

    def in_millimetres(self) -> RenderResult:
        """The same with depth as uint16 millimetres, see `gn0.render.depth`."""
        if self.depth is None:
            return self
        return replace(self, depth=to_millimetres(self.depth))  # type: ignore[arg-type]


class Pictures(Protocol):
    """Pictures of V views, in host memory or on a device; a field is None when not asked for."""

    @property
    def rgb(self) -> Any:
        """Colour [V, H, W, 3]."""

    @property
    def depth(self) -> Any:
        """Depth [V, H, W]."""

    @property
    def alpha(self) -> Any:
        """Opacity [V, H, W]."""

    @property
    def semantic(self) -> Any:
        """Category numbers [V, H, W]."""

    @property
    def instance(self) -> Any:
        """Object numbers [V, H, W]."""

    def numpy(self) -> RenderResult:
        """The same in host memory."""
        ...


class Encoder(Protocol):
    """Makes files of the pictures of one scene where they are drawn."""

    def render_files(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        encode: Encode,
        background: Colour | None = None,
        outputs: tuple[Output, ...] = ("rgb",),
        shown: MapPicture | None = None,
        parts: Parts = (),
    ) -> DrawnViews:
        """Pictures of views [V, 4, 4], and files of the colour ones."""
        ...


@dataclass(frozen=True, eq=False)
class Traits:
    """What a renderer is and can do.

    Attributes:
        drawn_by: equal names, equal pixels: part of the key of every picture that is kept.
        antialiased: see `RenderOptions`.
        visible_sets: whether scenes can be limited to what is visible near each place.
        device: where pictures lie; None in host memory.
        device_views: whether views, and which scene each shows, may lie there as well.
        encoder: makes files of one scene's pictures, see `DrawnScene`; None if nobody does.
        labels: whether "semantic" and "instance" are drawn, of scenes whose splats carry labels.
    """

    drawn_by: str
    antialiased: bool = False
    visible_sets: bool = False
    device: Device | None = None
    device_views: bool = False
    encoder: Callable[[str, bool], Encoder] | None = None
    labels: bool = False


class SceneRenderer(Protocol):
    """Draws one scene: what a plug-in's factory returns."""

    @property
    def name(self) -> str:
        """Of the backend."""
        ...

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = OUTPUTS,
        background: Colour | None = None,
    ) -> RenderResult:
        """Render `views` (world-to-camera [4, 4] or [V, 4, 4]).

        `extra` holds moving splats (avatars), drawn with the static cloud and never copied into
        it. `background` overrides the option for this call.

        Raises:
            RenderError: a view is not finite or not a rigid transform.
        """
        ...


class VisibleScene(Protocol):
    """The visible sets of a scene, a set a cell of its floor; see `gn0.render.visible`."""

    @property
    def cells(self) -> list[tuple[int, int]]:
        """Cells (column, row) that have a free place, in order."""

    @property
    def built(self) -> int:
        """Sets found by looking, so far."""

    @property
    def files(self) -> VisibleFiles | None:
        """Those on disk; None without a cache."""

    def size_of(self, cell: tuple[int, int]) -> int:
        """Splats of a cell's set."""
        ...

    def build(
        self, progress: Progress = no_progress, *, most: int | None = None
    ) -> Iterator[tuple[int, int]]:
        """Find the sets of all cells (or the first `most`) that the cache does not hold yet."""
        ...


class Renderer(Protocol):
    """Draws many views of many scenes. Safe to call from one thread at a time.

    A scene goes by a key: of the scene, or of the scene in a light. Equal digests mean equal
    splats; the same key with another digest is another scene.
    """

    @property
    def name(self) -> str:
        """Of the backend."""
        ...

    @property
    def traits(self) -> Traits:
        """What it is and can do."""
        ...

    def add(self, key: str, load: Callable[[], Any], digest: str = "") -> Any:
        """Name a scene; `load` gives its cloud, or what `prepare` made of it, when first drawn."""

    def keep(self, key: str, cloud: GaussianCloud, digest: str = "") -> Any:
        """Name a scene whose cloud is here now, and stays until it is removed.

        Raises:
            RenderError: the cloud holds values that are not finite.
            DeviceMemoryError: it is larger than the memory for clouds.
        """

    def remove(self, key: str) -> None:
        """Forget a scene; one that is not known is no error."""

    def name_cloud(self, name: str, cloud: GaussianCloud) -> None:
        """Make a cloud known by a name, for instances of it; the same one again costs nothing.

        Raises:
            RenderError: the name or the cloud cannot be a part's.
        """

    def holds(self, key: str) -> bool:
        """Whether a scene's splats are ready to be drawn; any thread may ask."""
        ...

    def prepare(self, cloud: GaussianCloud, like: Any = None) -> Any:
        """What may be done beforehand with a cloud, in any thread; `load` may return it.

        Args:
            cloud: the splats.
            like: what `prepare` gave for the same splats in other colours, to take over from it
                what does not depend on these.
        """

    def limit_to_visible(
        self, key: str, cloud_hash: str, floor: OccupancyGrid, eye_height: float
    ) -> Any:
        """Let `visible=True` draw a scene from the sets that are visible near each place.

        Args:
            key: key of a scene that was added.
            cloud_hash: content hash of its geometry (its light does not matter).
            floor: free cells where eyes can be, inflated for the agent.
            eye_height: eye height of the cameras [m].

        Raises:
            ConfigError: `traits.visible_sets` is False.
        """

    def open_sets(self, key: str) -> VisibleScene:
        """The visible sets of a scene that was limited to them.

        Raises:
            RenderError: it was not.
        """
        ...

    def draw(
        self,
        camera: Camera,
        views: Any,
        keys: Any = ALONE,
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = OUTPUTS,
        background: Colour | None = None,
        visible: bool = False,
        millimetres: bool = False,
        parts: Any = (),
    ) -> Pictures:
        """Draw views; the pictures stay where they are made, see `Traits.device`.

        Args:
            camera: camera of all views.
            views: world-to-camera [4, 4] or [V, 4, 4].
            keys: the scene of each view, in any order, or one for all.
            extra: moving splats, drawn after the scene's at equal depth.
            outputs: what to draw.
            background: colour behind everything, 0..1; the option when None.
            visible: from visible sets, for scenes that have them, where they apply.
            millimetres: depth as uint16, see `gn0.render.depth`.
            parts: instances of named clouds (`gn0.render.instance.Parts`), one sequence for all
                views or one a view, drawn after all else at equal depth; `PartsDevice` where
                `traits.device_views` says that views may lie on the device.

        Raises:
            RenderError: a view is not finite or not rigid, an output or a scene is unknown, a
                colour or a splat is not finite, `parts` have no meaning, or labels are wanted of
                a renderer or a scene without.
        """
        ...

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        keys: Any = ALONE,
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = OUTPUTS,
        background: Colour | None = None,
        visible: bool = False,
        millimetres: bool = False,
        parts: Parts = (),
    ) -> RenderResult:
        """As `draw`, with pictures in host memory."""
        ...


@dataclass(frozen=True, eq=False)
class DrawnScene:
    """A renderer and one of its scenes: what draws for agents that stay in that scene.

    Attributes:
        renderer: draws.
        key: key of the scene.
        visible: draw from visible sets where they apply.
    """

    renderer: Renderer
    key: str = ALONE
    visible: bool = False

    @property
    def name(self) -> str:
        """Of the renderer, and whether it draws from visible sets."""
        drawn = self.renderer.name
        return VISIBLE_OF.get(drawn, drawn) if self.visible else drawn

    @property
    def traits(self) -> Traits:
        """Of the renderer."""
        return self.renderer.traits

    @property
    def encoder(self) -> Encoder | None:
        """Makes files of this scene's pictures; None if nobody does."""
        encoder = self.renderer.traits.encoder
        return None if encoder is None else encoder(self.key, self.visible)

    def limit_to_visible(
        self, cloud_hash: str, floor: OccupancyGrid, eye_height: float
    ) -> DrawnScene:
        """The same scene, drawn from visible sets; see `Renderer.limit_to_visible`."""
        self.renderer.limit_to_visible(self.key, cloud_hash, floor, eye_height)
        return replace(self, visible=True)

    def name_cloud(self, name: str, cloud: GaussianCloud) -> None:
        """Make a cloud known by a name; see `Renderer.name_cloud`."""
        self.renderer.name_cloud(name, cloud)

    def name_packed(self, name: str, posed: Any) -> None:
        """Make a posed cloud known by a name, where the renderer takes `cpu_posed.PosedPacked`."""
        taker: Any = self.renderer
        taker.name_packed(name, posed)

    def render(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = OUTPUTS,
        background: Colour | None = None,
        millimetres: bool = False,
        parts: Parts = (),
    ) -> RenderResult:
        """Render `views` (world-to-camera [4, 4] or [V, 4, 4]); see `Renderer.draw`."""
        return self.renderer.render(
            camera,
            views,
            self.key,
            extra=extra,
            outputs=outputs,
            background=background,
            visible=self.visible,
            millimetres=millimetres,
            parts=parts,
        )

    def render_who(self, camera: Camera, views: NDArray[np.floating], parts: Parts) -> WhoPictures:
        """Which of `parts` each pixel of views shows, see `gn0.render.who`; drawn on the host.

        Raises:
            RenderError: this renderer cannot tell.
        """
        tell = getattr(self.renderer, "render_who", None)
        if tell is None:
            raise RenderError(
                f"renderer {self.name!r} cannot tell who is who", remedy="use backend 'cpu'"
            )
        found: WhoPictures = tell(camera, views, self.key, parts=parts, visible=self.visible)
        return found


def check_outputs(outputs: Sequence[str]) -> None:
    """Refuse pictures that nobody draws.

    Raises:
        RenderError: an output is unknown.
    """
    unknown = [name for name in outputs if name not in ALL_OUTPUTS]
    if unknown:
        raise RenderError(
            f"unknown output {unknown[0]!r}", remedy="rgb, depth, alpha, semantic or instance"
        )


def check_views(views: NDArray[np.floating]) -> F64:
    """Views as float64 [V, 4, 4].

    Raises:
        RenderError: wrong shape, not finite, or not a rigid transform.
    """
    matrices = np.asarray(views, np.float64)
    if matrices.ndim == 2:
        matrices = matrices[None]
    if matrices.ndim != 3 or matrices.shape[1:] != (4, 4):
        raise RenderError(
            f"views have shape {matrices.shape}, expected [V, 4, 4]", remedy="world-to-camera"
        )
    finite = np.isfinite(matrices).all(axis=(1, 2))
    if not finite.all():
        raise RenderError("a view is not finite", where=f"view {int(np.argmin(finite))}")
    rotation = matrices[:, :3, :3]
    off = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bottom = np.abs(matrices[:, 3] - (0, 0, 0, 1)).max(axis=1)
    rigid = (off < VIEW_TOLERANCE) & (bottom < VIEW_TOLERANCE) & (np.linalg.det(rotation) > 0)
    if not rigid.all():
        raise RenderError(
            "a view is not a rigid transform",
            where=f"view {int(np.argmin(rigid))}",
            remedy="give a rotation and a translation, world to camera",
        )
    return matrices
