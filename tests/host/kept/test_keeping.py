"""What waits for the disk, and what does not."""

from __future__ import annotations

from lfield.host.team.keeping import Keeping
from lfield.journal.pages import BegunPage, CopyPage, key_of
from lfield.mobility.effects import Began, Finished, Go, Persist, Send, Supersede
from lfield.wire.coordinators import Accepted

KEPT = Persist("w", CopyPage("w", 1, "EXITED"))
ANSWER = Send("bravo", Accepted("w", 1, 2))


def test_an_answer_waits_for_the_page_before_it_and_other_coordinators_do_not() -> None:
    keeping = Keeping()
    assert keeping.put([KEPT, ANSWER, Go("w", 1), Go("v", 1)], 0.0) == [Go("v", 1)]
    batch = keeping.take(0.0)
    assert batch is not None
    assert keeping.kept(batch[0]) == [ANSWER, Go("w", 1)]


def test_what_nobody_needs_goes_with_what_is_kept_meanwhile_and_is_not_written_before() -> None:
    keeping = Keeping()
    begun = BegunPage("w", 1, 3, "arm", "lift")
    keeping.page(begun, 0.0)
    keeping.put([KEPT], 0.0)
    keeping.forget([key_of(begun)], 0.0)
    assert keeping.take(0.0) == (1, [KEPT.page], [key_of(begun)])
    # By itself it is in no hurry.
    keeping.forget([key_of(begun)], 1.0)
    assert keeping.take(1.0) is None
    assert keeping.due is not None
    assert keeping.take(keeping.due) == (2, [], [key_of(begun)])


def test_what_stops_a_copy_waits_for_nothing() -> None:
    # Held back, it would let the copy run to an end that has been told as another one already.
    keeping = Keeping()
    stops = [Supersede("w", 1, "recovered elsewhere"), Finished("w", 1, "done", "", "bravo")]
    assert keeping.put([KEPT, ANSWER, *stops], 0.0) == stops


def test_a_copy_that_is_stopped_is_let_go_by_nothing_that_waited() -> None:
    keeping = Keeping()
    assert keeping.put([KEPT, Began("w", 1), ANSWER, Go("w", 1), Go("w", 65537)], 0.0) == []
    keeping.put([Supersede("w", 1, "recovered elsewhere")], 0.0)
    batch = keeping.take(0.0)
    assert batch is not None
    assert keeping.kept(batch[0]) == [ANSWER, Go("w", 65537)]
