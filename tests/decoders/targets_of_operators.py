"""What hosts say to whoever looks at them, as it reaches a terminal or a page: `ps`, `events`, `watch`."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import msgspec
from decoder_target import Target
from rich.console import Console
from targets_of_links import WORDS, example, pack, sealed, unpack

from lfield.cli.views import event_view, picture, seen_view
from lfield.errors import WireError
from lfield.operator.ask import Answers
from lfield.operator.sight.following.cursor import Cursor
from lfield.operator.sight.picture.roll import Roll
from lfield.operator.sight.picture.team_picture import Picture
from lfield.operator.sight.timeline.timeline import Timeline
from lfield.wire import codec
from lfield.wire.events import KINDS, Event
from lfield.wire.observing import Status
from lfield.wire.watching import Events

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
    _insist_on_plain(text.getvalue())
    assert picture.as_json(answers)


def _statuses() -> Sequence[bytes]:
    plain = unpack(pack(example(Status)))
    return [pack([plain]), pack([plain, plain])]


def take_batches(data: bytes) -> None:
    """What two hosts tell in batches: into the picture, the time line, and all that is shown of them."""
    try:
        tree = unpack(data)
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return
    watching = _Watching()
    for number, said in enumerate(tree[:6] if isinstance(tree, list) else ()):
        try:
            told = codec.decode(codec.CONTROL, sealed(pack(said)))
        except WireError:
            continue
        if isinstance(told, Events):
            watching.take(f"host{number % 2}", told, 100.0 + number)
    watching.look()


class _Watching:
    """All that is made of what is heard."""

    def __init__(self) -> None:
        self._cursors = {f"host{n}": Cursor(telemetry=5.0) for n in range(2)}
        self._picture = Picture(Roll("team", tuple(self._cursors)))
        self._timeline = Timeline()
        self._table, self._log = event_view.Csv(), event_view.LogView()

    def take(self, host: str, batch: Events, now: float) -> None:
        """A batch of a host."""
        fresh = self._cursors[host].took(batch)
        pack(self._cursors[host].watch(batch.incarnation))
        self._picture.told(host, fresh, now, 1.7e9, 0.1)
        self._timeline.heard(host, fresh.incarnation, fresh.up, now, now - 0.1)
        for event in fresh.events:
            self._timeline.add(host, fresh.incarnation, event)

    def look(self) -> None:
        """Everything, as it is shown."""
        for now in (103.0, 110.0):
            self._picture.tick(now)
            text = io.StringIO()
            console = Console(file=text, width=120, markup=False, highlight=False, emoji=False)
            console.print(seen_view.table(self._picture.seen(now)))
            _insist_on_plain(text.getvalue())
        assert self._picture.curves(110.0) is not None
        for told in self._timeline.given():
            lines = (event_view.as_line(told), event_view.as_json(told))
            for line in (*lines, *self._table.rows(told), *self._log.lines(told)):
                _insist_on_plain(line)


def _insist_on_plain(text: str) -> None:
    assert not any(sign in text for sign in ("\x1b", "\x9b", "\x07", "\u202e", "\r"))


def _batches() -> Sequence[bytes]:
    """Batches with one event of each kind, with a snapshot and without."""
    found = []
    for number, kind in enumerate(KINDS.values(), 1):
        event = Event(number, 1.7e9, 5.0, 0, example(kind))
        batch = Events(7, 1, 1.7e9, 5.0, number - 1, number, [event])
        found.append(unpack(pack(batch)))
    first = unpack(pack(Events(7, 1, 1.7e9, 5.0, 0, 0, [], {"state": 2}, example(Status))))
    hop = found[[kind.__name__ for kind in KINDS.values()].index("Left")]
    return [pack([first, each, hop, first]) for each in found]


TARGETS = (
    Target("ps", _statuses, take_statuses, True, (*WORDS, *_ESCAPES)),
    Target("events", _batches, take_batches, True, (*WORDS, *_ESCAPES)),
)
