"""What waits for the disk, and what does not."""

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


def test_an_answer_waits_for_the_page_before_it_and_other_coordinators_do_not() -> None:
    keeping = WriteAheadQueue()
    assert keeping.put([KEPT, ANSWER, ResumeCopy("w", 1), ResumeCopy("v", 1)], 0.0) == [ResumeCopy("v", 1)]
    batch = keeping.next_batch(0.0)
    assert batch is not None
    assert keeping.on_durable(batch[0]) == [ANSWER, ResumeCopy("w", 1)]


def test_what_nobody_needs_goes_with_what_is_kept_meanwhile_and_is_not_written_before() -> None:
    keeping = WriteAheadQueue()
    begun = PendingCallRecord("w", 1, 3, "arm", "lift")
    keeping.add_record(begun, 0.0)
    keeping.put([KEPT], 0.0)
    keeping.delete_records([key_of(begun)], 0.0)
    assert keeping.next_batch(0.0) == (1, [KEPT.record], [key_of(begun)])
    # By itself it is in no hurry.
    keeping.delete_records([key_of(begun)], 1.0)
    assert keeping.next_batch(1.0) is None
    assert keeping.due is not None
    assert keeping.next_batch(keeping.due) == (2, [], [key_of(begun)])


def test_what_stops_a_copy_waits_for_nothing() -> None:
    # Held back, it would let the copy run to an end that has been told as another one already.
    keeping = WriteAheadQueue()
    stops = [TerminateCopy("w", 1, "recovered elsewhere"), DropTerminated("w", 1, "done", "", "bravo")]
    assert keeping.put([KEPT, ANSWER, *stops], 0.0) == stops


def test_a_copy_that_is_stopped_is_let_go_by_nothing_that_waited() -> None:
    keeping = WriteAheadQueue()
    assert (
        keeping.put(
            [KEPT, CoordinatorStarted("w", 1), ANSWER, ResumeCopy("w", 1), ResumeCopy("w", 65537)], 0.0
        )
        == []
    )
    keeping.put([TerminateCopy("w", 1, "recovered elsewhere")], 0.0)
    batch = keeping.next_batch(0.0)
    assert batch is not None
    assert keeping.on_durable(batch[0]) == [ANSWER, ResumeCopy("w", 65537)]
