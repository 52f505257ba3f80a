"""The providers `openai` and `replay`: a language model in the paper's four roles."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, Protocol

import msgspec

from gn0.config import check_config
from gn0.errors import ConfigError, FormatError, LanguageError
from gn0.missions.language import prompts
from gn0.missions.language.chat import ChatClient, ChatSettings
from gn0.missions.language.exchanges import ChatRequest, load_exchanges
from gn0.missions.language.route import RouteDescription, Style
from gn0.missions.language.template import ProviderTemplate
from gn0.missions.language.text_check import check_text


class Model(Protocol):
    """Answers messages.

    Attributes:
        model: its name.
        counts: what was asked and how it went.
    """

    counts: Counter[str]

    @property
    def model(self) -> str:
        """The model's name."""
        ...

    def ask(self, messages: list[dict[str, str]]) -> str:
        """The answer.

        Raises:
            LanguageError: there is none.
        """
        ...


class _ProviderModel:
    """Writes with a model.

    Base by the role `grammar`; benchmark by `detailed` and `review`; detailed by `moving`,
    `detailed` and `review`.
    """

    name = ""

    def __init__(self, model: Model, concurrency: int) -> None:
        self._model = model
        self._grammar = ProviderTemplate()
        self.concurrency = concurrency
        self.version = f"{model.model}, prompts {prompts.VERSION}"

    @property
    def counts(self) -> Counter[str]:
        """What was asked and how it went."""
        return self._model.counts

    def write(self, route: RouteDescription, style: Style, *, seed: int, held_out: bool) -> str:
        """A text; see `gn0.missions.language.providers.TextProvider`."""
        if style == "base":
            plain = self._grammar.write(route, "base", seed=seed, held_out=held_out)
            return self._ask("grammar", route, style, text=plain)
        movement = self._ask("moving", route, style) if style == "detailed" else ""
        raw = self._ask("detailed", route, style, movement=movement)
        refined = self._ask("review", route, style, text=raw)
        # a review that spoils a good text is not taken
        if check_text(refined, route, style) and not check_text(raw, route, style):
            return raw
        return refined

    def _ask(
        self,
        role: prompts.Role,
        route: RouteDescription,
        style: Style,
        *,
        text: str = "",
        movement: str = "",
    ) -> str:
        messages = prompts.build_messages(role, route, style, text=text, movement=movement)
        answer = self._model.ask(messages)
        field = prompts.ANSWER_FIELD[role]
        try:
            found = msgspec.json.decode(answer, type=dict[str, str])
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            raise LanguageError(f"{role}: the answer is not the JSON object asked for") from None
        if list(found) != [field]:
            raise LanguageError(f"{role}: the answer has not the one field {field!r}")
        return found[field].strip()


class ProviderOpenai(_ProviderModel):
    """Any server that speaks OpenAI's chat completions; see `ChatSettings` for its options.

    Raises:
        ConfigError: an option is missing, unknown or out of range.
    """

    name = "openai"

    def __init__(self, **options: Any) -> None:
        if not options.get("model"):
            raise ConfigError("no model given", where="openai", remedy="e.g. model='Qwen/Qwen3-8B'")
        settings = check_config(ChatSettings(**options))
        super().__init__(ChatClient(settings), settings.concurrency)


class _Recorded:
    """Answers that were recorded, and no others."""

    def __init__(self, path: Path, model: str) -> None:
        self._exchanges = load_exchanges(path)
        self._path = path
        self.counts: Counter[str] = Counter()
        models = sorted({e.request.model for e in self._exchanges.values()})
        if not models:
            raise FormatError("it holds no exchange", file=path, remedy="record some first")
        if (model and model not in models) or (not model and len(models) > 1):
            raise ConfigError(
                f"recorded: {', '.join(models)}",
                where=str(path),
                remedy="give one of them as `model`",
            )
        self.model = model or models[0]
        # what was asked with which sampling is part of the key
        self._sampling = sorted(
            {
                (e.request.temperature, e.request.max_tokens, e.request.seed)
                for e in self._exchanges.values()
                if e.request.model == self.model
            }
        )

    def ask(self, messages: list[dict[str, str]]) -> str:
        for temperature, tokens, seed in self._sampling:
            request = ChatRequest(
                model=self.model,
                messages=messages,
                temperature=temperature,
                max_tokens=tokens,
                seed=seed,
            )
            found = self._exchanges.get(request.key)
            if found is not None:
                self.counts["replayed"] += 1
                return found.answer
        self.counts["failures"] += 1
        raise LanguageError("this prompt was not recorded", where=str(self._path))


class ProviderReplay(_ProviderModel):
    """Answers recorded by `openai`, without a network.

    Args:
        path: the cache folder of `openai`, or a file packed from it.
        model: which model's answers; needed where several were recorded.

    Raises:
        ConfigError: several models were recorded, or not the one asked for.
        FormatError: an exchange is damaged, or there is none.
        StorageError: nothing can be read there.
    """

    name = "replay"

    def __init__(self, path: str | Path = "", model: str = "") -> None:
        if not str(path):
            raise ConfigError("no recording given", where="replay", remedy="path='answers.jsonl'")
        super().__init__(_Recorded(Path(path), model), 1)
