"""The extension: what the released protocol has no room for, under one key, with a version.

A server that wants more than pictures and words says so in the frame it sends on connect:
`{"gn0": {"version": 1, "name": "mine", "wants": ["rgb", "depth"]}}`. Requests to it then hold a map
`gn0` beside the usual keys. A server that says nothing never sees that key, and a client that does
not know it ignores the greeting, so each side works with a peer of the other kind.

Keys inside of arrays are byte strings, as the released client sends them, unless the greeting says
`"keys": "text"`; either kind is read.

Who a server is belongs to a run: `name`, `model` and `model_version` of that map, and an `identity`
of its own; a server that does not know the extension may say `name`, `model` and `version` in
whatever map it greets with.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gn0.errors import FormatError
from gn0.policies.remote.answers import show
from gn0.sim.sensor.sensor import Wire
from gn0.sim.sensor.table import carry_sensors, find_sensor, sensor_names
from gn0.sim.sensors import SensorConfig
from gn0.sim.state import Observation

KEY = "gn0"
VERSION = 1
OFFICIAL_SENSORS: frozenset[str] = frozenset({"rgb"})
_ANY = SensorConfig()  # sizes are the client's business, kinds are not
IDENTITY_LIMIT = 24  # entries of a server's own identity that are kept


@dataclass(frozen=True)
class Greeting:
    """What a server says about itself on connect.

    Attributes:
        extended: it knows the extension, so requests carry it.
        name: what it calls itself.
        wants: observation fields it asks for.
        identity: who it says it is, as (what, value); empty when it does not say.
    """

    extended: bool = False
    name: str = ""
    wants: frozenset[str] = OFFICIAL_SENSORS
    identity: tuple[tuple[str, str], ...] = ()


def read_greeting(metadata: dict[str, Any]) -> Greeting:
    """What a first frame means to us; anything we do not know is passed over."""
    about = metadata.get(KEY)
    version = about.get("version") if isinstance(about, dict) else None
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        return Greeting(identity=_read_identity(metadata, "version"))
    assert isinstance(about, dict)
    wants = about.get("wants")
    asked = (
        frozenset(w for w in wants if isinstance(w, str)).intersection(sensor_names())
        if isinstance(wants, list)
        else OFFICIAL_SENSORS
    )
    name = about.get("name")
    return Greeting(
        extended=True,
        name=show(name)[:80] if isinstance(name, str) else "",
        wants=asked,
        identity=_read_identity(about, "model_version"),
    )


def wants_text_keys(metadata: dict[str, Any]) -> bool:
    """Whether a greeting asks for texts as the keys inside of arrays: `"keys": "text"`.

    It stands in the extension's map, or at the top for a server that does not know the extension.
    """
    about = metadata.get(KEY)
    asked = about.get("keys") if isinstance(about, dict) else metadata.get("keys")
    return isinstance(asked, str) and asked == "text"


def _read_identity(about: dict[Any, Any], version: str) -> tuple[tuple[str, str], ...]:
    """Who a server says it is: texts and numbers; anything else is passed over."""
    said = [("server", about.get("name")), ("model", about.get("model"))]
    said.append(("version", about.get(version)))
    more = about.get("identity")
    if isinstance(more, dict):
        said += sorted((n, v) for n, v in more.items() if isinstance(n, str))[:IDENTITY_LIMIT]
    return tuple(
        (show(name)[:80], show(str(value)))
        for name, value in said
        if isinstance(value, str | int | float) and str(value).strip()
    )


def build_greeting(
    name: str,
    wants: frozenset[str],
    model: str = "",
    version: str = "",
    identity: Mapping[str, str | int | float] | None = None,
) -> dict[str, Any]:
    """The first frame of a server that knows the extension."""
    about: dict[str, Any] = {"version": VERSION, "name": name, "wants": sorted(wants)}
    about |= {k: v for k, v in (("model", model), ("model_version", version)) if v}
    if identity:
        about["identity"] = dict(identity)
    return {KEY: about}


class ObservationSender:
    """Observations as the extension's map; pictures that stay the same are sent once."""

    def __init__(self) -> None:
        self._sent: dict[str, Any] = {}

    def reset(self) -> None:
        """Begin an episode: everything is new to the server."""
        self._sent.clear()

    def pack(self, observation: Observation) -> dict[str, Any]:
        """The map that goes under the key `gn0` of a request."""
        found: dict[str, Any] = {
            "version": VERSION,
            "step": observation.step,
            "time": observation.time,
            "collided": observation.collided,
        }
        spelt: dict[str, Any] = {}  # after all arrays
        for name, wire in _wires():
            value = observation.read(name)
            if value is None or (wire.once and self._sent.get(name) is value):
                continue
            if wire.pack is not None:
                spelt[name] = wire.pack(value)
                continue
            found[name] = value
            if wire.once:
                self._sent[name] = value
        if observation.bev_metres_per_pixel is not None:
            found["bev_metres_per_pixel"] = float(observation.bev_metres_per_pixel)
        if observation.map_origin is not None:
            found["map_origin"] = [float(value) for value in observation.map_origin]
        return found | spelt


def read_observation(
    instruction: str, images: Any, more: Any, before: Observation | None
) -> Observation:
    """The observation of a request, as a server sees it.

    Args:
        instruction: the text of the mission.
        images: HWC or THWC uint8 pictures, or None.
        more: the extension's map, or None.
        before: the last observation of this session, for pictures that are sent once.

    Raises:
        FormatError: a field of the wrong type or shape.
    """
    rgb = None
    if images is not None:
        if not isinstance(images, np.ndarray) or images.dtype != np.uint8:
            raise _refusal("images", "uint8 [H, W, 3] or [T, H, W, 3]")
        if images.ndim not in (3, 4) or images.shape[-1] != 3 or 0 in images.shape:
            raise _refusal("images", "uint8 [H, W, 3] or [T, H, W, 3]")
        rgb = images if images.ndim == 3 else images[-1]
    seen = Observation(
        step=0 if before is None else before.step + 1, time=0.0, instruction=instruction, rgb=rgb
    )
    if more is None:
        return seen
    if not isinstance(more, dict):
        raise _refusal(KEY, "a map")
    fields: dict[str, Any] = {}
    if before is not None:
        fields |= {name: before.read(name) for name, wire in _wires() if wire.once}
    for name, wire in _wires():
        value = more.get(name)
        if value is not None:
            fields[name] = _read_value(name, wire, value)
    for name, kind, holds in (("step", int, "an int"), ("time", float, "seconds"),
                              ("bev_metres_per_pixel", float, "metres"),
                              ("collided", bool, "true or false")):  # fmt: skip
        value = more.get(name)
        if value is not None:
            if not isinstance(value, kind):
                raise _refusal(name, holds)
            fields[name] = value
    origin = more.get("map_origin")
    if origin is not None:
        numbers = isinstance(origin, list) and all(isinstance(one, float) for one in origin)
        if not numbers or len(origin) != 2:
            raise _refusal("map_origin", "[x, y] in metres")
        fields["map_origin"] = tuple(origin)
    others = {name: fields.pop(name) for name in [*fields] if name in _strange(fields)}
    return replace(seen, **fields, more={k: v for k, v in others.items() if v is not None})


def _wires() -> list[tuple[str, Wire]]:
    """How each sensor goes over the wire that goes in the extension's map, in their order."""
    carried = carry_sensors(sensor_names())
    return [(s.name, s.wire) for s in carried.sensors if s.wire is not None]


def _strange(names: Iterable[str]) -> frozenset[str]:
    """Names of sensors without a field of their own in observations."""
    return frozenset(names).difference(Observation.__dataclass_fields__)


def _read_value(name: str, wire: Wire, value: Any) -> Any:
    """What was sent of a sensor.

    Raises:
        FormatError: it is not what this sensor gives.
    """
    if wire.unpack is not None:
        try:
            return wire.unpack(value)
        except ValueError:
            raise _refusal(name, wire.holds) from None
    space = find_sensor(name).find_space(_ANY)
    dtype, ndim = np.dtype(space.dtype), len(space.shape)
    if not isinstance(value, np.ndarray) or value.dtype != dtype or value.ndim != ndim:
        raise _refusal(name, f"{dtype.name} of {ndim} dimensions")
    if ndim == 3 and space.shape[-1] == 3 != value.shape[-1]:
        raise _refusal(name, "a picture [H, W, 3]")
    return value


def _refusal(field: str, holds: str) -> FormatError:
    return FormatError(
        "not what it should be", where="request", field=field, remedy=f"send {holds}"
    )
