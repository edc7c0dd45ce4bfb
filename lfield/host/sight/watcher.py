"""What one watcher of a host is told, and when: batches of states and telemetry, as it keeps up. Pure.

It gets every state in its turn, as long as the stream has it. Who falls behind that while it watches is not
fed from the oldest end, where it would lose some more with every batch: it hears what happened seldom, how
many others it has lost, and goes on with what is live. Telemetry waits until there is room and no state left:
of each device and agent only the newest, and what that replaced is counted. At most WINDOW batches are on
their way; who does not read them gets no more, and its host does nothing for it but count.

Telemetry leaves most of a slow path to other messages, orders to stop above all: at most one batch with
telemetry is under way, and after one that was seen late there is a pause, several times as long as the delay
beyond the round trip.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

from lfield.host.sight.stream import Stream, size_of
from lfield.wire.events import Event, Thinned
from lfield.wire.observing import Status
from lfield.wire.watching import MAX_EVENTS, WINDOW, Events, Watch

#: Bytes of the events of a batch, unless one alone has more.
BATCH_BYTES = 48 << 10
#: Seconds between two batches, at least; and at most, so that a watcher knows that the host lives.
LEAST, QUIET = 0.05, 1.0
#: After telemetry that was seen later than a round trip there is none for so many times the delay, and for so
#: many seconds at most. The round trip that is assumed approaches later ones by this part of the difference.
REST, LONGEST_REST, CREEP = 8.0, 10.0, 1 / 64
#: Who has not read for so many seconds what was sent is no watcher any more.
PATIENCE = 60.0
#: The telemetry of a host now: by what it is of, a number that is another one when it has changed, and it.
Sample = Mapping[str, tuple[object, Thinned]]


class Watcher:
    """A watcher from its `watch` on, which came `up` seconds after the host began; `life` is its incarnation.

    All times are such seconds.
    """

    def __init__(self, stream: Stream, life: int, watch: Watch, up: float) -> None:
        self._stream, self._life = stream, life
        if watch.incarnation == 0:
            self._after = stream.latest
        else:
            self._after = min(watch.after, stream.latest) if watch.incarnation == life else 0
        #: The newest state when it began or fell behind; and the one after which it hears what happens often.
        self._past, self._often_after = stream.latest, 0
        self._snapshot = watch.incarnation != life or self._after < stream.forgotten
        #: Whether a snapshot was the last that it was sent.
        self._shown = False
        self._batch = self._seen = 0
        self._lost: Counter[str] = Counter()
        self._owed: dict[str, Event] = {}
        self._known: dict[str, object] = {}
        self._every = 1.0 / watch.telemetry if watch.telemetry else 0.0
        #: When telemetry is to be looked at next for it, None for never.
        self.sample_due: float | None = up if self._every else None
        #: When the batches were sent that are not seen yet; the one of them that has telemetry, 0 for none;
        #: the round trip in seconds, and when there may be telemetry again.
        self._sent: dict[int, float] = {}
        self._full, self._is_full = 0, False
        self._round_trip: float | None = None
        self._rest_until = up
        #: When a batch may be sent to it next.
        self.next = up
        self._heard = up

    def goes_on(self, before: Watcher) -> None:
        """It watched before and asks anew: of what it has lost meanwhile it is still to be told."""
        self._lost.update(before._lost)

    def seen(self, batch: int, up: float) -> None:
        """It has read up to that batch."""
        if not self._seen < batch <= self._batch:
            return
        self._seen, self._heard = batch, up
        if self._full and self._full <= batch:
            self._rest_until, self._full = up + self._rest(up - self._sent[self._full]), 0
        else:
            took = up - self._sent[batch]
            before = took if self._round_trip is None else self._round_trip
            self._round_trip = min(took, before + CREEP * (took - before))
        self._sent = {number: at for number, at in self._sent.items() if number > batch}

    def _rest(self, took: float) -> float:
        """How long there is no telemetry after a batch with some that took so many seconds to be seen."""
        if self._round_trip is not None:
            return min(LONGEST_REST, REST * max(0.0, took - self._round_trip))
        # A batch without telemetry comes next, and shows the round trip.
        return QUIET if took > LEAST else 0.0

    def has_gone(self, up: float) -> bool:
        """Whether it has stopped reading for good."""
        return self._seen < self._batch and up - self._heard >= PATIENCE

    @property
    def due(self) -> float:
        """When `batch` gives something next, if all goes on like this, or it `has_gone`."""
        if self._is_behind:
            return self._heard + PATIENCE
        if not self._batch or self._snapshot or self._stream.latest > self._after:
            return self.next
        quiet = self.next - LEAST + QUIET
        return quiet if self._full or not self._owed else min(quiet, max(self.next, self._rest_until))

    @property
    def _is_behind(self) -> bool:
        return self._batch - self._seen >= WINDOW

    def sample(self, told: Sample, at: float, up: float) -> None:
        """How everything is now; what has changed since it was last looked at is owed."""
        if self.sample_due is None or up < self.sample_due:
            return
        self.sample_due = max(self.sample_due + self._every, up)
        latest = self._stream.latest
        for key, (version, what) in told.items():
            if self._known.get(key) == version:
                continue
            self._known[key] = version
            event = Event(latest, at, up, 0, what)
            if key in self._owed:
                self._lost[event.kind] += 1
            self._owed[key] = event

    def batch(self, at: float, up: float, snapshot: Callable[[], Status]) -> Events | None:
        """What is to be sent now, None for nothing yet."""
        if self._is_behind or up < self.due:
            return None
        if self._seen == self._batch:
            # From here on it is waited for.
            self._heard = up
        after, told, shown = self._after, list[Event](), None
        # However slowly it reads, behind a snapshot it hears something.
        if self._snapshot or (not self._shown and self._falls_behind()):
            shown, self._snapshot, self._shown = snapshot(), False, True
        else:
            (after, told), self._shown = self._told(up), False
        self._batch += 1
        self._sent[self._batch] = up
        if self._is_full:
            self._full, self._is_full = self._batch, False
        self.next = up + LEAST
        lost, self._lost = dict(self._lost), Counter()
        return Events(self._life, self._batch, at, up, after, self._stream.latest, told, lost, shown)

    def last(self, at: float, up: float) -> Events:
        """What is said to one that has gone, should it read it one day: what it has lost until now."""
        for event in self._owed.values():
            self._lost[event.kind] += 1
        lost, self._lost = dict(self._lost), Counter()
        self._owed.clear()
        self._batch += 1
        return Events(self._life, self._batch, at, up, self._after, self._stream.latest, [], lost)

    def _falls_behind(self) -> bool:
        """Whether the stream has forgotten what was to come next: then it goes on with what is live."""
        stream = self._stream
        if stream.forgotten <= max(self._after, self._past):
            return False
        self._past = self._often_after = stream.latest
        return True

    def _told(self, up: float) -> tuple[int, list[Event]]:
        """The next states, and the number that they follow; where they leave room, telemetry too."""
        stream, before = self._stream, self._after
        told, size = stream.after(before, MAX_EVENTS, BATCH_BYTES, self._often_after)
        self._after = told[-1].number if told else stream.latest
        if missing := self._after - before - len(told):
            self._lost["state"] += missing
        after = told[0].number - 1 if told else self._after
        if self._after == stream.latest and not self._full and up >= self._rest_until:
            self._is_full = bool(self._owed)
            self._beside(told, size)
        return after, told

    def _beside(self, told: list[Event], size: int) -> None:
        """Telemetry, as far as there is room."""
        for key, event in list(self._owed.items()):
            size += size_of(event)
            if len(told) >= MAX_EVENTS or (told and size > BATCH_BYTES):
                break
            told.append(event)
            del self._owed[key]
