"""A client of OpenAI-compatible servers: plain HTTP, bounded in time, size, tries and budget."""

from __future__ import annotations

import contextlib
import email.utils
import http.client
import os
import re
import socket
import ssl
import threading
import time
import urllib.parse
import urllib.request
from collections import Counter
from typing import Annotated

import msgspec

from gn0.config import Config
from gn0.errors import ConfigError, LanguageError
from gn0.missions.language.exchanges import ChatRequest, ExchangeFolder
from gn0.seeds import random_stream

_RETRIED = frozenset((408, 409, 425, 429, 500, 502, 503, 504, 529))
_FINAL = frozenset((401, 403, 404))  # the next request will fare no better
_SNIPPET = 160  # characters of a server's words in our errors


class ChatSettings(Config, frozen=True):
    """How to reach a language server, and how much may be asked of it.

    Attributes:
        model: name of the model, as the server knows it.
        base_url: address up to and with "/v1"; by default $OPENAI_BASE_URL.
        api_key_env: the environment variable that holds the key; unset means no key is sent.
        timeout: for one request, from connecting to the last byte [s].
        retries: further tries after a failure that may pass.
        backoff: wait before the first retry [s]; doubled each time.
        longest_wait: no wait is longer [s]; a server that asks for more has failed.
        concurrency: requests under way at once.
        max_requests: requests that may be sent in all, retries included.
        max_tokens: tokens that may be used in all, prompts included.
        answer_tokens: tokens of one answer.
        answer_bytes: a larger reply is refused.
        temperature: temperature of sampling.
        seed: sent with each request.
        give_up_after: failed requests in a row after which the server is not asked again.
        cache: folder of prompts and answers; by default in GN0's cache; "none" for no cache.
    """

    model: str
    base_url: str = ""
    api_key_env: str = "OPENAI_API_KEY"
    timeout: Annotated[float, msgspec.Meta(gt=0, le=3600)] = 60.0
    retries: Annotated[int, msgspec.Meta(ge=0, le=20)] = 4
    backoff: Annotated[float, msgspec.Meta(ge=0, le=60)] = 0.5
    longest_wait: Annotated[float, msgspec.Meta(ge=0, le=3600)] = 60.0
    concurrency: Annotated[int, msgspec.Meta(ge=1, le=256)] = 4
    max_requests: Annotated[int, msgspec.Meta(ge=0)] = 100_000
    max_tokens: Annotated[int, msgspec.Meta(ge=0)] = 50_000_000
    answer_tokens: Annotated[int, msgspec.Meta(ge=16, le=32_768)] = 400
    answer_bytes: Annotated[int, msgspec.Meta(ge=1024, le=2**26)] = 262_144
    temperature: Annotated[float, msgspec.Meta(ge=0, le=2)] = 0.0
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**31 - 1)] = 0
    give_up_after: Annotated[int, msgspec.Meta(ge=1)] = 5
    cache: str = ""


class _Message(msgspec.Struct):
    content: str | None = None


class _Choice(msgspec.Struct):
    message: _Message


class _Usage(msgspec.Struct):
    total_tokens: int = 0


class _Completion(msgspec.Struct):
    choices: list[_Choice]
    usage: _Usage | None = None


class _Passing(Exception):  # noqa: N818 (never leaves this module)
    """A failure that may pass."""

    def __init__(self, what: str, wait: float | None = None) -> None:
        super().__init__(what)
        self.wait = wait


class ChatClient:
    """Asks one model; safe to call from several threads.

    Attributes:
        counts: requests sent, answers from the cache, retries, tokens, failures.
    """

    def __init__(self, settings: ChatSettings) -> None:
        self.settings = settings
        url = settings.base_url or os.environ.get("OPENAI_BASE_URL", "")
        self._key = os.environ.get(settings.api_key_env, "")
        self._url = _check_url(url)
        if re.search(r"[^\x21-\x7e]", self._key):
            raise ConfigError(
                "the key holds a space, line break or letter that no header may carry",
                where=f"${settings.api_key_env}",
                remedy="set the variable to the key alone",
            )
        folder = settings.cache
        if not folder:
            from gn0.storage import cache_dir

            folder = str(cache_dir() / "language")
        self._cache = None if folder == "none" else ExchangeFolder(folder)
        self._slots = threading.BoundedSemaphore(settings.concurrency)
        self._lock = threading.Lock()
        self._in_a_row = 0
        self._dead = ""
        self.counts: Counter[str] = Counter()

    @property
    def model(self) -> str:
        """The model's name."""
        return self.settings.model

    def ask(self, messages: list[dict[str, str]]) -> str:
        """The model's answer to `messages`.

        Raises:
            LanguageError: no answer within tries, time and budget, or none that is one.
            StorageError: the cache cannot be written.
        """
        s = self.settings
        request = ChatRequest(
            model=s.model,
            messages=messages,
            temperature=s.temperature,
            max_tokens=s.answer_tokens,
            seed=s.seed,
        )
        if self._cache is not None:
            kept = self._cache.get(request)
            if kept is not None:
                self._count("cached")
                return kept
        with self._slots:
            answer = self._try(request)
        if self._cache is not None:
            self._cache.put(request, answer)
        return answer

    def _count(self, name: str, by: int = 1) -> None:
        with self._lock:
            self.counts[name] += by

    def _try(self, request: ChatRequest) -> str:
        s = self.settings
        rng = random_stream(s.seed, "backoff", request.key)
        for attempt in range(s.retries + 1):
            self._spend(request)
            try:
                answer = self._send(request)
            except _Passing as failure:
                wait = s.backoff * 2**attempt * float(rng.uniform(0.75, 1.25))
                if failure.wait is not None:
                    wait = max(wait, failure.wait)
                if attempt == s.retries or wait > s.longest_wait:
                    raise self._failed(f"{failure} (tried {attempt + 1} times)") from None
                self._count("retries")
                time.sleep(wait)
            else:
                with self._lock:
                    self._in_a_row = 0
                return answer
        raise AssertionError("unreachable")

    def _failed(self, what: str, *, final: bool = False) -> LanguageError:
        with self._lock:
            self.counts["failures"] += 1
            self._in_a_row += 1
            if final or self._in_a_row >= self.settings.give_up_after:
                self._dead = what
        return LanguageError(what, where=self._url.geturl(), remedy="see whether the server is up")

    def _spend(self, request: ChatRequest) -> None:
        """Take one request from the budget.

        Raises:
            LanguageError: the budget is spent, or the server was given up.
        """
        s = self.settings
        with self._lock:
            if self._dead:
                raise LanguageError(f"the server was given up on: {self._dead}")
            # before the answer is there its tokens are guessed: four letters each
            letters = sum(len(m["content"]) for m in request.messages)
            if self.counts["requests"] >= s.max_requests:
                raise LanguageError(f"the budget of {s.max_requests:,} requests is spent")
            if self.counts["tokens"] + letters // 4 > s.max_tokens:
                raise LanguageError(f"the budget of {s.max_tokens:,} tokens is spent")
            self.counts["requests"] += 1

    def _send(self, request: ChatRequest) -> str:
        """One request and its answer.

        Raises:
            _Passing: worth another try.
            LanguageError: not worth one.
        """
        connection = self._connect()
        over = threading.Event()

        def cut() -> None:  # a server that drips bytes would else hold us for ever
            over.set()
            held = connection.sock
            if held is not None:
                with contextlib.suppress(OSError):
                    held.shutdown(socket.SHUT_RDWR)

        watch = threading.Timer(self.settings.timeout, cut)
        watch.daemon = True
        watch.start()
        try:
            status, headers, body = self._talk(connection, request)
        except (OSError, http.client.HTTPException, ValueError) as error:
            if over.is_set() or isinstance(error, TimeoutError):
                raise _Passing(f"no answer within {self.settings.timeout:g} s") from None
            if isinstance(error, ssl.SSLCertVerificationError):
                raise self._failed(f"its certificate is not trusted: {error.verify_message}",
                                   final=True) from None  # fmt: skip
            kind = type(error).__name__
            raise _Passing(f"the connection failed: {self._plain(str(error)) or kind}") from None
        finally:
            watch.cancel()
            connection.close()
        if over.is_set():
            raise _Passing(f"no answer within {self.settings.timeout:g} s")
        told = headers.get("Content-Length", "")
        if told.isdecimal() and len(body) < min(int(told), self.settings.answer_bytes):
            raise _Passing("the connection was closed before the end of the reply")
        return self._read(status, headers, body, request)

    def _connect(self) -> http.client.HTTPConnection:
        url, timeout = self._url, self.settings.timeout
        host, port = str(url.hostname), url.port
        if url.scheme == "http":
            return http.client.HTTPConnection(host, port, timeout=timeout)
        proxy = urllib.request.getproxies().get("https", "")
        if proxy and not urllib.request.proxy_bypass(host):
            through = urllib.parse.urlsplit(proxy if "//" in proxy else f"//{proxy}")
            tunnel = http.client.HTTPSConnection(
                str(through.hostname), through.port or 3128, timeout=timeout
            )
            tunnel.set_tunnel(host, port or 443)
            return tunnel
        return http.client.HTTPSConnection(host, port, timeout=timeout)

    def _talk(
        self, connection: http.client.HTTPConnection, request: ChatRequest
    ) -> tuple[int, http.client.HTTPMessage, bytes]:
        headers = {"Content-Type": "application/json", "Accept": "application/json"}
        if self._key:
            headers["Authorization"] = f"Bearer {self._key}"
        path = f"{self._url.path.rstrip('/')}/chat/completions"
        connection.request("POST", path, msgspec.json.encode(request), headers)
        response = connection.getresponse()
        limit = self.settings.answer_bytes
        body = b""
        while len(body) <= limit:
            part = response.read(min(65_536, limit + 1 - len(body)))
            if not part:
                break
            body += part
        return response.status, response.headers, body

    def _read(
        self, status: int, headers: http.client.HTTPMessage, body: bytes, request: ChatRequest
    ) -> str:
        said = self._plain(body[: 4 * _SNIPPET].decode("utf-8", "replace"))
        if status in _RETRIED:
            raise _Passing(f"the server answered {status}: {said}", _retry_after(headers))
        if status != 200:
            moved = f" to {self._plain(headers['Location'])}" if headers["Location"] else ""
            raise self._failed(
                f"the server answered {status}{moved}: {said}", final=status in _FINAL
            )
        if len(body) > self.settings.answer_bytes:
            raise self._failed(f"the reply is larger than {self.settings.answer_bytes:,} bytes")
        try:
            completion = msgspec.json.decode(body, type=_Completion)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            kind = headers.get_content_type()
            raise self._failed(f"the reply is not a chat completion but {kind}: {said}") from None
        letters = sum(len(m["content"]) for m in request.messages) + len(body)
        used = completion.usage.total_tokens if completion.usage is not None else 0
        self._count("tokens", used if used > 0 else letters // 4)
        content = completion.choices[0].message.content if completion.choices else None
        if not content or not content.strip():
            raise self._failed("the reply holds no text")
        return content

    def _plain(self, text: str) -> str:
        """A server's words, short, on one line and without our key."""
        if self._key:
            text = text.replace(self._key, "***")
        words = "".join(c if c.isprintable() else " " for c in text)
        short = " ".join(words.split())
        return short if len(short) <= _SNIPPET else short[:_SNIPPET] + "…"


def _check_url(text: str) -> urllib.parse.SplitResult:
    """The parts of a server's address.

    Raises:
        ConfigError: it is not an address.
    """
    try:
        url = urllib.parse.urlsplit(text.strip())
        good = url.scheme in ("http", "https") and bool(url.hostname) and (url.port or 1) > 0
        good = good and url.username is None and not re.search(r"[\s\x00-\x1f]", url.path)
    except ValueError:
        good = False
    if not good:
        raise ConfigError(
            f"{text!r} is not the address of a language server"
            if text
            else "no language server given",
            where="base_url",
            remedy="e.g. base_url='http://localhost:8000/v1', or set $OPENAI_BASE_URL; "
            "the key goes into $OPENAI_API_KEY",
        )
    return url


def _retry_after(headers: http.client.HTTPMessage) -> float | None:
    """Seconds that a server asks to wait, or None."""
    value = headers.get("Retry-After", "").strip()
    if re.fullmatch(r"\d{1,9}(\.\d+)?", value):
        return float(value)
    with contextlib.suppress(TypeError, ValueError):
        when = email.utils.parsedate_to_datetime(value)
        return max(0.0, when.timestamp() - time.time())
    return None
