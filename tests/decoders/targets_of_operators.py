"""What hosts say to whoever looks at them, as it reaches a terminal or a page: `ps`, `events`, `watch`."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
from decoder_target import Target
from rich.console import Console
from targets_of_links import TOKENS, example, pack, sealed, unpack

from lfield.cli.views import event_view, team_state_view, team_status_view
from lfield.errors import WireError
from lfield.operator.dashboard.event_stream.stream_cursor import StreamCursor
from lfield.operator.dashboard.timeline.event_timeline import EventTimeline
from lfield.operator.team_model.host_model import host_states
from lfield.operator.team_model.team_contents import TeamContents
from lfield.operator.team_model.team_state import HostState
from lfield.operator.team_model.team_view import TeamView
from lfield.wire import codec
from lfield.wire.events import KINDS, Event
from lfield.wire.observer_messages import Status
from lfield.wire.subscription_messages import EventBatch

#: What a terminal would obey.
_ESCAPES = ("\x1b[2J", "\x9b31m", "\u202e", "\r", "\x07", "[red]", "😀" * 50)


def decode_statuses(data: bytes) -> None:
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
        if isinstance(told, EventBatch):
            answers[f"host{number}"] = told
    _shown(host_states(answers))


def _shown(hosts: Mapping[str, HostState]) -> None:
    text = io.StringIO()
    Console(file=text, width=120, markup=False, highlight=False, emoji=False).print(
        team_status_view.team_tables(hosts)
    )
    _require_plain(text.getvalue())
    assert team_status_view.as_json(hosts)


def _statuses() -> Sequence[bytes]:
    plain = unpack(pack(EventBatch(7, 1, 1.7e9, 5.0, 0, 0, [], {}, example(Status))))
    return [pack([plain]), pack([plain, plain])]


def decode_batches(data: bytes) -> None:
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
        if isinstance(told, EventBatch):
            watching.decode(f"host{number % 2}", told, 100.0 + number)
    watching.poll()


class _Watching:
    """All that is made of what is heard."""

    def __init__(self) -> None:
        self._cursors = {f"host{n}": StreamCursor(telemetry=5.0) for n in range(2)}
        self._picture = TeamView(TeamContents("team", tuple(self._cursors)))
        self._timeline = EventTimeline()
        self._table, self._log = event_view.EventCsv(), event_view.LogLineView()

    def decode(self, host: str, batch: EventBatch, now: float) -> None:
        """A batch of a host."""
        fresh = self._cursors[host].accept(batch)
        pack(self._cursors[host].watch_request(batch.incarnation))
        self._picture.feed(host, fresh, now, 1.7e9, 0.1)
        for event in fresh.events:
            self._timeline.add(host, fresh.incarnation, event, now)

    def poll(self) -> None:
        """Everything, as it is shown."""
        for now in (103.0, 110.0):
            self._picture.tick(now)
            text = io.StringIO()
            console = Console(file=text, width=120, markup=False, highlight=False, emoji=False)
            console.print(team_state_view.table(self._picture.snapshot(now)))
            _require_plain(text.getvalue())
        assert self._picture.curves(110.0) is not None
        for told in self._timeline.drain_events():
            lines = [event_view.event_line(told), event_view.event_json(told), *self._table.rows(told)]
            for line in self._log.lines(told):
                lines += [event_view.log_text(told, line), event_view.log_json(told, line)]
            for line in lines:
                _require_plain(line)


def _require_plain(text: str) -> None:
    assert not any(sign in text for sign in ("\x1b", "\x9b", "\x07", "\u202e", "\r"))


def _batches() -> Sequence[bytes]:
    """Batches with one event of each kind, with a snapshot and without."""
    found = []
    for number, kind in enumerate(KINDS.values(), 1):
        event = Event(number, 1.7e9, 5.0, 0, example(kind))
        batch = EventBatch(7, 1, 1.7e9, 5.0, number - 1, number, [event])
        found.append(unpack(pack(batch)))
    first = unpack(pack(EventBatch(7, 1, 1.7e9, 5.0, 0, 0, [], {"state": 2}, example(Status))))
    hop = found[[kind.__name__ for kind in KINDS.values()].index("MigrationStarted")]
    return [pack([first, each, hop, first]) for each in found]


TARGETS = (
    Target("ps", _statuses, decode_statuses, True, (*TOKENS, *_ESCAPES)),
    Target("events", _batches, decode_batches, True, (*TOKENS, *_ESCAPES)),
)
