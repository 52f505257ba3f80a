"""The slots of an answer as a grammar of token ids, for servers that constrain what is decoded.

A grammar of characters leaks: with `"<" [0-9]+ ">"` a server lets a model spell `<92>` in four
tokens, which no training sample holds. These are made of token ids, and admit one way to say it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from gn0.data.answer_slots import ACTION, END, FREE, AnswerSlots
from gn0.errors import ConfigError
from gn0.paper import MAP_BINS

Dialect = Literal["llguidance", "xgrammar"]


def write_grammar(
    slots: AnswerSlots, dialect: Dialect, current: Sequence[int] | None = None
) -> str:
    """A grammar that accepts exactly the answers of these slots; servers end the answer themselves.

    Args:
        slots: the slots.
        dialect: llguidance (Lark with `<[ids]>`), or xgrammar (EBNF with `Token(ids)`).
        current: map tokens (x, y) of where the agent stands, which point 0 is forced to.

    Raises:
        ConfigError: no such dialect.
    """
    if dialect not in ("llguidance", "xgrammar"):
        raise ConfigError(f"no dialect {dialect!r}", remedy="give llguidance or xgrammar")
    begin, actions = slots.vocabulary.number, sorted(slots.vocabulary.actions)
    numbers = range(begin, begin + MAP_BINS)
    parts = []
    for own, kind in zip(slots.forced(current)[0].tolist(), slots.kinds.tolist(), strict=True):
        if kind == END:
            continue
        if own == FREE:
            parts.append("action" if kind == ACTION else "number")
        else:
            parts.append(f"<[{own}]>" if dialect == "llguidance" else f"Token({own})")
    words = " ".join(parts)
    used = set(parts)
    if dialect == "llguidance":
        rules = {
            "number": f"<[{begin}-{numbers[-1]}]>",
            "action": f"<[{','.join(map(str, actions))}]>",
        }
        lines = ["%llguidance {}", f"start: {words}"]
        lines += [f"{name}: {rule}" for name, rule in rules.items() if name in used]
    else:
        rules = {
            "number": f"Token({', '.join(map(str, numbers))})",
            "action": f"Token({', '.join(map(str, actions))})",
        }
        lines = [f"root ::= {words}"]
        lines += [f"{name} ::= {rule}" for name, rule in rules.items() if name in used]
    return "\n".join(lines) + "\n"
