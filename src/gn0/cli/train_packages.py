"""The packages that the verbs of `gn0 train` need, asked for before anything is computed."""

from __future__ import annotations

from importlib.util import find_spec

from gn0.errors import ConfigError

NEEDED = ("torch", "transformers", "tokenizers", "safetensors")


def check_packages() -> None:
    """Refuse to train where the extra `train` is not installed.

    Raises:
        ConfigError: names what is missing.
    """
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise ConfigError(
            f"training needs packages that are not here: {', '.join(missing)}",
            remedy="pip install -e '.[train]'",
        )
