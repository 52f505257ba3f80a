"""A small server kit: a policy class becomes a server that a benchmark run can ask.

    class MyPolicy:
        name = "mine"
        sensors = frozenset({"depth"})
        def reset(self, instruction, rng): ...
        def act(self, observation): return Action.FORWARD

    serve(MyPolicy, port=8000)

The class is the one that also runs in-process as a plug-in. A class with `answer(observation,
frames)` instead of `act` may return several actions at once, moves in metres, or a text.
"""

from __future__ import annotations

import contextlib
import hmac
import logging
import threading
import time
from collections.abc import Callable, Sequence
from http import HTTPStatus
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np

from gn0.errors import ConfigError, FormatError, Gn0Error, PolicyError
from gn0.geometry import U8, world_to_agent, wrap_angle
from gn0.loopback import is_loopback
from gn0.policies.remote.client import check_token, find_token
from gn0.policies.remote.extension import KEY, build_greeting, read_observation
from gn0.policies.remote.gate import BYTES_LIMIT, QUEUE_LIMIT, BusyError, Gate
from gn0.policies.remote.wire import REQUEST_LIMITS, WireLimits, decode_message, encode_message
from gn0.seeds import load_stream, random_stream
from gn0.sim.policy import Policy, PolicyIdentified
from gn0.sim.sensor.table import check_sensors
from gn0.sim.state import Action, Displacement, Observation, Teleport

CONNECTIONS_LIMIT = 64
IDLE_TIMEOUT = 600.0  # s without a request until a connection is closed
SILENT_TIMEOUT = 10.0  # s until one that never asked must go, where the house is full
TRY_AGAIN_LATER = 1013  # close code (IANA's registry of WebSocket close codes)
WORDS_LIMIT = 100_000  # characters of an instruction or a session id
_log = logging.getLogger(__name__)


class Answerer(Protocol):
    """What a server asks: like a `Policy`, but for several actions at once.

    Attributes:
        name: what the server calls itself.
        sensors: observation fields it reads.
    """

    name: str
    sensors: frozenset[str]

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        ...

    def answer(self, observation: Observation, frames: Sequence[U8]) -> Any:
        """Actions, rows of (dx forward, dy left [m], dyaw [rad]), a text, or a whole reply (dict).

        `frames` are the pictures since the last question, the current one last.
        """
        ...


class PolicyServer:
    """Serves a policy in the background while its `with` block lasts.

    Each connection has a policy of its own, and one is asked at a time, so a model that all of them
    share needs no lock. Any exception of the policy goes back to the client as an error text.

    A few questions may wait (`queue`). Any further client is told at once when to come back: a
    new one by HTTP 503 with Retry-After, a connected one by the extension's `{"status": "busy",
    "retry_after": s}`, or by close code 1013 if it does not know the extension.

    Args:
        build: builds a policy or `Answerer`; called once here and once a connection.
        host: address to listen on; only this machine unless there is a token.
        port: TCP port; 0 takes a free one, see `url`.
        token: what clients must send as `Authorization: Bearer`; by default that of `$GN0_TOKEN`.
        limits: what a request may hold.
        model, version: what clients are told of the model; runs of another one are not gone on
            with. What the policy's own `identity()` says is told too.
        queue: questions that may wait while one is answered.
        held_bytes: bytes of all questions that are held at a time.
        idle_timeout: seconds without a question until a connection is closed.

    Raises:
        ConfigError: another machine could reach it and there is no token, or the port is taken.
    """

    def __init__(
        self,
        build: Callable[[], Policy | Answerer],
        *,
        host: str = "127.0.0.1",
        port: int = 8000,
        token: str | None = None,
        limits: WireLimits = REQUEST_LIMITS,
        model: str = "",
        version: str = "",
        queue: int = QUEUE_LIMIT,
        held_bytes: int = BYTES_LIMIT,
        idle_timeout: float = IDLE_TIMEOUT,
    ) -> None:
        from websockets.sync.server import serve

        if queue < 0 or held_bytes < 1 or not idle_timeout > 0:
            raise ConfigError(
                f"queue {queue}, {held_bytes} bytes, idle after {idle_timeout} s",
                where="limits of a server",
                remedy="give a queue of 0 or more, and positive bytes and seconds",
            )

        self._token = find_token() if token is None else check_token(token)
        if not is_loopback(host) and not self._token:
            raise ConfigError(
                f"{host} can be reached by other machines, and there is no token",
                where="host",
                remedy="set GN0_TOKEN, for the clients too, or listen on 127.0.0.1",
            )
        self._build = build
        self._limits = limits
        first = build()  # a policy that cannot be built says so now, not to the first client
        self._spare: list[Policy | Answerer] = [first]
        self.name = str(first.name)
        declared = first.identity() if isinstance(first, PolicyIdentified) else None
        self._greeting = encode_message(
            build_greeting(self.name, check_sensors(first.sensors), model, version, declared)
        )
        self._gate = Gate(queue, held_bytes)
        self._idle_timeout = idle_timeout
        self._building = threading.Lock()
        self._open: set[Any] = set()
        self._silent: dict[Any, float] = {}  # since when, of those who never asked
        self._threads: list[threading.Thread] = []
        try:
            self._server = serve(
                self._handle,
                host,
                port,
                max_size=limits.size,
                max_queue=1,  # a client waits for its answer before it asks again
                compression=None,
                ping_interval=None,
                origins=[None],  # a page in a browser has no business here
                process_request=self._admit,
                close_timeout=1.0,
                logger=_QUIET,
            )
        except OSError as error:
            raise ConfigError(
                f"cannot listen: {error.strerror or error}",
                where=f"{host}:{port}",
                remedy="choose another port",
            ) from None
        bound = self._server.socket.getsockname()
        self.url = f"ws://{f'[{host}]' if ':' in host else host}:{bound[1]}"

    def _admit(self, connection: Any, request: Any) -> Any:
        """Refuse who has no token, and who comes when the house is full."""
        if self._token:
            sent = request.headers.get_all("Authorization")
            wanted = f"Bearer {self._token}".encode()
            given = sent[0].encode("utf-8", "replace") if len(sent) == 1 else b""
            if not hmac.compare_digest(given, wanted):
                return connection.respond(HTTPStatus.UNAUTHORIZED, "token required\n")
        if len(self._open) >= CONNECTIONS_LIMIT:
            self._dismiss_silent()
            return self._turn_away(connection, "too many connections", SILENT_TIMEOUT)
        if self._gate.is_full:
            return self._turn_away(connection, "busy", self._gate.retry_after())
        return None

    def _turn_away(self, connection: Any, why: str, seconds: float) -> Any:
        response = connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{why}\n")
        response.headers["Retry-After"] = str(max(1, round(seconds)))  # whole seconds (RFC 9110)
        return response

    def _dismiss_silent(self) -> None:
        """Hang up on those who took a seat long ago and never asked anything."""
        for connection, since in list(self._silent.items()):
            if time.monotonic() - since > SILENT_TIMEOUT:
                self._silent.pop(connection, None)
                threading.Thread(
                    target=_hang_up, args=(connection, "silent, and others wait"), daemon=True
                ).start()

    def _handle(self, connection: Any) -> None:
        from websockets.exceptions import ConnectionClosed

        self._open.add(connection)
        self._silent[connection] = time.monotonic()
        try:
            connection.send(self._greeting)  # at once: a client waits two seconds for it
            session: PolicySession | None = None
            while True:
                frame = connection.recv(timeout=self._idle_timeout)
                self._silent.pop(connection, None)
                if session is None:
                    with self._building:
                        session = PolicySession(self._spare.pop() if self._spare else self._build())
                connection.send(self._answer(session, frame, connection))
        except _Leave as leave:
            _hang_up(connection, str(leave))
        except (ConnectionClosed, TimeoutError, OSError):
            pass  # the client is gone, or has nothing to say
        except Exception:
            _log.exception("a policy could not be built")
            with contextlib.suppress(Exception):
                connection.close(1011, "the policy cannot be built")
        finally:
            self._open.discard(connection)
            self._silent.pop(connection, None)
            self._gate.forget(connection)

    def _answer(self, session: PolicySession, frame: bytes | str, who: object) -> bytes | str:
        """The reply to a request; a text is an error.

        Raises:
            _Leave: too busy, and the client does not know the extension's way to say so.
        """
        try:
            if isinstance(frame, str):
                raise FormatError("is a text", where="request", remedy="send binary frames")
            request = decode_message(frame, self._limits)
            if not session.asks_policy(request):
                return encode_message(session.reply(request))
            try:
                with self._gate.enter(len(frame), who):
                    reply = session.reply(request)
            except BusyError as busy:
                if session.extended:
                    return encode_message({"status": "busy", "retry_after": busy.retry_after})
                raise _Leave(str(busy)) from None
            return encode_message(reply)
        except Gn0Error as error:
            _log.warning("%s", error)
            return str(error)
        except _Leave:
            raise
        except Exception as error:
            _log.exception("the policy failed")
            return f"{type(error).__name__}: {error}"[:2000]

    def serve_forever(self) -> None:
        """Serve until `close` is called from elsewhere."""
        self._server.serve_forever()

    def close(self) -> None:
        """Stop listening and close all connections."""
        self._server.shutdown()
        for connection in list(self._open):
            with contextlib.suppress(Exception):
                connection.close(1001)
        for thread in self._threads:
            thread.join(timeout=5.0)

    def __enter__(self) -> Self:
        thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        thread.start()
        self._threads.append(thread)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class PolicySession:
    """One client's policy, and where its episode stands.

    Args:
        policy: a `Policy` or an `Answerer`.
    """

    def __init__(self, policy: Policy | Answerer) -> None:
        self.policy = policy
        self.extended = False  # whether the client has spoken the extension
        self._session: str | None = None
        self._before: Observation | None = None

    def asks_policy(self, request: Any) -> bool:
        """Whether a request makes the policy think; notes who speaks the extension."""
        if not isinstance(request, dict):
            return False
        self.extended = self.extended or isinstance(request.get(KEY), dict)
        endpoint = request.get("endpoint")
        return isinstance(endpoint, str) and endpoint == "infer"

    def reply(self, request: Any) -> dict[str, Any]:
        """The reply to a decoded request.

        Raises:
            FormatError: it is not a valid request.
            PolicyError: the policy gives no action.
        """
        if not isinstance(request, dict):
            raise FormatError("not a map", where="request", remedy="send a map")
        endpoint = request.get("endpoint")
        if not isinstance(endpoint, str):  # an array compares with a text cell by cell
            endpoint = ""
        if endpoint == "reset":
            self._session = None
            return {"status": "ok"}
        if endpoint != "infer":
            raise FormatError(
                "unknown", where="request", field="endpoint", remedy="send reset or infer"
            )
        instruction = _words(request, "instruction")
        session = _words(request, "session_id")
        fresh = session != self._session
        images = request.get("images")
        seen = read_observation(
            instruction, images, request.get(KEY), None if fresh else self._before
        )
        if fresh:
            self.policy.reset(instruction, _stream(request.get(KEY), session))
            self._session = session
        self._before = seen
        frames: Sequence[U8] = [] if images is None else images if images.ndim == 4 else [images]
        if hasattr(self.policy, "answer"):
            said = self.policy.answer(seen, frames)
        else:
            said = self.policy.act(seen)
        return build_reply(said, seen)


def _stream(more: Any, session: str) -> np.random.Generator:
    """An episode's chance: the client's stream or seed, or that of the session's name."""
    stream = more.get("stream") if isinstance(more, dict) else None
    if isinstance(stream, str):
        return load_stream(stream)
    seed = more.get("seed") if isinstance(more, dict) else None
    if isinstance(seed, int):
        return random_stream(seed, "remote policy")
    return random_stream(0, "remote policy", session)


def _words(request: dict[str, Any], name: str) -> str:
    value = request.get(name, "")
    if not isinstance(value, str) or len(value) > WORDS_LIMIT:
        raise FormatError("not a text", where="request", field=name, remedy="send a text")
    return value


def build_reply(said: Any, seen: Observation) -> dict[str, Any]:
    """What a policy said, as a reply.

    Raises:
        PolicyError: it is no action; or a `Teleport`, and the client told no pose.
    """
    if isinstance(said, dict):
        return said
    if isinstance(said, str):
        return {"action_type": "text", "text": said}
    if isinstance(said, Teleport):
        if seen.pose is None:
            raise PolicyError(
                "a Teleport needs the pose, which the client does not tell",
                remedy="answer with a Displacement, or run with --policy-option pose=true",
            )
        forward, left = world_to_agent(seen.pose, said.x, said.y)
        said = Displacement(forward, left, wrap_angle(said.yaw - seen.pose.yaw))
    if isinstance(said, Displacement):
        return {"action_type": "nav_delta", "actions": [[float(v) for v in said]]}
    if isinstance(said, Action | int | np.integer) and not isinstance(said, bool):
        return {"action_type": "discrete", "actions": [int(said)]}
    if isinstance(said, np.ndarray):
        said = said.tolist()
    if not isinstance(said, list | tuple):
        raise PolicyError(f"the policy said {said!r:.80}", remedy="return actions")
    if said and all(isinstance(row, list | tuple | np.ndarray) for row in said):
        return {"action_type": "nav_delta", "actions": [[float(v) for v in row] for row in said]}
    words = [code if isinstance(code, str) else int(code) for code in said]
    return {"action_type": "discrete", "actions": words}


def serve(
    build: Callable[[], Policy | Answerer],
    *,
    host: str = "127.0.0.1",
    port: int = 8000,
    token: str | None = None,
    model: str = "",
    version: str = "",
    queue: int = QUEUE_LIMIT,
) -> None:
    """Serve a policy until Ctrl-C; see `PolicyServer`.

    Raises:
        ConfigError: another machine could reach it and there is no token, or the port is taken.
    """
    server = PolicyServer(
        build, host=host, port=port, token=token, model=model, version=version, queue=queue
    )
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        pass
    finally:
        server.close()


class _Leave(Exception):  # noqa: N818 (no fault: the client is to come again)
    """A connection has to be closed, with these words."""


def _hang_up(connection: Any, why: str) -> None:
    with contextlib.suppress(Exception):
        connection.close(TRY_AGAIN_LATER, why)


_QUIET = logging.getLogger("gn0.policies.remote.websocket")
_QUIET.setLevel(logging.CRITICAL)  # strangers at the door are no news
