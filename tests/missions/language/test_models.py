"""Language models: asked over real HTTP, bounded, cached, recorded, replayed, and never trusted."""

from __future__ import annotations

import json
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from gn0.errors import ConfigError, FormatError, LanguageError, StorageError
from gn0.missions.language import prompts
from gn0.missions.language.chat import ChatClient, ChatSettings
from gn0.missions.language.exchanges import load_exchanges, pack_exchanges
from gn0.missions.language.providers import TextProvider, open_provider
from gn0.missions.language.route import STYLES
from gn0.missions.language.text_check import check_text
from gn0.missions.language.write import fallback_kind, write_texts, write_texts_many
from gn0_trials.rogue_language import (
    PASSING,
    ROGUES,
    LanguageRequest,
    answer_well,
    serve_language,
)
from gn0_trials.routes import build_random_route, build_simple_route

ROUTE = build_simple_route("left", "right")
QUICK: dict[str, Any] = {
    "model": "m", "timeout": 0.25, "retries": 2, "backoff": 0.01, "longest_wait": 0.2,
    "cache": "none",
}  # fmt: skip


def ask(url: str, **options: Any) -> TextProvider:
    return open_provider("openai", base_url=url, **{**QUICK, **options})


@pytest.fixture(autouse=True)
def no_key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    monkeypatch.delenv("OPENAI_BASE_URL", raising=False)


def test_a_good_server_writes_all_three_styles_in_the_papers_roles() -> None:
    with serve_language() as (url, seen):
        texts = write_texts(ROUTE, ask(url), seed=1)
    assert {t.provider for t in texts.values()} == {"openai"}
    assert {t.version for t in texts.values()} == {f"m, prompts {prompts.VERSION}"}
    assert not any(t.fallback for t in texts.values())
    for style, text in texts.items():
        assert check_text(text.text, ROUTE, style) == []
    # base: grammar; detailed: moving, detailed, review; benchmark: detailed, review
    marks = ("editor", "instructor", "guiding", "editing")
    asked = [next(m for m in marks if m in r["messages"][0]["content"]) for r in seen]
    assert asked == ["editor", "instructor", "guiding", "editing", "guiding", "editing"]
    assert all(request["_path"] == "/v1/chat/completions" for request in seen)
    assert all(request["temperature"] == 0 for request in seen)


def test_prompts_say_the_rules() -> None:
    told = prompts.build_messages("detailed", ROUTE, "benchmark")
    words = told[0]["content"]
    for rule in ("at most one landmark", "slightly", "One or two sentences", "No distances",
                 "only once, at the end"):  # fmt: skip
        assert rule in words
    assert "turn left; landmarks: the oven (beside the turn)" in told[1]["content"]
    review = prompts.build_messages("review", ROUTE, "benchmark", text="Go.")
    assert "at most 6 distinct landmarks" in review[0]["content"]
    assert "Available landmarks: the sofa, the oven" in review[1]["content"]
    moving = prompts.build_messages("moving", ROUTE, "detailed")
    assert "1. straight, 3 meters\n2. turn left" in moving[1]["content"]


@pytest.mark.parametrize("kind", PASSING)
def test_what_passes_is_tried_again(kind: str) -> None:
    with serve_language(PASSING[kind]) as (url, seen):
        provider = ask(url)
        texts = write_texts(ROUTE, provider, styles=("base",))
    assert texts["base"].provider == "openai", texts
    assert len(seen) > 1


@pytest.mark.parametrize("kind", ROGUES)
def test_what_misbehaves_is_counted_and_the_grammar_writes(kind: str) -> None:
    begin = time.monotonic()
    with serve_language(ROGUES[kind]) as (url, seen):
        texts = write_texts(ROUTE, ask(url), styles=("benchmark",))
    text = texts["benchmark"]
    assert text.provider == "template"
    assert text.fallback.startswith("openai: ")
    assert fallback_kind(text.fallback)
    assert text.fallback.isprintable() and len(text.fallback) < 400
    assert check_text(text.text, ROUTE, "benchmark") == []
    assert 1 <= len(seen) <= 6
    assert time.monotonic() - begin < 20  # no rogue can hold us


def test_reasons_are_told_apart() -> None:
    kinds = {
        "swaps left and right": "turns", "invents a landmark": "landmark",
        "names the target twice": "target", "says slightly": "form", "hangs": "timeout",
        "429 for ever": "busy", "sends HTML": "server", "answers in prose": "answer",
    }  # fmt: skip
    for rogue, kind in kinds.items():
        with serve_language(ROGUES[rogue]) as (url, _):
            text = write_texts(ROUTE, ask(url, retries=0), styles=("benchmark",))["benchmark"]
        assert fallback_kind(text.fallback) == kind, text.fallback
    assert fallback_kind("") == ""


def test_a_day_is_not_waited_for() -> None:
    with serve_language(ROGUES["asks to wait a day"]) as (url, seen):
        client = ChatClient(ChatSettings(base_url=url, **QUICK))
        with pytest.raises(LanguageError, match="429"):
            client.ask([])
        assert len(seen) == 1


def test_a_server_that_keeps_failing_is_given_up() -> None:
    routes = [build_random_route(seed) for seed in range(12)]
    with serve_language(ROGUES["500 for ever"]) as (url, seen):
        provider = ask(url, retries=1, give_up_after=3, concurrency=1)
        texts = write_texts_many(routes, provider, styles=("base",))
    assert len(seen) == 6
    assert sum("given up" in t["base"].fallback for t in texts) == 9


def test_a_refused_key_is_not_tried_twice_and_never_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-secret")

    def reply(request: LanguageRequest) -> None:
        request.send(f"bad key {request.asked['_headers']['Authorization']}", 401)

    with serve_language(reply) as (url, seen):
        texts = write_texts(ROUTE, ask(url), seed=0)
    assert len(seen) == 1
    assert seen[0]["_headers"]["Authorization"] == "Bearer sk-secret"
    assert not any("sk-secret" in t.fallback for t in texts.values())
    assert "Bearer ***" in texts["base"].fallback


def test_a_key_that_no_header_can_carry_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-a\r\nX-Evil: 1")
    with pytest.raises(ConfigError, match="OPENAI_API_KEY"):
        ask("http://127.0.0.1:9/v1")


def test_answers_are_cached_by_content(tmp_path: Path) -> None:
    with serve_language() as (url, seen):
        first = write_texts(ROUTE, ask(url, cache=str(tmp_path)), seed=1)
        asked = len(seen)
        provider = ask(url, cache=str(tmp_path))
        again = write_texts(ROUTE, provider, seed=1)
        assert len(seen) == asked
        write_texts(ROUTE, ask(url, cache=str(tmp_path), model="other"), styles=("base",), seed=1)
        assert len(seen) == asked + 1
    assert again == first
    assert provider.counts["cached"] == asked  # type: ignore[attr-defined]


def test_a_damaged_cache_is_asked_for_again(tmp_path: Path) -> None:
    with serve_language() as (url, seen):
        write_texts(ROUTE, ask(url, cache=str(tmp_path)), styles=("base",))
        (file,) = tmp_path.rglob("*.json")
        file.write_bytes(file.read_bytes()[:-20])
        write_texts(ROUTE, ask(url, cache=str(tmp_path)), styles=("base",))
        assert len(seen) == 2
    assert len(load_exchanges(tmp_path)) == 1


def test_recorded_answers_are_replayed_without_a_server(tmp_path: Path) -> None:
    routes = [build_simple_route("left"), build_simple_route("right", "left")]
    with serve_language() as (url, _):
        live = write_texts_many(routes, ask(url, cache=str(tmp_path / "a")), seed=4)
    assert pack_exchanges(tmp_path / "a", tmp_path / "answers.jsonl") == 12
    for source in (tmp_path / "a", tmp_path / "answers.jsonl"):
        replayed = write_texts_many(routes, open_provider("replay", path=source), seed=4)
        for mine, theirs in zip(replayed, live, strict=True):
            assert {s: t.text for s, t in mine.items()} == {s: t.text for s, t in theirs.items()}
            assert {t.provider for t in mine.values()} == {"replay"}
    # the same exchanges are the same bytes, whatever the order in which they were recorded
    with serve_language() as (url, _):
        write_texts_many(routes[::-1], ask(url, cache=str(tmp_path / "b")), seed=4)
    pack_exchanges(tmp_path / "b", tmp_path / "again.jsonl")
    assert (tmp_path / "again.jsonl").read_bytes() == (tmp_path / "answers.jsonl").read_bytes()


def test_what_was_not_recorded_falls_back(tmp_path: Path) -> None:
    with serve_language() as (url, _):
        write_texts(ROUTE, ask(url, cache=str(tmp_path)), styles=("base",), seed=1)
    texts = write_texts(build_simple_route("left"), open_provider("replay", path=tmp_path), seed=1)
    assert {fallback_kind(t.fallback) for t in texts.values()} <= {"not recorded", ""}
    assert texts["benchmark"].fallback


def test_recordings_that_cannot_be_used_say_why(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no recording"):
        open_provider("replay")
    with pytest.raises(StorageError):
        open_provider("replay", path=tmp_path / "absent.jsonl")
    with pytest.raises(FormatError, match="no exchange"):
        open_provider("replay", path=tmp_path)
    with serve_language() as (url, _):
        write_texts(ROUTE, ask(url, cache=str(tmp_path / "a")), styles=("base",))
        write_texts(ROUTE, ask(url, cache=str(tmp_path / "a"), model="n"), styles=("base",))
    file = tmp_path / "answers.jsonl"
    pack_exchanges(tmp_path / "a", file)
    with pytest.raises(ConfigError, match="m, n"):
        open_provider("replay", path=file)
    assert open_provider("replay", path=file, model="n").version.startswith("n, ")
    lines = file.read_text().splitlines()
    file.write_text(lines[0] + "\n" + lines[1].replace('"content":"', '"content":"x', 1) + "\n")
    with pytest.raises(FormatError, match=r"line 2.*key"):
        open_provider("replay", path=file)
    file.write_text("not json\n")
    with pytest.raises(FormatError, match="line 1"):
        open_provider("replay", path=file)


def test_the_budget_is_kept() -> None:
    with serve_language() as (url, seen):
        texts = write_texts(ROUTE, ask(url, max_requests=2))
        assert len(seen) == 2
        assert Counter(fallback_kind(t.fallback) for t in texts.values())["budget"] == 2
        provider = ask(url, max_tokens=450)  # a request uses 100, the guess before it is larger
        write_texts(ROUTE, provider)
        assert provider.counts["tokens"] <= 450  # type: ignore[attr-defined]


def test_no_more_requests_at_once_than_allowed() -> None:
    lock, now, most = threading.Lock(), [0], [0]

    def reply(request: LanguageRequest) -> None:
        with lock:
            now[0] += 1
            most[0] = max(most[0], now[0])
        time.sleep(0.02)
        with lock:
            now[0] -= 1
        answer_well(request)

    routes = [build_random_route(seed) for seed in range(8)]
    with serve_language(reply) as (url, _):
        provider = ask(url, concurrency=3, timeout=5.0)
        texts = write_texts_many(routes, provider, styles=("base",))
    assert 1 < most[0] <= 3
    alone = [write_texts(r, open_provider("template"), styles=("base",)) for r in routes]
    # the server gives base texts back unchanged: the order is that of the routes
    assert [t["base"].text for t in texts] == [t["base"].text for t in alone]


def test_a_review_that_spoils_a_good_text_is_not_taken() -> None:
    def reply(request: LanguageRequest) -> None:
        if "editing" in request.asked["messages"][0]["content"]:
            request.complete(json.dumps({"instruction": "Go to the aquarium."}))
        else:
            answer_well(request)

    with serve_language(reply) as (url, _):
        text = write_texts(ROUTE, ask(url), styles=("benchmark",))["benchmark"]
    assert text.provider == "openai" and not text.fallback


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"model": ""}, "no model"),
        ({"model": "m"}, "no language server"),
        ({"model": "m", "base_url": "localhost:8000"}, "not the address"),
        ({"model": "m", "base_url": "ftp://x/v1"}, "not the address"),
        ({"model": "m", "base_url": "http://u:p@x/v1"}, "not the address"),
        ({"model": "m", "base_url": "http://x/v1", "retries": -1}, "retries"),
        ({"model": "m", "base_url": "http://x/v1", "timeout": 0}, "timeout"),
        ({"model": "m", "base_url": "http://x/v1", "speed": 1}, "speed"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, Any], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        open_provider("openai", **options)


def test_unknown_providers_are_refused() -> None:
    with pytest.raises(ConfigError, match="known: template, openai, replay"):
        open_provider("parrot")
    with pytest.raises(ConfigError, match="template"):
        open_provider("template", colour="red")


def test_every_text_says_who_wrote_it() -> None:
    texts = write_texts(ROUTE, open_provider("template"), seed=0)
    assert tuple(texts) == STYLES
    assert {(t.provider, t.version, t.fallback) for t in texts.values()} == {("template", "1", "")}
