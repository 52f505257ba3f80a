"""One registry for every plug point: scene source, renderer, sensor, policy, exporter.

Built-ins are named here as "module:attribute" and imported on first use. Third-party packages
register through the entry-point group `gn0.plugins` (a module whose import calls `register`).
"""

from __future__ import annotations

import difflib
import inspect
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module, invalidate_caches, metadata, util
from pathlib import Path
from typing import Any, Literal

from gn0.errors import ConfigError, brief

# in the name of an option: never written down
SECRETS = ("token", "password", "secret", "api_key")

Kind = Literal[
    "scene_source",
    "renderer",
    "refiner",
    "sensor",
    "policy",
    "exporter",
    "dataset_exporter",
    "policy_host",
]

_BUILTIN: dict[str, dict[str, str]] = {
    "scene_source": {
        "capture": "gn0.scenes.capture.capture_source:SceneSourceCapture",
        "interiorgs": "gn0.scenes.interiorgs:SceneSourceInteriorGS",
        "ros-map": "gn0.scenes.ros_map:SceneSourceRosMap",
        "world": "gn0.scenes.world:SceneSourceWorld",
    },
    "renderer": {
        "cpu": "gn0.render.cpu:RendererCpu",
        "cuda": "gn0.render.cuda.renderer:RendererCuda",
        "gsplat": "gn0.render.gsplat:RendererGsplat",
    },
    "refiner": {"cpu": "gn0.render.refine:refine_cloud"},
    "sensor": {  # in the order of the docs, and of the wire
        "rgb": "gn0.sim.sensor.rgb:SENSOR",
        "depth": "gn0.sim.sensor.depth:SENSOR",
        "bev": "gn0.sim.sensor.bev:SENSOR",
        "occupancy": "gn0.sim.sensor.occupancy:SENSOR",
        "ego_map": "gn0.sim.sensor.ego_map:SENSOR",
        "history": "gn0.sim.sensor.history:SENSOR",
        "ranges": "gn0.sim.sensor.ranges:SENSOR",
        "goal_vector": "gn0.sim.sensor.goal_vector:SENSOR",
        "goal_picture": "gn0.sim.sensor.goal_picture:SENSOR",
        "pose": "gn0.sim.sensor.pose:SENSOR",
        "semantic": "gn0.sim.sensor.semantic:SENSOR",
        "instance": "gn0.sim.sensor.instance:SENSOR",
        "who": "gn0.sim.sensor.who:SENSOR",
        "people_seen": "gn0.sim.sensor.people_seen:SENSOR",
        "bev_live": "gn0.sim.sensor.bev_live:SENSOR",
    },
    "policy": {
        "oracle": "gn0.policies.oracle:PolicyOracle",
        "parse_then_astar": "gn0.policies.parse_then_astar:PolicyParseThenAstar",
        "straight": "gn0.policies.simple:PolicyStraight",
        "wall_follower": "gn0.policies.simple:PolicyWallFollower",
        "random": "gn0.policies.simple:PolicyRandom",
        "explorer": "gn0.policies.explorer:PolicyExplorer",
        "box_follower": "gn0.policies.box_follower:PolicyBoxFollower",
        "always_stop": "gn0.policies.follow_floors:PolicyAlwaysStop",
        "straight_at_the_person": "gn0.policies.follow_floors:PolicyStraightAtPerson",
        "recorded": "gn0.policies.recorded:PolicyRecorded",
        "remote": "gn0.policies.remote.policy_remote:PolicyRemote",
        "bae": "gn0.policies.bae.policy_bae:PolicyBae",
        "cma": "gn0.policies.cma.policy_cma:PolicyCma",
    },
    "policy_host": {"own-process": "gn0.policies.remote.isolated:PolicyIsolated"},
    "exporter": {
        "gn-matrix": "gn0.missions.sets.gn_matrix:ExporterGnMatrix",
        "gn-matrix-json": "gn0.missions.sets.gn_matrix_json:ExporterGnMatrixJson",
        "vlnce": "gn0.missions.sets.vlnce:ExporterVlnce",
    },
    "dataset_exporter": {
        "gn-matrix": "gn0.export.gn_matrix:ExporterGnMatrixParquet",
        "gn-matrix-json": "gn0.export.gn_matrix:ExporterGnMatrixFolder",
        "interndata-n1": "gn0.export.interndata:ExporterInternData",
        "lerobot-v3": "gn0.export.lerobot3:ExporterLeRobot3",
        "navdp": "gn0.export.navdp:ExporterNavDp",
        "navid": "gn0.export.navid:ExporterNaVid",
        "navila": "gn0.export.navila:ExporterNaVila",
        "streamvln": "gn0.export.streamvln:ExporterStreamVln",
        "uninavid": "gn0.export.navid:ExporterUniNaVid",
        "vln-pe": "gn0.export.vlnpe:ExporterVlnPe",
        "vlnce-r2r": "gn0.export.vlnce:ExporterVlnceR2R",
        "vlnce-rxr": "gn0.export.vlnce:ExporterVlnceRxR",
    },
}
_registered: dict[tuple[str, str], Any] = {}
_discovered = False


def register(kind: Kind, name: str, plugin: Any) -> None:
    """Register a plug-in object or class under a name.

    Raises:
        ConfigError: there is no such kind, the name cannot be typed or is taken.
    """
    if kind not in _BUILTIN:
        raise ConfigError(f"no kind of plug-in {kind!r}", remedy=f"known: {', '.join(_BUILTIN)}")
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise ConfigError(
            f"{brief(name)} is not a name of a {kind}", remedy="give a text that can be typed"
        )
    if name in _BUILTIN[kind] or _registered.get((kind, name), plugin) is not plugin:
        raise ConfigError(f"{kind} {name!r} is already registered", remedy="choose another name")
    _registered[kind, name] = plugin


def _discover() -> None:
    global _discovered
    if not _discovered:
        _discovered = True
        for point in metadata.entry_points(group="gn0.plugins"):
            try:
                point.load()
            except Exception as error:  # whatever a stranger's package raises
                _discovered = False
                of = f" of {point.dist.name}" if point.dist else ""
                raise ConfigError(
                    f"the installed plug-in {point.value!r}{of} cannot be imported: "
                    f"{type(error).__name__}: {error}",
                    remedy="install it again, or uninstall it",
                ) from error


def is_builtin(kind: Kind, name: str) -> bool:
    """Whether a plug-in is one of GN0's own."""
    return name in _BUILTIN[kind]


def builtin_names(kind: Kind) -> tuple[str, ...]:
    """Names of GN0's own, in the order of their table."""
    return tuple(_BUILTIN[kind])


def installed_modules() -> list[str]:
    """The modules that installed packages register plug-ins with, not imported."""
    return sorted({point.module for point in metadata.entry_points(group="gn0.plugins")})


def plugin_names(kind: Kind) -> list[str]:
    """Names known for a kind, sorted."""
    _discover()
    return sorted({*_BUILTIN[kind], *(n for k, n in _registered if k == kind)})


def get_plugin(kind: Kind, name: str) -> Any:
    """The plug-in of that name.

    Raises:
        ConfigError: no such plug-in; lists those that exist.
    """
    if name in _BUILTIN[kind]:
        module, attribute = _BUILTIN[kind][name].split(":")
        return getattr(import_module(module), attribute)
    _discover()
    if (kind, name) in _registered:
        return _registered[kind, name]
    known = plugin_names(kind)
    near = [other for other in known if name and name.lower() in other]
    near = near or difflib.get_close_matches(name.lower(), known, n=1)
    meant = f"did you mean {' or '.join(map(repr, near))}? " if near else ""
    raise ConfigError(
        f"no {kind.replace('_', ' ')} named {name!r}",
        remedy=f"{meant}known: {', '.join(known) or 'none'}",
    )


def build_plugin(kind: Kind, name: str, options: Mapping[str, Any]) -> Any:
    """What the plug-in of that name makes of these options.

    Raises:
        ConfigError: no such plug-in, it has no such option, or it wants a number or a truth there.
    """
    factory = get_plugin(kind, name)
    try:
        signature = inspect.signature(factory)
        signature.bind(**options)
        _check_options(signature, options)
    except TypeError as error:
        known = ", ".join(inspect.signature(factory).parameters) or "none"
        raise ConfigError(
            f"{kind} {name!r} does not take these options: {error}", remedy=f"known: {known}"
        ) from None
    except ValueError:  # a factory without a signature
        pass
    return factory(**options)


# how a signature writes a plain type -> what fits, and what to say of anything else
_PLAIN: dict[object, tuple[tuple[type, ...], str]] = {
    **dict.fromkeys((int, "int"), ((int,), "a whole number")),
    **dict.fromkeys((float, "float"), ((int, float), "a number")),
    **dict.fromkeys((bool, "bool"), ((bool, int), "true or false")),
}


def _check_options(signature: inspect.Signature, options: Mapping[str, Any]) -> None:
    """Refuse what is no number or no truth where a plug-in says that it wants one."""
    for name, value in options.items():
        written = getattr(signature.parameters.get(name), "annotation", None)
        if not isinstance(written, str | type) or written not in _PLAIN:
            continue
        fitting, wanted = _PLAIN[written]
        if not isinstance(value, fitting):
            raise ConfigError(f"{value!r} is not {wanted}", where=name, remedy=f"give {wanted}")


def describe_error(error: BaseException) -> str:
    """Type and text of what a plug-in raised, on one line."""
    lines = str(error).splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def import_plugins(names: Sequence[str], *, only_locate: bool = False) -> tuple[str, ...]:
    """Import what `--plugin` names, and say under which module names.

    A name is a module (`package.module`, also one that lies in the current folder) or the path of
    a `.py` file, whose folder joins the import path behind all others, so it shadows nothing. With
    `only_locate` nothing is imported: another process will.

    Raises:
        ConfigError: there is no such module or file, its name is taken, or importing it fails.
    """
    return tuple(_import_plugin(name, only_locate) for name in names)


def _import_plugin(name: str, only_locate: bool) -> str:
    is_file = name.endswith(".py") or "/" in name or "\\" in name
    file, module = None, name
    try:
        if is_file:
            file = Path(name).expanduser().resolve()
            module = file.stem
        if file is not None and not file.is_file():
            raise ImportError("there is no such file")
        if not all(part.isidentifier() for part in module.split(".")):
            raise ImportError("give package.module, or the path of a .py file with a plain name")
        folder = file.parent if file else Path.cwd()
        unknown = file is not None or util.find_spec(module.partition(".")[0]) is None
        if unknown and str(folder) not in sys.path:
            sys.path.append(str(folder))  # workers inherit it
        if only_locate:
            origin = _find_origin(module.partition(".")[0])
        else:
            origin = getattr(import_module(module), "__file__", None)
        if file is not None and (origin is None or Path(origin).resolve() != file):
            raise ImportError(f"its name is that of {origin or 'a built-in module'}: rename it")
    except Exception as error:  # whatever a stranger's module raises
        raise ConfigError(
            f"cannot import the plug-in {name!r}: {type(error).__name__}: "
            + (str(error).splitlines() or ["no message"])[0],
            where="--plugin",
            remedy="give the path of its .py file, or a module that is installed, in the current "
            "folder, or on PYTHONPATH",
        ) from error
    return module


def _find_origin(top: str) -> str | None:
    """The file of a top-level module that is not imported for that.

    Raises:
        ImportError: there is none.
    """
    invalidate_caches()
    spec = util.find_spec(top)
    if spec is None:
        raise ImportError(f"no module named {top!r}")
    return spec.origin
