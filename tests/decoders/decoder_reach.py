"""What a target reaches of the functions that it is there for: which of their lines no input has run.

Only calls are watched, and lines in those functions alone: it takes little more time than the inputs do.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator, Sequence
from inspect import isclass, ismodule
from linecache import getline
from types import CodeType, FrameType
from typing import Any

from decoder_corpus import corpus_of
from decoder_mutations import mutated
from decoder_target import Target

#: Inputs that are made of the seeds of each.
INPUTS = 200


def codes_of(thing: Any) -> Iterator[CodeType]:
    """The code of a function and of all functions in it, or of those of a class or module."""
    if ismodule(thing):
        own = [inner for inner in vars(thing).values() if getattr(inner, "__module__", "") == thing.__name__]
        for inner in own:
            yield from codes_of(inner)
        return
    if isclass(thing):
        for inner in vars(thing).values():
            if not isclass(inner):
                yield from codes_of(inner)
        return
    for held in ("fget", "func", "__func__", "__wrapped__", "__code__"):
        thing = getattr(thing, held, thing)
    if isinstance(thing, CodeType):
        yield thing
        for constant in thing.co_consts:
            yield from codes_of(constant)


def unreached(target: Target, functions: Sequence[object]) -> set[str]:
    """The lines of these functions that no seed, no input kept, and none made of those has run, as texts."""
    codes = {code for thing in functions for code in codes_of(thing)}
    ran: set[tuple[CodeType, int]] = set()

    def line(frame: FrameType, event: str, argument: object) -> Any:
        ran.add((frame.f_code, frame.f_lineno))
        return line

    def call(frame: FrameType, event: str, argument: object) -> Any:
        return line if frame.f_code in codes else None

    known, dice = [*target.good, *corpus_of(target.name)], random.Random(target.name)
    made = (
        mutated(target, dice.choice(known), dice, dice.choice(known)) for _ in range(INPUTS // target.share)
    )
    before = sys.gettrace()
    sys.settrace(call)
    try:
        for data in (*known, *made):
            target.take(data)
    finally:
        sys.settrace(before)
    return {_text(code, number) for code in codes for number in _lines(code) if (code, number) not in ran}


def _lines(code: CodeType) -> set[int]:
    lines = {number for _, _, number in code.co_lines() if number}
    return lines - {code.co_firstlineno} if code.co_name != "<lambda>" else set()


def _text(code: CodeType, number: int) -> str:
    return f"{code.co_qualname}: {getline(code.co_filename, number).strip()}"
