"""From third-party files to a scene folder: the source is recognised by its content."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

from gn0.config import Config, check_config
from gn0.errors import ConfigError, SceneError, StorageError
from gn0.plugins import get_plugin, plugin_names
from gn0.progress import Progress, no_progress
from gn0.scenes.capture.settings import CaptureSettings, check_capture_settings
from gn0.scenes.folder import CloudForm, save_scene
from gn0.scenes.occupancy import BAND, RESOLUTION
from gn0.scenes.scene import Scene
from gn0.scenes.world_defects import Tell, no_tell
from gn0.storage import check_replaceable, plain_path

_OWN_SPLATS = ("capture", "interiorgs")  # sources that come with them


class ImportSettings(Config, frozen=True):
    """Settings of an import.

    Attributes:
        height_band: (low, high) [m] above the floor: what blocks the agent.
        resolution: cell size of the occupancy grid [m].
        density: Gaussians per square metre of floor, for meshes.
        seed: seed of everything random.
        scene_id: id of the scene; the source's own name when empty.
        light: "home" bakes lamps and daylight, "flat" shows the textures as they are.
        strict: refuse a world of meshes with defects instead of mending them or leaving them out.
        capture: what is known about a bare capture.
    """

    height_band: tuple[float, float] = BAND
    resolution: float = RESOLUTION
    density: float = 10_000.0
    seed: int = 0
    scene_id: str = ""
    light: str = "home"
    strict: bool = False
    capture: CaptureSettings = CaptureSettings()


class SceneSource(Protocol):
    """Turns one kind of files into a Scene.

    Attributes:
        name: its name in the registry.
        looked_for: what it recognises, in words.
    """

    name: str
    looked_for: str

    def recognises(self, path: Path) -> bool:
        """Whether `path` holds this kind of files; must not raise on any path."""
        ...

    def build(self, path: Path, settings: ImportSettings, progress: Progress) -> Scene:
        """The scene.

        Raises:
            FormatError, StorageError, SceneError: the files are damaged or incomplete.
        """
        ...


@runtime_checkable
class SceneSourceTelling(Protocol):
    """A source that has something to say to the person who imports, before its long work.

    Attributes:
        tell: takes one line; set by `import_scene`.
    """

    tell: Tell


def find_source(path: Path) -> SceneSource:
    """The source that recognises a path.

    Raises:
        StorageError: the path does not exist.
        SceneError: no source recognises it; says what was looked for.
    """
    if not path.exists():
        raise StorageError("no such file or folder", where=path, remedy="check the path")
    sources: list[SceneSource] = [
        get_plugin("scene_source", name)() for name in plugin_names("scene_source")
    ]
    for source in sources:
        if source.recognises(path):
            return source
    if (path / "scene.json").is_file():
        raise SceneError(
            "this already is a GN0 scene folder",
            where=path,
            remedy="use it as it is, e.g. `gn0 scene check`",
        )
    looked = "; ".join(f"{source.name}: {source.looked_for}" for source in sources)
    raise SceneError("no scene found here", where=path, remedy=f"looked for {looked}")


def import_scene(
    path: Path | str,
    out: Path | str,
    *,
    height_band: tuple[float, float] = BAND,
    resolution: float = RESOLUTION,
    density: float = 10_000.0,
    seed: int = 0,
    light: str = "home",
    strict: bool = False,
    capture: CaptureSettings | None = None,
    cloud_form: CloudForm = "exact",
    overwrite: bool = False,
    progress: Progress = no_progress,
    tell: Tell = no_tell,
) -> Scene:
    """Import whatever lies at `path` into the scene folder `out`; the scene's id is its name.

    Args:
        path: a splat file, an InteriorGS folder, a Gazebo world folder or a `.world`/`.sdf` file.
        out: the folder to write.
        height_band: (low, high) [m] above the floor: what blocks the agent.
        resolution: cell size of the occupancy grid [m].
        density: Gaussians per square metre of floor, for meshes.
        seed: seed of everything random.
        light: "home" bakes lamps and daylight, "flat" shows the textures as they are.
        strict: refuse a world of meshes with any defect; by default defects are repaired or what
            they touch is left out.
        capture: up, scale, floor and the like of a bare capture, where known.
        cloud_form: "exact" (`point_cloud.ply`) or "packed" (`3dgs_compressed.ply`).
        overwrite: replace an existing folder.
        progress: progress sink.
        tell: takes what is wrong with the source, line by line, before any long work.

    Raises:
        StorageError: nothing at `path`, or `out` cannot be written.
        SceneError, FormatError: not a scene, or a damaged one.
        ConfigError: a setting is of the wrong type.
    """
    path, out = plain_path(path), plain_path(out)
    low, high = height_band
    if not 0 <= low < high <= 100:
        raise SceneError(
            f"height band {low:g} to {high:g} m is empty, below the floor or above 100 m",
            remedy="give two heights above the floor, the lower first, e.g. 0.10 1.50",
        )
    if not 1 <= density <= 1_000_000:
        raise SceneError(
            f"density {density:g} is not in 1..1,000,000 Gaussians a m²", remedy="use e.g. 10000"
        )
    if not 0.005 <= resolution <= 1:
        raise SceneError(f"resolution {resolution:g} m is not in 0.005..1", remedy="use e.g. 0.05")
    if light not in ("home", "flat"):
        raise SceneError(f"light {light!r} is unknown", remedy='use "home" or "flat"')
    if out.resolve() == path.resolve() or path.resolve().is_relative_to(out.resolve()):
        raise StorageError(
            "the output folder holds the source", where=out, remedy="choose another --out"
        )
    # said now, not after a minute of work
    check_replaceable(out, overwrite=overwrite, marker="scene.json")
    settings = check_config(
        ImportSettings(
            height_band=(float(low), float(high)),
            resolution=float(resolution),
            density=float(density),
            seed=seed,
            scene_id=scene_id_from(out.resolve().name),
            light=light,
            strict=strict,
            capture=check_capture_settings(capture or CaptureSettings()),
        )
    )
    source = find_source(path)
    if capture not in (None, CaptureSettings()) and source.name != "capture":
        raise ConfigError(
            f"up, scale, floor and the like are for bare captures, not for {source.name} scenes",
            where=path,
            remedy="leave them out",
        )
    plain = ImportSettings()
    given = [
        name for name in ("density", "light") if getattr(settings, name) != getattr(plain, name)
    ]
    if given and source.name in _OWN_SPLATS:
        raise ConfigError(
            f"{' and '.join(given)} for the splats that meshes are covered with: "
            f"{source.name} scenes bring their own",
            where=path,
            remedy=f"leave {'it' if len(given) == 1 else 'them'} out",
        )
    if strict and source.name != "world":
        raise ConfigError(
            f"strict is for worlds of meshes, not for {source.name} scenes",
            where=path,
            remedy="leave it out",
        )
    if isinstance(source, SceneSourceTelling):
        source.tell = tell
    scene = source.build(path, settings, progress)
    return save_scene(scene, out, cloud_form=cloud_form, overwrite=overwrite, progress=progress)


def scene_id_from(name: str) -> str:
    """A plain scene id from a folder name."""
    plain = "".join(c if c.isascii() and (c.isalnum() or c in "._-") else "-" for c in name)
    return plain.lstrip("._-")[:128] or "scene"
