"""The client: one WebSocket connection to one policy server, with limits on time and size.

Nothing a server does takes longer than the time limits or more memory than the size limits, and
whatever goes wrong is a `PolicyError` that says which server did what.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import sys
import time
from typing import Any
from urllib.parse import urlsplit

from gn0.errors import ConfigError, FormatError, PolicyError
from gn0.loopback import is_loopback
from gn0.policies.remote.answers import show
from gn0.policies.remote.extension import wants_text_keys
from gn0.policies.remote.wire import REPLY_LIMITS, WireLimits, decode_message, encode_message

TOKEN_VARIABLE = "GN0_TOKEN"  # noqa: S105 (a name, not a secret)
HOST_VARIABLE = "GN0_TOKEN_HOST"
FIRST_PAUSE, LONGEST_PAUSE = 0.25, 2.0  # s between attempts to connect
CLOSE_TIMEOUT = 1.0  # s for a server to say goodbye


class RemoteClient:
    """A connection that is opened on the first request and closed on the first fault.

    Args:
        url: ws://host:port, or wss:// for another machine.
        connect_timeout: seconds of attempts until the server counts as down.
        request_timeout: seconds until an unanswered request counts as hung.
        metadata_timeout: seconds to wait for the optional first frame of the server.
        token: sent as `Authorization: Bearer`; by default that of `$GN0_TOKEN`, which goes to the
            hosts that `$GN0_TOKEN_HOST` names and, where it names none, to this machine alone.
        limits: what a reply may hold.

    Raises:
        ConfigError: no such address, or another machine and no token.
    """

    def __init__(
        self,
        url: str,
        *,
        connect_timeout: float = 30.0,
        request_timeout: float = 120.0,
        metadata_timeout: float = 2.0,
        token: str | None = None,
        limits: WireLimits = REPLY_LIMITS,
    ) -> None:
        self.url = url
        self.connect_timeout = connect_timeout
        self.request_timeout = request_timeout
        self.metadata_timeout = metadata_timeout
        self.limits = limits
        self.metadata: dict[str, Any] = {}
        self._token = find_token_for(url) if token is None else check_token(token)
        self._host, self._port = check_url(url, self._token)
        self._connection: Any = None
        self._asked = False  # whether this connection has been asked anything

    @property
    def connected(self) -> bool:
        """Whether a connection is open, as far as we know."""
        return self._connection is not None and self._connection.protocol.state.name == "OPEN"

    def connect(self) -> None:
        """Open the connection and read the server's first frame, if it sends one.

        Attempts go on, ever more slowly, until `connect_timeout`.

        Raises:
            PolicyError: nobody answers, or what answers is no policy server of ours.
        """
        self.close()
        until = time.monotonic() + self.connect_timeout
        pause = FIRST_PAUSE
        while True:
            try:
                self._open(max(0.1, min(10.0, until - time.monotonic())))
                break
            except _Later as later:
                pause = max(pause, later.seconds)
                if time.monotonic() + pause >= until:
                    raise PolicyError(
                        f"no policy server at {self.url}: {later}",
                        remedy="start it, or name its address with --policy-option url=ws://"
                        "HOST:PORT; a server that loads for long needs --policy-option "
                        "connect_timeout=SECONDS",
                    ) from None
            time.sleep(pause)
            pause = min(2 * pause, LONGEST_PAUSE)
        self._asked = False
        self.metadata = self._greet()

    def _open(self, timeout: float) -> None:
        """One attempt.

        Raises:
            _Later: it may go better later.
            PolicyError: it will not.
        """
        from websockets.exceptions import InvalidHandshake, InvalidStatus, WebSocketException
        from websockets.sync.client import connect

        headers = {"Authorization": f"Bearer {self._token}"} if self._token else {}
        try:
            channel = socket.create_connection((self._host, self._port), timeout=timeout)
        except (OSError, UnicodeError) as error:
            raise _Later(getattr(error, "strerror", None) or str(error)) from None
        try:
            channel.settimeout(None)
            _limit_sending(channel, self.request_timeout)
            self._connection = connect(
                self.url,
                sock=channel,  # ours: no proxy, no redirect, a limit on sending
                max_size=self.limits.size,
                open_timeout=timeout,
                close_timeout=CLOSE_TIMEOUT,
                ping_interval=None,
                compression=None,  # pictures over loopback: deflating them costs more than it saves
                additional_headers=headers,
            ).__enter__()  # as websockets 17 wants it; 16 and before give the same connection
        except InvalidStatus as error:
            channel.close()
            code = error.response.status_code
            if code in (401, 403):
                raise PolicyError(
                    f"the policy server at {self.url} refuses us (HTTP {code})",
                    remedy=f"set {TOKEN_VARIABLE} to the token that the server was started with",
                ) from None
            if code >= 500:
                wait = error.response.headers.get("Retry-After", "")
                seconds = min(float(wait), LONGEST_PAUSE) if wait.isdecimal() else 0.0
                raise _Later(f"it answers HTTP {code}", seconds) from None
            raise PolicyError(
                f"{self.url} is not a WebSocket server: it answers HTTP {code}",
                remedy="check host and port",
            ) from None
        except (InvalidHandshake, WebSocketException, OSError, EOFError, ValueError) as error:
            channel.close()
            if isinstance(error, TimeoutError):
                raise _Later("it takes the connection and says nothing") from None
            if isinstance(error, OSError | EOFError):
                raise _Later("it hangs up during the handshake") from None
            raise _Later(f"it does not speak WebSocket ({type(error).__name__})") from None

    def _greet(self) -> dict[str, Any]:
        """The optional first frame: a map that describes the server."""
        try:
            frame = self._receive(self.metadata_timeout)
        except _Silence:
            return {}
        value = self._decode(frame, "the first frame of the server")
        if not isinstance(value, dict):
            raise self._fault(f"greets with a {type(value).__name__}, not a map")
        return value

    def request(self, payload: dict[str, Any]) -> Any:
        """Send a request and wait for its answer, decoded.

        Raises:
            PolicyError: no connection, no answer in time, a text frame, or an answer that is not
                what the protocol says. The connection is closed then, so that a late answer is
                never taken for that of another question; a text frame leaves it open.
        """
        if not self.connected:
            self.connect()
        message = encode_message(payload, text_keys=wants_text_keys(self.metadata))
        until = time.monotonic() + self.request_timeout
        while True:
            answer = self._ask(message)
            seconds = read_busy(answer)
            if seconds is None:
                return answer
            if time.monotonic() + seconds >= until:
                raise self._fault(f"was too busy to answer for {self.request_timeout:g} s")
            time.sleep(seconds)

    def _ask(self, message: bytes) -> Any:
        """One question and its answer, decoded."""
        if not self.connected:
            self.connect()
        self._drain()
        self._asked = True
        try:
            self._connection.send(message)
        except Exception as error:
            raise self._lost(error) from None
        try:
            frame = self._receive(self.request_timeout)
        except _Silence:
            raise self._fault(f"gave no answer within {self.request_timeout:g} s") from None
        return self._decode(frame, "the answer")

    def _drain(self) -> None:
        """Take what came unasked: a late greeting is welcome, anything else is a fault."""
        try:
            frame = self._receive(0.0)
        except _Silence:
            return
        if self._asked:
            raise self._fault("sent a message that nobody asked for")
        value = self._decode(frame, "the first frame of the server")
        if isinstance(value, dict):
            self.metadata = value

    def _receive(self, timeout: float) -> bytes | str:
        try:
            frame: bytes | str = self._connection.recv(timeout=timeout)
            return frame
        except TimeoutError:
            raise _Silence from None
        except Exception as error:
            raise self._lost(error) from None

    def _decode(self, frame: bytes | str, what: str) -> Any:
        if isinstance(frame, str):
            raise PolicyError(
                f"the policy server at {self.url} reports an error: {show(frame)}",
                remedy="see the server's own log",
            )
        try:
            return decode_message(frame, self.limits)
        except FormatError as error:
            self.close()
            raise PolicyError(
                f"{what} at {self.url} cannot be read: {error.what}",
                remedy="answer with msgpack as in docs/policies.md",
            ) from None

    def _fault(self, what: str) -> PolicyError:
        self.close()
        return PolicyError(
            f"the policy server at {self.url} {what}", remedy="see the server's own log"
        )

    def _lost(self, error: Exception) -> PolicyError:
        """What a broken connection means."""
        from websockets.exceptions import ConnectionClosed

        what = f"is gone ({type(error).__name__})"
        if isinstance(error, ConnectionClosed):
            theirs, ours = error.rcvd, error.sent
            if theirs is not None and error.rcvd_then_sent is not False:
                reason = f": {show(theirs.reason)}" if theirs.reason else ""
                what = f"closed the connection (code {theirs.code}{reason})"
            elif ours is not None and ours.code == 1009:
                what = f"sent more than the {self.limits.size} bytes an answer may have"
            elif ours is not None:
                what = f"broke the WebSocket protocol: {show(ours.reason)}"
            else:
                what = "broke the connection off"
        return self._fault(what)

    def close(self) -> None:
        """Close the connection; opened again by the next request."""
        connection, self._connection = self._connection, None
        if connection is not None:
            with contextlib.suppress(Exception):
                connection.close()


class _Later(Exception):  # noqa: N818 (no fault, a reason to try again)
    """An attempt to connect that may go better later; `seconds` until it is worth another."""

    def __init__(self, why: str, seconds: float = 0.0) -> None:
        super().__init__(why)
        self.seconds = seconds


class _Silence(Exception):  # noqa: N818
    """Nothing was said in time."""


def read_busy(answer: Any) -> float | None:
    """Seconds after which a busy server wants to be asked again; None if it is no such answer."""
    if not (isinstance(answer, dict) and answer.get("status") == "busy"):
        return None
    seconds = answer.get("retry_after", FIRST_PAUSE)
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not seconds > 0:
        return FIRST_PAUSE
    return min(float(seconds), 30.0)


def _limit_sending(channel: socket.socket, seconds: float) -> None:
    """Make a send fail that a server does not take in for so long."""
    if sys.platform == "win32":
        value: bytes | int = int(min(seconds, 1e6) * 1000)
    else:
        value = struct.pack("ll", int(min(seconds, 1e6)), int(seconds % 1 * 1e6))
    with contextlib.suppress(OSError):
        channel.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, value)
        channel.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def find_token() -> str:
    """The token of `$GN0_TOKEN`, "" without one.

    Raises:
        ConfigError: it cannot be sent as a header.
    """
    return check_token(os.environ.get(TOKEN_VARIABLE, ""))


def find_token_for(url: str) -> str:
    """The token of `$GN0_TOKEN` if it was given for that server, else "".

    A token belongs to the hosts that `$GN0_TOKEN_HOST` names, as HOST or HOST:PORT with commas
    between; where it names none, to this machine.

    Raises:
        ConfigError: it cannot be sent as a header.
    """
    token = find_token()
    named = [name.strip().lower() for name in os.environ.get(HOST_VARIABLE, "").split(",")]
    try:
        parts = urlsplit(url)
        host, port = parts.hostname or "", parts.port or (443 if parts.scheme == "wss" else 80)
    except (ValueError, TypeError, AttributeError):
        return ""
    if not any(named):
        return token if is_loopback(host) else ""
    return token if {host, f"{host}:{port}", f"[{host}]:{port}"} & {*named} else ""


def check_token(token: str) -> str:
    """The token itself, if it can be sent as a header.

    Raises:
        ConfigError: it cannot; the token is not repeated.
    """
    if any(not 0x21 <= ord(character) <= 0x7E for character in token):
        raise ConfigError(
            "the token holds blanks or characters beyond ASCII",
            where=TOKEN_VARIABLE,
            remedy="take letters and digits, e.g. from `python -c 'import secrets; "
            "print(secrets.token_urlsafe())'`",
        )
    return token


def check_url(url: str, token: str) -> tuple[str, int]:
    """Host and port of a server's address.

    Raises:
        ConfigError: it is not such an address, or is on another machine and has no token.
    """
    remedy = "give ws://127.0.0.1:8000 or the like"
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except (ValueError, TypeError, AttributeError):
        raise ConfigError(f"{url!r} is not the address of a server", remedy=remedy) from None
    if parts.scheme not in ("ws", "wss") or not host or parts.username or parts.password:
        raise ConfigError(f"{url!r} is not the address of a WebSocket server", remedy=remedy)
    if not is_loopback(host) and not token:
        raise ConfigError(
            f"{host} is another machine, and there is no token for it",
            where=url,
            remedy=f"set {TOKEN_VARIABLE} to the token that the server was started with, and "
            f"{HOST_VARIABLE}={host}: it is sent nowhere else",
        )
    return host, port or (443 if parts.scheme == "wss" else 80)
