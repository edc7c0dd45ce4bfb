"""The write-ahead queue: which effects wait for the disk, and which do not."""

from __future__ import annotations

from lfield.host.migration.write_ahead import WriteAheadQueue
from lfield.journal.records import CoordinatorRecord, PendingCallRecord, key_of
from lfield.replication.transfer.effects import (
    CoordinatorStarted,
    DropTerminated,
    PersistRecord,
    ResumeCopy,
    Send,
    TerminateCopy,
)
from lfield.wire.coordinator_messages import TransferAccepted

KEPT = PersistRecord("w", CoordinatorRecord("w", 1, "EXITED"))
ANSWER = Send("bravo", TransferAccepted("w", 1, 2))


def test_an_answer_waits_for_the_record_before_it_and_other_coordinators_do_not() -> None:
    queue = WriteAheadQueue()
    assert queue.put([KEPT, ANSWER, ResumeCopy("w", 1), ResumeCopy("v", 1)], 0.0) == [ResumeCopy("v", 1)]
    batch = queue.next_batch(0.0)
    assert batch is not None
    assert queue.on_durable(batch[0]) == [ANSWER, ResumeCopy("w", 1)]


def test_deletions_are_written_with_the_next_record_or_when_they_are_due() -> None:
    queue = WriteAheadQueue()
    pending = PendingCallRecord("w", 1, 3, "arm", "lift")
    queue.add_record(pending, 0.0)
    queue.put([KEPT], 0.0)
    queue.delete_records([key_of(pending)], 0.0)
    assert queue.next_batch(0.0) == (1, [KEPT.record], [key_of(pending)])
    # A deletion alone is not urgent.
    queue.delete_records([key_of(pending)], 1.0)
    assert queue.next_batch(1.0) is None
    assert queue.due is not None
    assert queue.next_batch(queue.due) == (2, [], [key_of(pending)])


def test_an_effect_that_stops_a_copy_does_not_wait() -> None:
    # Delayed, it would let the copy run to an end although another end has been reported.
    queue = WriteAheadQueue()
    stops = [TerminateCopy("w", 1, "recovered elsewhere"), DropTerminated("w", 1, "done", "", "bravo")]
    assert queue.put([KEPT, ANSWER, *stops], 0.0) == stops


def test_a_stopped_copy_is_not_released_by_delayed_effects() -> None:
    queue = WriteAheadQueue()
    assert (
        queue.put([KEPT, CoordinatorStarted("w", 1), ANSWER, ResumeCopy("w", 1), ResumeCopy("w", 65537)], 0.0)
        == []
    )
    queue.put([TerminateCopy("w", 1, "recovered elsewhere")], 0.0)
    batch = queue.next_batch(0.0)
    assert batch is not None
    assert queue.on_durable(batch[0]) == [ANSWER, ResumeCopy("w", 65537)]
