"""The web server of the live view: viser, behind a gate that viser itself does not have.

Whoever reaches viser's port may do everything the page can do, and viser asks nobody who he is.
So each request, the WebSocket's too, first passes a gate here: it needs the secret that is part of
the printed address (kept in a cookie from then on), and a page of another origin is refused. The
share button, which would open a tunnel through somebody else's server, is taken out.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import logging
import secrets
import socket
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlencode, urlsplit

from gn0.errors import ConfigError, StorageError
from gn0.loopback import is_loopback

if TYPE_CHECKING:
    import viser

DEFAULT_PORT = 8080
PORTS_TRIED = 100
EPISODE_LIMIT = 1000  # characters of an id in an address
CLOSED = "This view is private. Open the whole address that `gn0 view` printed, secret included.\n"


@dataclass(frozen=True)
class Gate:
    """Lets in who knows the secret.

    Attributes:
        secret: part of the address, then of a cookie.
        cookie: the cookie's name; one a server, for cookies know no ports.
    """

    secret: str
    cookie: str

    @classmethod
    def fresh(cls) -> Gate:
        """A gate with a secret of its own."""
        return cls(secrets.token_urlsafe(16), f"gn0_view_{secrets.token_hex(4)}")

    def judge(self, path: str, headers: Any) -> tuple[int, str, dict[str, str]] | None:
        """None to let a request pass, else the (status, text, headers) to answer with.

        Args:
            path: path and query as requested.
            headers: the request's headers; a mapping with `get` and `get_all`.
        """
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != headers.get("Host"):
            return 403, "Pages of another origin are refused.\n", {}
        given = [
            value
            for line in headers.get_all("Cookie")
            for name, _, value in (part.strip().partition("=") for part in line.split(";"))
            if name == self.cookie
        ]
        if any(self._right(value) for value in given):
            return None
        asked = parse_qs(urlsplit(path).query).get("secret", [""])[0]
        if self._right(asked):
            cookie = f"{self.cookie}={self.secret}; Path=/; HttpOnly; SameSite=Lax"
            episode = wanted_episode(path)
            place = f"/?{urlencode({'episode': episode})}" if episode else "/"
            return 303, "", {"Location": place, "Set-Cookie": cookie, "Cache-Control": "no-store"}
        return 403, CLOSED, {}

    def _right(self, value: str) -> bool:
        return secrets.compare_digest(value.encode(), self.secret.encode())


def wanted_episode(path: str) -> str:
    """The episode that a requested path and query asks for; "" for none."""
    parts = urlsplit(path)
    wanted = parse_qs(parts.query).get("episode", [""])[0] if parts.path == "/" else ""
    return wanted if len(wanted) <= EPISODE_LIMIT else ""


@dataclass(frozen=True)
class LiveServer:
    """A running server.

    Attributes:
        viser: the server itself.
        url: the address to open, with its secret.
        port: where it listens.
        asked_port: where it was asked to.
        asks: called with the id of the episode that a visitor's address asks for, from the
            server's own thread; the id is whatever somebody typed.
    """

    viser: viser.ViserServer
    url: str
    port: int
    asked_port: int
    asks: list[Callable[[str], None]] = field(default_factory=list)


# viser's page unpacks its own scripts and its sorter of splats is compiled by emscripten, so inline
# scripts and eval must work; but nothing on the page may load from another host, or tell it a word
PAGE_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:",
        "worker-src blob:",
        "connect-src 'self' blob: data:",
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' blob: data:",
        "font-src 'self' data:",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)


def need_viser() -> Any:
    """The viser module.

    Raises:
        ConfigError: it is not installed; says what to type.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of its dependencies; none of our business
            import viser
    except ImportError as error:
        raise ConfigError(
            f"the live view needs the package viser, which is not here ({error})",
            remedy="pip install -e '.[view]'",
        ) from None
    return viser


def find_port(host: str, port: int) -> int:
    """The first free port from `port` on; 0 asks the system for any.

    Raises:
        ConfigError: the host cannot be listened on, or no port is free.
    """
    last: OSError | None = None
    for candidate in [port] if port == 0 else range(port, min(port + PORTS_TRIED, 65536)):
        try:
            found = socket.getaddrinfo(host, candidate, type=socket.SOCK_STREAM)[0]
            with socket.socket(found[0], socket.SOCK_STREAM) as trial:
                trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                trial.bind(found[4])
                return int(trial.getsockname()[1])
        except socket.gaierror as error:
            last = error
            break
        except OSError as error:
            last = error
    raise ConfigError(
        f"cannot listen on {host} from port {port} on: {last}",
        where="--host, --port",
        remedy="choose an address of this machine and a free port",
    )


@contextlib.contextmanager
def open_server(
    host: str = "127.0.0.1",
    port: int = DEFAULT_PORT,
    *,
    allow_remote: bool = False,
    label: str = "GN0",
) -> Iterator[LiveServer]:
    """Run a live server until the end of the block.

    Raises:
        ConfigError: no viser, no such host or port, or an open address without `allow_remote`.
    """
    module = need_viser()
    if not is_loopback(host) and not allow_remote:
        raise ConfigError(
            f"{host} can be reached from other machines; the page is not encrypted, and anyone "
            "with its address sees the scene and moves the agent",
            where="--host",
            remedy="stay on 127.0.0.1 and forward the port (ssh -L), or add --allow-remote",
        )
    chosen = find_port(host, port)
    gate = Gate.fresh()
    # what viser prints of itself would bury our own line
    asks: list[Callable[[str], None]] = []
    with contextlib.redirect_stdout(io.StringIO()), _gated(gate, asks) as used:
        server = _private(module)(host=host, port=chosen, label=label, verbose=False)
    try:
        if not used:
            raise ConfigError(
                f"viser {module.__version__} starts its server in a way that cannot be guarded",
                remedy="pip install 'viser>=1.0,<2'",
            )
        actual = server.get_port()
        shown = "localhost" if host in ("0.0.0.0", "::", "localhost") else host  # noqa: S104
        shown = f"[{shown}]" if ":" in shown else shown
        url = f"http://{shown}:{actual}/?secret={gate.secret}"
        yield LiveServer(server, url, actual, port, asks)
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def _private(module: Any) -> Any:
    """A viser server without the share tunnel."""

    class PrivateServer(module.ViserServer):
        def request_share_url(self, verbose: bool = True) -> str | None:
            return None  # any client may ask; none gets a tunnel

    return PrivateServer


@contextlib.contextmanager
def _gated(gate: Gate, asks: list[Callable[[str], None]]) -> Iterator[list[bool]]:
    """Put the gate in front of the next server that the websockets library starts.

    viser hands no hook through, so its call is caught on the way: `process_request` is documented
    by websockets and sees every request before anybody else.
    """
    import websockets.asyncio.server as library
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    original, used = library.serve, []

    def answer(inner: Any, connection: Any, request: Any) -> Any:
        refusal = gate.judge(request.path, request.headers)
        if refusal is None:
            episode = wanted_episode(request.path)
            for ask in asks if episode else ():
                ask(episode)
            return dress_page(inner(connection, request)) if inner else None
        _silence(connection)
        status, text, more = refusal
        body = text.encode()
        kind = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))}
        return Response(status, "refused" if status == 403 else "see", Headers(kind | more), body)

    def serve(*args: Any, **options: Any) -> Any:
        used.append(True)
        inner = options.pop("process_request", None)
        return original(*args, process_request=partial(answer, inner), **options)

    library.serve = serve  # type: ignore[assignment, misc]
    try:
        yield used
    finally:
        library.serve = original  # type: ignore[misc]


def dress_page(response: Any) -> Any:
    """Viser's page with our title and our script before its own; other answers as they are.

    The script (live_page.js) makes splats fast where there is no GPU.
    """
    if response is None or not str(response.headers.get("Content-Type")).startswith("text/html"):
        return response
    packed = response.headers.get("Content-Encoding") == "gzip"
    response.body = _dress(response.body, packed)
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["X-Frame-Options"] = "DENY"
    response.headers["Referrer-Policy"] = "no-referrer"
    response.headers["Content-Security-Policy"] = PAGE_POLICY
    return response


@lru_cache(maxsize=4)
def _dress(body: bytes, packed: bool) -> bytes:
    html = gzip.decompress(body) if packed else body
    script = Path(__file__).with_name("live_page.js").read_bytes()
    start = b"<title>GN0 view</title><script>" + script + b"</script>"
    html = html.replace(b"<title>Viser</title>", b"").replace(b"<head>", b"<head>" + start, 1)
    return gzip.compress(html, 1) if packed else html


def _silence(connection: Any) -> None:
    """A plain HTTP answer is no failed handshake to be reported with a traceback."""
    with contextlib.suppress(AttributeError):
        connection.logger.logger.setLevel(logging.CRITICAL)


def fetch_page(server: LiveServer, *, wait: float = 10.0) -> bytes:
    """The page as a browser gets it: through the gate, cookie and all.

    Raises:
        StorageError: the server does not answer with its page.
    """
    import http.client

    parts = urlsplit(server.url)
    try:
        connection = http.client.HTTPConnection(str(parts.hostname), server.port, timeout=wait)
        connection.request("GET", f"/?{parts.query}")
        first = connection.getresponse()
        first.read()
        cookie = (first.getheader("Set-Cookie") or "").partition(";")[0]
        connection.close()
        connection.request("GET", "/", headers={"Cookie": cookie})
        second = connection.getresponse()
        body = second.read()
        connection.close()
    except OSError as error:
        raise StorageError(f"the page does not open: {error}", where=server.url) from error
    if second.status != 200 or b"<html" not in body[:4096]:
        raise StorageError(f"the page answers {second.status}", where=server.url)
    return body
