"""Policy servers for tests: a bare one as strangers write it, and those that misbehave.

`ROGUES` is every way in which a server has been seen, or imagined, to break the protocol. Each is a
handler of one connection; `serve_bare(handler)` runs it on a free port of this machine.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from gn0.policies.remote.wire import decode_message, encode_message

Handler = Callable[[Any], None]
_SILENT = logging.getLogger("gn0_trials.rogue_servers")
_SILENT.setLevel(logging.CRITICAL)


@contextlib.contextmanager
def serve_bare(handler: Handler, port: int = 0) -> Iterator[str]:
    """Serve connections with `handler(connection)`, in threads; gives the address."""
    from websockets.sync.server import serve

    connections: list[Any] = []

    def handle(connection: Any) -> None:
        connections.append(connection)
        with contextlib.suppress(Exception):
            handler(connection)

    server = serve(
        handle, "127.0.0.1", port, max_size=None, ping_interval=None, close_timeout=0.2,
        logger=_SILENT,
    )  # fmt: skip
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
    finally:
        server.shutdown()
        for connection in connections:
            with contextlib.suppress(Exception):
                connection.socket.shutdown(socket.SHUT_RDWR)
        thread.join(timeout=5.0)


def answer_each(answer: Callable[[dict[str, Any], int], Any]) -> Handler:
    """A handler as strangers write it: no greeting, reset acknowledged, queries answered.

    `answer(request, number)` gives a reply to encode, or bytes or a text to send as they are.
    """

    def handle(connection: Any) -> None:
        number = 0
        for frame in connection:
            request = decode_message(frame)
            if request["endpoint"] == "reset":
                connection.send(encode_message({"status": "ok"}))
                number = 0
                continue
            reply = answer(request, number)
            number += 1
            connection.send(reply if isinstance(reply, bytes | str) else encode_message(reply))

    return handle


def _then(act: Callable[[Any], None]) -> Handler:
    """A handler that acknowledges the reset and then does something else than answer."""

    def handle(connection: Any) -> None:
        connection.recv()
        connection.send(encode_message({"status": "ok"}))
        connection.recv()
        act(connection)

    return handle


def _raw(connection: Any, data: bytes) -> None:
    """Bytes under WebSocket's feet."""
    connection.socket.sendall(data)
    time.sleep(0.2)


def _array(**changes: Any) -> bytes:
    wire: dict[bytes, Any] = {
        b"__ndarray__": True, b"data": bytes(12), b"dtype": "<f4", b"shape": [1, 3]
    }  # fmt: skip
    wire |= {key.encode(): value for key, value in changes.items()}
    return encode_message({"action_type": "nav_delta", "actions": wire})


def _drip(connection: Any) -> None:
    """A frame that arrives a byte a time."""
    connection.socket.sendall(b"\x82\x7e\x03\xe8")
    while True:
        connection.socket.sendall(b"\x80")
        time.sleep(0.05)


def _always(reply: Any) -> Handler:
    return answer_each(lambda request, number: reply)


def _both(connection: Any) -> None:
    for _ in range(100):
        for _ in range(2):
            connection.send(encode_message({"actions": [1]}))
        connection.recv()


ROGUES: dict[str, Handler] = {
    "hangs": _then(lambda c: time.sleep(60)),
    "drips": _then(_drip),
    "answers with text": _always("CUDA out of memory\nat line 3"),
    "answers with noise": _always(os.urandom(64)),
    "answers with nothing": _always(b""),
    "answers twice": _then(_both),
    "truncates": _always(b"\x82\xa7actions\x93\x01"),
    "announces four billion actions": _always(b"\x81\xa7actions\xdd\xff\xff\xff\xff"),
    "nests without end": _always(b"\x91" * 100_000),
    "sends a huge frame": _always(bytes(5 << 20)),
    "announces an endless frame": _then(
        lambda c: _raw(c, b"\x82\x7f" + struct.pack(">Q", 1 << 62))
    ),
    "breaks the framing": _then(lambda c: _raw(c, b"\xff\xff\xff\xff\xff")),
    "sends text that is no UTF-8": _then(lambda c: _raw(c, b"\x81\x02\xff\xff")),
    "closes with a reason": _then(lambda c: c.close(1011, "out of memory")),
    "drops the line": _then(lambda c: c.socket.shutdown(socket.SHUT_RDWR)),
    "lies about a shape": _always(_array(shape=[2, 3])),
    "lies about a dtype": _always(_array(dtype="<f8")),
    "sends objects": _always(_array(dtype="|O")),
    "sends an array of another shape": _always(
        {"action_type": "nav_delta", "actions": np.zeros((2, 2), np.float32)}
    ),
    "sends a map of nothing": _always({}),
    "sends a list": _always([1, 2, 3]),
    "sends an unknown action": _always({"actions": [7]}),
    "sends an unknown word": _always({"actions": ["jump"]}),
    "sends an unknown kind": _always({"action_type": "dance", "actions": [1]}),
    "jumps to the moon": _always({"action_type": "nav_delta", "actions": [[3.8e8, 0, 0]]}),
    "speaks in words unasked": _always({"action_type": "text", "text": "stop"}),
}
