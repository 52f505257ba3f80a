"""The tokenizer of a policy in training cuts each text once, and as any other does."""

from __future__ import annotations

import pytest

pytest.importorskip("torch")

from gn0.policies.bae.tokenizer import train_tokenizer
from gn0.policies.bae.tokenizer_file import TokenizerFile
from gn0.training.words_kept import WordsKept, keep_words

TEXTS = ["go to the door", "go to the sofa", "", "turn left at the door and stop", "go to the door"]


class _Counted:
    """A tokenizer that counts what it is asked."""

    def __init__(self, inner) -> None:
        self.inner, self.asked = inner, 0

    def encode(self, text: str, **options):
        self.asked += 1
        return self.inner.encode(text, **options)

    def __getattr__(self, name: str):
        return getattr(self.inner, name)


def test_ids_are_those_of_the_tokenizer_and_found_once() -> None:
    inner = train_tokenizer(TEXTS, 20).backend_tokenizer
    counted, plain = _Counted(inner), TokenizerFile(inner)
    words = WordsKept(counted)
    for _ in range(2):
        assert [words.encode(text) for text in TEXTS] == [plain.encode(text) for text in TEXTS]
    assert counted.asked == 4
    words.encode(TEXTS[0]).append(0)  # whoever changes a list changes his own
    assert words.encode(TEXTS[0]) == plain.encode(TEXTS[0])


def test_few_texts_are_kept_and_new_tokens_forget_them() -> None:
    inner = train_tokenizer(TEXTS, 20).backend_tokenizer
    counted = _Counted(inner)
    words = WordsKept(counted, most=2)
    for text in ("a", "b", "c", "b", "a"):
        words.encode(text)
    assert counted.asked == 4
    before = words.encode("go <sofa>")
    words.add_tokens(["<sofa>"])
    assert words.encode("go <sofa>") == TokenizerFile(inner).encode("go <sofa>") != before


def test_all_who_ask_for_a_tokenizer_share_what_it_keeps() -> None:
    one, other = train_tokenizer(TEXTS, 20), train_tokenizer(TEXTS, 30)
    assert keep_words(one) is keep_words(one)
    assert keep_words(one) is not keep_words(other)
