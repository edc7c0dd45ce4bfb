"""Mutated inputs: changed bytes and bits, and changed values in the tree of a msgpack message.

All choices come from the random generator, so that a seed reproduces an input.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from typing import Any

import msgspec
from decoder_target import LONGEST, Target

#: Numbers at common limits, and values of every type.
EDGES = (0, 1, -1, 2, 127, 128, 255, 256, 65535, 65536, *(2**n - d for n in (31, 32, 53, 63) for d in (0, 1)))
ODD: Sequence[Any] = (
    *EDGES,
    *(2**64 - 1, -(2**31), -(2**63), 0.5, -0.0, 1e9, 1e308, -1e308, 5e-324, math.nan, math.inf, -math.inf),
    *(None, True, False, "", "a", "\0", "\n", "é" * 40, "\u202e", "\U0010ffff", "x" * 300, "x" * 3000),
    *(b"", b"\0" * 32, b"\xff" * 40, [], {}, [[]], {"": 0}, [0] * 70, {1: 2}, msgspec.msgpack.Ext(1, b"x")),
)
#: Depth of a nested list.
_DEEP = 200


def mutated(target: Target, data: bytes, rng: random.Random, other: bytes = b"") -> bytes:
    """An input similar to `data`; parts of `other` may be inserted."""
    for _ in range(1 + int(rng.expovariate(0.7))):
        if target.packed and rng.random() < 0.8:
            data = _mutated_tree(target, data, other, rng)
        else:
            data = _mutated_bytes(target, data, other, rng)
    return data[:LONGEST]


def _mutated_tree(target: Target, data: bytes, other: bytes, rng: random.Random) -> bytes:
    try:
        tree = msgspec.msgpack.decode(data)
    except (msgspec.MsgspecError, ValueError, RecursionError, TypeError):
        return _mutated_bytes(target, data, other, rng)
    places = list(_places(tree))
    if not places:
        return msgspec.msgpack.encode(_value(target, [], rng))
    holder, key = rng.choice(places)
    what = rng.randrange(8)
    if what <= 3:
        holder[key] = _value(target, places, rng)
    elif what == 4:
        del holder[key]
    elif isinstance(holder, list) and what == 5:
        holder.insert(key, _value(target, places, rng))
    elif isinstance(holder, list) and what == 6:
        holder[key:key] = holder[key : key + rng.randint(1, 4)] * rng.choice((1, 2, 20))
    else:
        holder[key] = _tweaked(holder[key], rng)
    try:
        return msgspec.msgpack.encode(tree)
    except (msgspec.MsgspecError, OverflowError, RecursionError, TypeError, ValueError):
        return data


def _places(tree: Any, depth: int = 0) -> list[tuple[Any, Any]]:
    """All containers with their keys, to a limited depth."""
    if depth > 20 or not isinstance(tree, list | dict):
        return []
    found = [(tree, key) for key in (range(len(tree)) if isinstance(tree, list) else tree)]
    return found + [place for holder, key in found for place in _places(holder[key], depth + 1)]


def _value(target: Target, places: Sequence[tuple[Any, Any]], rng: random.Random) -> Any:
    what = rng.random()
    if what < 0.4 and places:
        holder, key = rng.choice(places)
        return holder[key]
    if what < 0.6 and target.tokens:
        return rng.choice(target.tokens)
    if what < 0.62:
        deep: Any = 0
        for _ in range(_DEEP):
            deep = [deep]
        return deep
    return rng.choice(ODD)


def _tweaked(value: Any, rng: random.Random) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice((value + 1, value - 1, value ^ 1 << rng.randrange(40), -value, value * 2))
    if isinstance(value, float):
        return rng.choice((-value, value * 1e3, value / 1e3, math.nextafter(value, math.inf)))
    if isinstance(value, bytes) and value:
        return _mutated_bytes(None, value, b"", rng)
    if isinstance(value, str):
        return rng.choice((value[:-1], value + value, value.upper(), value + "\n", value[1:]))
    return rng.choice(ODD)


def _mutated_bytes(target: Target | None, data: bytes, other: bytes, rng: random.Random) -> bytes:
    text, at = bytearray(data), rng.randint(0, len(data))
    what = rng.randrange(9)
    if what == 0 and text:
        text[rng.randrange(len(text))] ^= 1 << rng.randrange(8)
    elif what == 1 and text:
        text[rng.randrange(len(text))] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    elif what == 2:
        del text[at : at + rng.choice((1, 2, 4, 8, 64))]
    elif what == 3:
        text[at:at] = rng.randbytes(rng.choice((1, 2, 4, 8, 64)))
    elif what == 4:
        size, order = rng.choice((1, 2, 4, 8)), rng.choice(("big", "little"))
        text[at : at + size] = (rng.choice(EDGES) & (1 << 8 * size) - 1).to_bytes(size, order)
    elif what == 5 and other:
        start = rng.randrange(len(other))
        text[at : at + rng.choice((0, 4, 64))] = other[start : start + rng.choice((1, 4, 16, 64, 256))]
    elif what == 6 and text:
        start = rng.randrange(len(text))
        text[at:at] = text[start : start + rng.choice((1, 4, 16, 64))] * rng.choice((1, 2, 30))
    elif what == 7 and target is not None and target.tokens:
        word = rng.choice(target.tokens)
        text[at:at] = word if isinstance(word, bytes) else str(word).encode()
    else:
        del text[at:]
    return bytes(text)
