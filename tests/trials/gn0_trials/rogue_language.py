"""Language servers for tests: one that does its work, and those that misbehave.

Each handler answers one request with `reply(server, number)`, `number` counting from 0. A good
answer is made from the prompt's own lines, so that it passes the check of any route.
"""

from __future__ import annotations

import contextlib
import json
import re
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


class LanguageRequest:
    """One request under way.

    Attributes:
        number: how many came before it.
        asked: the decoded request.
    """

    def __init__(self, handler: BaseHTTPRequestHandler, number: int, asked: dict[str, Any]) -> None:
        self._handler = handler
        self.number = number
        self.asked = asked

    def send(
        self,
        body: bytes | str,
        status: int = 200,
        kind: str = "application/json",
        **headers: str,
    ) -> None:
        """Answer with a body."""
        data = body.encode() if isinstance(body, str) else body
        self._handler.send_response(status)
        self._handler.send_header("Content-Type", kind)
        for name, value in {"Content-Length": str(len(data)), **headers}.items():
            self._handler.send_header(name.replace("_", "-"), value)
        self._handler.end_headers()
        self._handler.wfile.write(data)

    def complete(self, content: Any) -> None:
        """Answer with a chat completion."""
        self.send(
            json.dumps(
                {
                    "id": "x",
                    "object": "chat.completion",
                    "choices": [{"index": 0, "message": {"role": "assistant", "content": content}}],
                    "usage": {"prompt_tokens": 90, "completion_tokens": 10, "total_tokens": 100},
                }
            )
        )

    def raw(self, data: bytes) -> None:
        """Bytes under HTTP's feet."""
        self._handler.wfile.write(data)
        self._handler.wfile.flush()


Reply = Callable[[LanguageRequest], None]


def answer_well(request: LanguageRequest) -> None:
    """Do what the role asks, in the plainest words."""
    system, user = (m["content"] for m in request.asked["messages"])
    if "an editor" in system:
        text = user.split("Instruction: ", 1)[1]
        request.complete(json.dumps({"instruction": text}))
    elif "moving_instruction" in system:
        request.complete(json.dumps({"moving_instruction": _plain_route(user)}))
    else:
        request.complete(json.dumps({"instruction": _plain_route(user)}))


def _plain_route(user: str) -> str:
    steps = []
    for line in re.findall(r"^\d+\. (.*)$", user, re.MULTILINE):
        turn = re.match(r"turn (left|right|around)", line)
        steps.append(turn.group() if turn else "go straight")
    found = re.search(r"^(?:Goal|Target) object: (.*)$", user, re.MULTILINE)
    steps.append(f"stop at {found.group(1)}" if found else "stop")
    text = ", then ".join(steps)
    return text[0].upper() + text[1:] + "."


@contextlib.contextmanager
def serve_language(reply: Reply = answer_well) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Serve on a free port of this machine: (base_url, the requests seen so far)."""
    seen: list[dict[str, Any]] = []
    lock = threading.Lock()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            data = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            asked = json.loads(data)
            asked["_path"], asked["_headers"] = self.path, dict(self.headers)
            with lock:
                number = len(seen)
                seen.append(asked)
            with contextlib.suppress(OSError):
                reply(LanguageRequest(self, number, asked))

        def log_message(self, format: str, *arguments: Any) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    server.block_on_close = False
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.daemon = True
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/v1", seen
    finally:
        server.shutdown()
        server.server_close()
        thread.join(timeout=5.0)


def first(count: int, bad: Reply) -> Reply:
    """Misbehave `count` times, then do the work."""

    def reply(request: LanguageRequest) -> None:
        (bad if request.number < count else answer_well)(request)

    return reply


def _says(content: Any) -> Reply:
    return lambda request: request.complete(content)


def _sends(body: bytes | str, status: int = 200, kind: str = "application/json", **h: str) -> Reply:
    return lambda request: request.send(body, status, kind, **h)


def _instruction(change: Callable[[str], str]) -> Reply:
    """A good answer, spoilt."""

    def reply(request: LanguageRequest) -> None:
        kept = request.complete

        def spoil(content: Any) -> None:
            (field, text), *_ = json.loads(content).items()
            kept(json.dumps({field: change(text)}))

        request.complete = spoil  # type: ignore[method-assign]
        answer_well(request)

    return reply


def _swap(text: str) -> str:
    swapped = re.sub(
        r"\b(left|right)\b", lambda m: {"left": "right", "right": "left"}[m.group()], text
    )
    return swapped if swapped != text else f"Turn left. {text}"


def _drip(request: LanguageRequest) -> None:
    request.raw(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n")
    for _ in range(400):
        request.raw(b"X-Wait: 1\r\n")
        time.sleep(0.02)


def _huge(request: LanguageRequest) -> None:
    request.raw(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n\r\n")
    for _ in range(2000):
        request.raw(b" " * 65_536)


HTML = "<html><body><h1>502 Bad Gateway</h1>nginx</body></html>"

# what passes when one tries again
PASSING: dict[str, Reply] = {
    "429 once": first(1, _sends("{}", 429)),
    "429 with Retry-After": first(1, _sends("{}", 429, Retry_After="0.05")),
    "429 with a date": first(1, _sends("{}", 429, Retry_After="Wed, 21 Oct 2015 07:28:00 GMT")),
    "500 twice": first(2, _sends('{"error": {"message": "CUDA out of memory"}}', 500)),
    "503 with HTML": first(1, _sends(HTML, 503, "text/html")),
    "closes the line once": first(1, lambda request: None),
    "hangs once": first(1, lambda request: time.sleep(1.0)),
}

# what never becomes an instruction
ROGUES: dict[str, Reply] = {
    "429 for ever": _sends('{"error": "slow down"}', 429),
    "asks to wait a day": _sends("{}", 429, Retry_After="86400"),
    "500 for ever": _sends('{"error": "oops"}', 500),
    "refuses the key": _sends('{"error": {"message": "Incorrect API key"}}', 401),
    "knows no such path": _sends("404 page not found", 404, "text/plain"),
    "redirects": _sends("", 302, Location="http://127.0.0.1:9/v1"),
    "sends HTML": _sends(HTML, 200, "text/html"),
    "sends HTML as an error": _sends(HTML, 502, "text/html"),
    "sends nothing": _sends(b""),
    "sends nonsense": _sends(b"\x00\xff\xfe nonsense"),
    "sends half a JSON": _sends('{"choices": [{"message": {"content": "Go'),
    "nests without end": _sends("[" * 100_000),
    "sends another schema": _sends('{"completion": "Go straight."}'),
    "sends no choices": _sends('{"choices": []}'),
    "sends choices of text": _sends('{"choices": ["Go straight."]}'),
    "sends null": _says(None),
    "sends blanks": _says("  \n "),
    "hangs": lambda request: time.sleep(1.0),
    "drips headers": _drip,
    "closes the line": lambda request: None,
    "speaks no HTTP": lambda request: request.raw(b"SSH-2.0-OpenSSH_9.6\r\n"),
    "announces more than it sends": lambda request: request.raw(
        b"HTTP/1.1 200 OK\r\nContent-Length: 5000\r\n\r\n{}"
    ),
    "sends a huge body": _huge,
    "announces a huge body": lambda request: request.raw(
        b"HTTP/1.1 200 OK\r\nContent-Length: 99999999999999\r\n\r\n" + b" " * 400_000
    ),
    "answers in prose": _says("Sure! Go straight and turn left."),
    "answers in a code fence": _says('```json\n{"instruction": "Go."}\n```'),
    "answers with another field": _says('{"text": "Go straight."}'),
    "answers with two fields": _says('{"instruction": "Go.", "moving_instruction": "Go."}'),
    "answers with a list": _says('["Go straight."]'),
    "swaps left and right": _instruction(_swap),
    "invents a landmark": _instruction(lambda t: "Pass the aquarium and the grand piano. " + t),
    "names the target twice": _instruction(lambda t: t + " " + t.rsplit(" at ", 1)[-1]),
    "forgets the target": _instruction(lambda t: "Go straight."),
    "says slightly": _instruction(lambda t: t.replace(".", ", slightly.")),
    "sends control tokens": _instruction(lambda t: t + "<|im_end|>"),
    "sends markdown": _instruction(lambda t: f"**{t}**"),
    "sends line breaks": _instruction(lambda t: t + "\nAnything else?"),
    "goes on and on": _instruction(lambda t: t + " Keep going straight." * 200),
    "tells distances in feet": _instruction(lambda t: "After 12 feet, " + t),
}
