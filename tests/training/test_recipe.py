"""What training is set by: recipes, and how steps are computed."""

from __future__ import annotations

import pytest

from gn0.errors import ConfigError
from gn0.training.recipe import Speed, parse_speed


def test_words_name_a_speed() -> None:
    assert parse_speed([]) == Speed()
    assert parse_speed(["whole", "narrow"]) == Speed(graph="whole", narrow=True)
    assert parse_speed(["joined", "beside"]) == Speed(joined=True, beside=True)
    for wrong in (["warp"], ["whole", "tuned"], ["joined", ""]):
        with pytest.raises(ConfigError, match="no such speed"):
            parse_speed(wrong)
