"""Events, copies under way and recorded graphs of a card."""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray
from gn0.device.libcuda import NOT_READY
from gn0.errors import DeviceError

if TYPE_CHECKING:
    from gn0.device.driver import DeviceCuda


class EventCuda:
    """A moment in the order of a card's work; see `gn0.device.device.Event`."""

    def __init__(self, device: DeviceCuda, handle: int) -> None:
        self._device = device
        self.handle = handle
        weakref.finalize(self, device.quietly, "cuEventDestroy_v2", handle).atexit = False

    @property
    def done(self) -> bool:
        """Whether all work before it is done."""
        code = self._device.attempt("cuEventQuery", self.handle)
        if code not in (0, NOT_READY):
            raise self._device.failed(code, "cuEventQuery")
        return code == 0

    def wait(self) -> None:
        """Wait until all work before it is done.

        Raises:
            DeviceError: some of it has failed.
        """
        self._device.call("cuEventSynchronize", self.handle)


class DownloadCuda:
    """A copy to the host that is under way; see `gn0.device.device.Download`.

    Within a recording it arrives each time that the graph runs, and nothing here waits for it.
    """

    def __init__(
        self,
        device: DeviceCuda,
        array: DeviceArray,
        target: NDArray[Any],
        event: EventCuda | None,
    ) -> None:
        self._device, self._target, self._event = device, target, event
        self._array: DeviceArray | None = array  # alive until the copy is done

    @property
    def done(self) -> bool:
        """Whether it has arrived."""
        return self._event is None or self._event.done

    def numpy(self) -> NDArray[Any]:
        """The copy, when it has arrived; waits for it.

        Raises:
            DeviceError: work before it has failed.
        """
        if self._event is not None:
            self._event.wait()
            self._array = None
        return self._target


class GraphCuda:
    """Recorded work; see `gn0.device.device.Graph`."""

    def __init__(self, device: DeviceCuda) -> None:
        self._device = device
        self._kept: dict[int, Any] = {}
        self._runs: int | None = None

    def keep(self, things: Iterable[Any]) -> None:
        """Keep what the recorded work uses alive."""
        for thing in things:
            if isinstance(thing, DeviceArray | np.ndarray):
                owner = thing.owner if isinstance(thing, DeviceArray) else thing
                self._kept[id(owner)] = owner

    def finish(self, stream: int) -> None:
        """End the recording and make it ready to run."""
        recorded, ready = self._end(stream), ctypes.c_void_p()
        try:
            self._device.call("cuGraphInstantiateWithFlags", ctypes.byref(ready), recorded, 0)
        finally:
            self._device.quietly("cuGraphDestroy", recorded)
        self._runs = ready.value or 0
        weakref.finalize(self, self._device.quietly, "cuGraphExecDestroy", ready).atexit = False

    def abandon(self, stream: int) -> None:
        """End a recording in which something failed."""
        if self._device.lost is None:
            recorded = ctypes.c_void_p()
            self._device.attempt("cuStreamEndCapture", stream, ctypes.byref(recorded))
            if recorded.value:
                self._device.quietly("cuGraphDestroy", recorded)

    def _end(self, stream: int) -> ctypes.c_void_p:
        recorded = ctypes.c_void_p()
        about = "something was recorded that a graph cannot hold"
        self._device.call("cuStreamEndCapture", stream, ctypes.byref(recorded), about=about)
        return recorded

    def launch(self) -> None:
        """Run it all on the default stream.

        Raises:
            DeviceError: the recording did not end properly, or the card is lost.
        """
        if self._runs is None:
            raise DeviceError("the graph's recording did not end properly", where="CUDA")
        self._device.call("cuGraphLaunch", self._runs, None)
