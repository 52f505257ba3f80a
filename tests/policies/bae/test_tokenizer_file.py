"""The real `tokenizers` package, where it is installed, keeps what the toy of the tests keeps."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.data.answer_form import POINTS_OF, AnswerForm
from gn0.data.answer_grammar import write_grammar
from gn0.data.answer_slots import AnswerSlots, compile_slots
from gn0.data.codec import NAVIGATION_TOKENS, ORDERS, Answer, without_control_tokens
from gn0.data.navigation_vocabulary import NavigationVocabulary, add_navigation_tokens
from gn0.errors import FormatError, StorageError
from gn0.policies.bae.prompt_fields import PromptState, render_prompt
from gn0.policies.bae.prompt_template import load_prompt
from gn0.policies.bae.tokenizer_file import TokenizerFile, load_tokenizer

SPECIAL = ["<|endoftext|>", "<|im_start|>", "<|im_end|>", "<|image_pad|>"]
FORMS = [
    AnswerForm(points=points, order=order, layout=layout)  # type: ignore[arg-type]
    for points in POINTS_OF.values()
    for order in ORDERS
    for layout in ("json", "compact")
]


def train() -> Any:
    """A byte-level BPE as Qwen's, trained on the prompts themselves."""
    library = pytest.importorskip("tokenizers")
    from tokenizers import decoders, models, normalizers, pre_tokenizers, trainers

    tokenizer = library.Tokenizer(models.BPE())
    tokenizer.normalizer = normalizers.NFC()
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    trainer = trainers.BpeTrainer(
        vocab_size=600,
        initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
        special_tokens=SPECIAL,
        show_progress=False,
    )
    state = PromptState("Go past the table and stop at the sofa.")
    texts = [render_prompt(load_prompt("paper_planning_views"), state).text] * 3
    texts += [AnswerForm().write(Answer((1,) * 6, ((1, 2),) * 13))] * 3
    tokenizer.train_from_iterator(texts, trainer)
    return tokenizer


@pytest.fixture(scope="module")
def real() -> tuple[TokenizerFile, NavigationVocabulary]:
    tokenizer = TokenizerFile(train())
    return tokenizer, add_navigation_tokens(tokenizer)


def test_answers_are_the_ids_that_the_tokenizer_gives(
    real: tuple[TokenizerFile, NavigationVocabulary],
) -> None:
    tokenizer, vocabulary = real
    assert vocabulary.size == vocabulary.first + len(NAVIGATION_TOKENS) == len(tokenizer)
    rng = np.random.default_rng(0)
    for form in FORMS:
        slots = compile_slots(form, vocabulary, tokenizer)
        actions, way = rng.integers(0, 4, (20, 6)), rng.integers(0, 1000, (20, 13, 2))
        for row, codes, points in zip(
            slots.encode(actions, way).tolist(), actions, way[:, : form.points], strict=True
        ):
            tokens = tuple((int(x), int(y)) for x, y in points) or None
            text = form.write(Answer(tuple(codes.tolist()), tokens))
            assert row == [*tokenizer.encode(text), vocabulary.end]
            assert tokenizer.decode(row) == text  # the end is special


@settings(max_examples=100)
@given(
    text=st.text(max_size=80)
    | st.lists(st.sampled_from([*NAVIGATION_TOKENS[::97], *SPECIAL, "<", "|", "go"])).map("".join)
)
def test_no_text_of_a_user_gives_one_of_the_tokens(
    real: tuple[TokenizerFile, NavigationVocabulary], text: str
) -> None:
    tokenizer, vocabulary = real
    ids = tokenizer.encode(without_control_tokens(text))
    special = {tokenizer.find_id(token) for token in SPECIAL}
    assert all(own < vocabulary.first and own not in special for own in ids)


def test_special_tokens_are_refused_since_decoding_drops_them() -> None:
    tokenizer = TokenizerFile(train())
    tokenizer.tokenizer.add_special_tokens(list(NAVIGATION_TOKENS))
    with pytest.raises(FormatError, match="special=False"):
        add_navigation_tokens(tokenizer)


def test_a_tokenizer_is_read_from_its_file(
    real: tuple[TokenizerFile, NavigationVocabulary], tmp_path: Path
) -> None:
    tokenizer, vocabulary = real
    tokenizer.tokenizer.save(str(tmp_path / "tokenizer.json"))
    assert add_navigation_tokens(load_tokenizer(tmp_path)) == vocabulary
    (tmp_path / "tokenizer.json").write_text('{"model": 3}')
    with pytest.raises(FormatError, match="not a tokenizer"):
        load_tokenizer(tmp_path)
    with pytest.raises(StorageError):
        load_tokenizer(tmp_path / "none.json")


def test_without_the_package_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
    real: tuple[TokenizerFile, NavigationVocabulary],
    tmp_path: Path,
) -> None:
    real[0].tokenizer.save(str(tmp_path / "tokenizer.json"))
    monkeypatch.setitem(sys.modules, "tokenizers", None)
    with pytest.raises(FormatError) as caught:
        load_tokenizer(tmp_path)
    assert "pip install tokenizers" in caught.value.remedy


def test_a_server_s_grammar_accepts_the_answers_and_nothing_else(
    real: tuple[TokenizerFile, NavigationVocabulary],
) -> None:
    """With llguidance, where it is installed: every answer, and no other token on the way."""
    library = pytest.importorskip("llguidance")
    tokenizer, vocabulary = real
    table = library.LLTokenizer(tokenizer.tokenizer.to_str(), eos_token=vocabulary.end)
    rng = np.random.default_rng(1)
    for form in FORMS:
        slots: AnswerSlots = compile_slots(form, vocabulary, tokenizer)
        current = (3, 4) if form.points else None
        way = rng.integers(0, 1000, (1, 13, 2))
        way[0, 0] = 3, 4
        ids = slots.encode(rng.integers(0, 4, (1, 6)), way)[0].tolist()
        judge = library.LLMatcher(table, write_grammar(slots, "llguidance", current))
        assert not judge.get_error()
        decoder = slots.decoder(current)
        for own in ids[:-1]:
            bits = np.frombuffer(judge.compute_bitmask(), np.uint8)
            allowed = np.flatnonzero(np.unpackbits(bits, bitorder="little"))
            assert allowed.tolist() == decoder.allowed().tolist()
            assert judge.consume_token(own)
            decoder.accept(own)
        assert judge.is_accepting()
