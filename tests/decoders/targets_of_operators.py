"""What hosts say to whoever looks at them, as it reaches a terminal: `lfield ps`."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import msgspec
from decoder_target import Target
from rich.console import Console
from targets_of_links import WORDS, example, pack, sealed, unpack

from lfield.cli.views import picture
from lfield.errors import WireError
from lfield.operator.ask import Answers
from lfield.wire import codec
from lfield.wire.observing import Status

#: What a terminal would obey.
_ESCAPES = ("\x1b[2J", "\x9b31m", "\u202e", "\r", "\x07", "[red]", "😀" * 50)


def take_statuses(data: bytes) -> None:
    """What two hosts say that they run, as `lfield ps` shows it: nothing in it is for the terminal."""
    try:
        tree = unpack(data)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return
    answers: dict[str, Any] = {}
    for number, said in enumerate(tree[:3] if isinstance(tree, list) else ()):
        try:
            told = codec.decode(codec.CONTROL, sealed(pack(said)))
        except WireError as error:
            answers[f"host{number}"] = error
            continue
        if isinstance(told, Status):
            answers[f"host{number}"] = told
    _shown(answers)


def _shown(answers: Answers[Status]) -> None:
    text = io.StringIO()
    Console(file=text, width=120, markup=False, highlight=False, emoji=False).print(picture.picture(answers))
    assert not any(sign in text.getvalue() for sign in ("\x1b", "\x9b", "\x07", "\u202e", "\r"))
    assert picture.as_json(answers)


def _statuses() -> Sequence[bytes]:
    plain = unpack(pack(example(Status)))
    return [pack([plain]), pack([plain, plain])]


TARGETS = (Target("ps", _statuses, take_statuses, True, (*WORDS, *_ESCAPES)),)
