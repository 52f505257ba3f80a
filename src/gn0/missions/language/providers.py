"""Who writes instructions: the protocol, and the factory that opens a writer by name."""

from __future__ import annotations

from typing import Any, Protocol

from gn0.errors import ConfigError
from gn0.missions.language.route import RouteDescription, Style

PROVIDERS = ("template", "openai", "replay")


class TextProvider(Protocol):
    """Puts a route into words.

    Attributes:
        name: e.g. "template"; stored with every text.
        version: of what it writes with; stored with every text.
        concurrency: how many calls of `write` may run at once, in threads.
    """

    name: str
    version: str
    concurrency: int

    def write(self, route: RouteDescription, style: Style, *, seed: int, held_out: bool) -> str:
        """A text of one style.

        Raises:
            LanguageError: no text could be had; says why.
        """
        ...


def open_provider(name: str, **options: Any) -> TextProvider:
    """A provider by name.

    Args:
        name: "template"; "openai" (options: `gn0.missions.language.chat.ChatSettings`); or
            "replay" (`path` of recorded answers, and `model` where several were recorded).
        options: options of that provider.

    Raises:
        ConfigError: no such provider, an option it does not know, or one out of range.
        FormatError: a recording is damaged.
        StorageError: a recording cannot be read.
    """
    from gn0.missions.language.models import ProviderOpenai, ProviderReplay
    from gn0.missions.language.template import ProviderTemplate

    kinds: dict[str, Any] = {
        "template": ProviderTemplate,
        "openai": ProviderOpenai,
        "replay": ProviderReplay,
    }
    if name not in kinds:
        raise ConfigError(f"no language provider {name!r}", remedy="known: " + ", ".join(PROVIDERS))
    try:
        provider: TextProvider = kinds[name](**options)
    except TypeError as error:
        text = str(error).replace("()", "").replace(".__init__", "")
        raise ConfigError(f"provider {name!r}: {text}", remedy="see docs/instructions.md") from None
    return provider
