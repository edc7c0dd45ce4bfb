"""The end of a coordinator, Hellos that name coordinators, and starts that displace one another."""

import pytest
from mobility_hosts import PROGRAM, TOUR, Host, seal, transfer

from lfield.journal.records import CoordinatorRecord
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import DropTerminated, MarkMigrated, Send, TerminateCopy
from lfield.wire.coordinator_messages import (
    NEVER_ARRIVED,
    SUPERSEDED,
    CoordinatorState,
    Terminated,
    TerminatedAck,
    TransferAccepted,
    TransferQuery,
    TransferRefused,
)
from lfield.wire.fields import MAX_TEXT
from lfield.wire.messages import Hello

# Endings


def test_an_end_is_sent_until_every_host_confirms(a, b):
    a.mobility.on_linked(b.hello())
    (reported,) = a.mobility.on_ended(TOUR, 1, "died", "it fell\n  at line 3")
    ended = Terminated(TOUR, 1, "died", "it fell\n  at line 3", "a", is_of_this_run=True)
    assert reported == Send("b", ended)
    finished, ack = b.mobility.on_message("a", reported.message, 0.0)
    assert finished == DropTerminated(TOUR, 1, "died", "it fell\n  at line 3", "a")
    assert a.mobility.on_message("b", ack.message, 0.0) == []
    a.mobility.on_unlinked("b")
    assert a.mobility.on_linked(b.greeting()) == []
    assert a.mobility.on_linked(Host("c").hello()) == [Send("c", reported.message)]
    assert a.mobility.on_message("c", TerminatedAck(TOUR, 1), 0.0) == []
    assert b.known() == CoordinatorState(TOUR, 1, 0, 0, "EXITED", "a", "died", "it fell\n  at line 3")


def test_a_host_that_was_away_learns_ends_from_any_host(a, b):
    a.mobility.on_ended(TOUR, 1, "done")
    assert b.mobility.on_linked(a.greeting()) == [DropTerminated(TOUR, 1, "done", "", "a")]
    c = Host("c")
    assert c.mobility.on_linked(b.greeting()) == [DropTerminated(TOUR, 1, "done", "", "a")]
    assert c.mobility.on_linked(a.greeting()) == []


def test_an_end_settles_a_copy_in_doubt(away):
    away.mobility.tick(10.0)
    finished, _ = away.mobility.on_message("c", Terminated(TOUR, 1, "done", "", "c"), 11.0)
    assert isinstance(finished, DropTerminated)
    assert away.known().state == "EXITED"


def test_an_end_elsewhere_does_not_stop_a_copy_that_is_here(a):
    assert a.mobility.on_message("c", Terminated(TOUR, 1, "lost", "", "c"), 0.0) == [
        Send("c", TerminatedAck(TOUR, 1))
    ]
    assert a.known().state == "RUN"


def test_the_outcome_lost_is_replaced_by_a_known_end(away):
    away.mobility.tick(10.0)
    away.mobility.on_ended(TOUR, 1, "lost", "given up")
    finished, _ = away.mobility.on_message("c", Terminated(TOUR, 1, "done", "", "c"), 11.0)
    assert finished == DropTerminated(TOUR, 1, "done", "", "c")
    assert away.mobility.on_message("c", Terminated(TOUR, 1, "lost", "", "c"), 12.0) == [
        Send("c", TerminatedAck(TOUR, 1))
    ]


def test_a_coordinator_given_up_as_lost_may_still_return(away):
    away.mobility.tick(10.0)
    away.mobility.on_ended(TOUR, 1, "lost")
    (_, answer) = away.receive("c", transfer(2), b"block 2")
    assert answer.message == TransferAccepted(TOUR, 1, 2)
    assert away.known().state == "RUN"


def test_a_transfer_after_the_end_is_not_admitted(b):
    b.mobility.on_message("a", Terminated(TOUR, 1, "done", "", "a"), 0.0)
    assert b.receive("a", transfer(3), b"block 3") == [Send("a", TransferAccepted(TOUR, 1, 3))]
    assert b.injected == []


def test_a_long_detail_is_cut_to_the_limit_of_a_message(a):
    a.mobility.on_ended(TOUR, 1, "died", "x" * 10000)
    assert len(a.known().detail) == MAX_TEXT


# Transfers that wait for admission


def test_a_hello_names_a_coordinator_that_waits_for_admission(away, b):
    (known,) = b.mobility.handshake_states([transfer(1)])
    assert known == CoordinatorState(TOUR, 1, 1, 1, "PREPARED", "b", receiver_memory=1)
    # The answer is no verdict: the sender still waits for one.
    assert away.mobility.on_linked(b.hello(known)) == [Send("b", TransferQuery(TOUR, 1, 1, 1))]
    assert away.known().state == "PREPARED"


def test_a_hello_does_not_name_a_transfer_that_will_be_refused(b):
    b.mobility.on_message("a", TransferQuery(TOUR, 1, 1, 1), 0.0)
    assert b.mobility.handshake_states([transfer(1)]) == []
    assert len(b.mobility.handshake_states([transfer(2)])) == 1
    assert b.mobility.handshake_states([transfer(2, receiver=7)]) == []


def test_a_hello_names_each_start_once(b):
    b.receive("a", transfer(1), b"block 1")
    assert b.mobility.handshake_states([transfer(2), transfer(1)]) == b.mobility.known_states()


# Two starts of one coordinator


def test_a_later_start_ends_when_it_learns_of_the_earlier(b):
    restarted = Host("a", incarnation=2)
    restarted.mobility.start(TOUR, 2)
    b.receive("a", transfer(1), b"block 1")
    (stop, *_) = restarted.mobility.on_linked(b.greeting())
    assert stop == TerminateCopy(
        TOUR, 2, f"an earlier start of {TOUR} is alive on b, so this later one was stopped"
    )
    assert restarted.known(2).outcome == "superseded"
    assert b.known(1).state == "RUN"


def test_the_host_of_the_earlier_start_ends_the_later_one(b):
    """The Hello of b may have been sent before the copy arrived at b."""
    b.receive("a", transfer(1), b"block 1")
    c = Host("c")
    c.receive("a", transfer(1, generation=2), b"block 1")
    (reported,) = b.mobility.on_linked(c.greeting())
    assert (reported.message.outcome, reported.message.generation) == ("superseded", 2)
    stop, _ = c.mobility.on_message("b", reported.message, 0.0)
    assert isinstance(stop, TerminateCopy)


def test_an_arriving_later_start_is_ended_where_the_earlier_is_alive(b):
    b.receive("a", transfer(1), b"block 1")
    (answer,) = b.receive("a", transfer(1, generation=2), b"block 1")
    assert answer.message.kind == SUPERSEDED
    restarted = Host("a", incarnation=2)
    restarted.mobility.start(TOUR, 2)
    restarted.mobility.on_linked(b.hello())
    restarted.mobility.depart(TOUR, "b", seal, 0.0)
    (stop,) = restarted.mobility.on_message("b", answer.message, 0.0)
    assert isinstance(stop, TerminateCopy)
    assert b.mobility.on_message("a", TransferQuery(TOUR, 2, 1, 1), 0.0) == [answer]


def test_an_arriving_earlier_start_ends_the_later(b):
    b.receive("a", transfer(1, generation=2), b"later")
    stop, _, answer = b.receive("c", transfer(4, generation=1), b"earlier")
    assert isinstance(stop, TerminateCopy)
    assert stop.generation == 2
    assert answer.message == TransferAccepted(TOUR, 1, 4)
    assert b.injected == [(1, b"later"), (4, b"earlier")]


def test_a_copy_in_doubt_gives_way_to_a_later_start(away):
    """Otherwise both starts might run on one host."""
    away.mobility.tick(10.0)
    stop, _, answer = away.receive("b", transfer(1, generation=2), b"later")
    assert stop.generation == 1
    assert answer.message == TransferAccepted(TOUR, 2, 1)
    # This is no proof of a loss: b may have it.
    known = away.known(1)
    assert (known.state, known.where, known.outcome) == ("IN DOUBT", "b", "")
    assert known.detail.endswith("its copy here was displaced by a later start")
    assert away.mobility.shadow(TOUR, 1) == b"block 1"
    assert away.mobility.on_message("b", TransferRefused(TOUR, 1, 1, NEVER_ARRIVED, ""), 11.0) == []
    # Now the loss is proven: b will not accept the transfer, and it cannot continue here.
    assert (away.known(1).state, away.known(1).outcome) == ("EXITED", "lost")


def test_a_displaced_copy_in_doubt_is_queried_again(away, b):
    away.mobility.tick(10.0)
    away.receive("b", transfer(1, generation=2), b"later")
    away.mobility.on_unlinked("b")
    assert Send("b", TransferQuery(TOUR, 1, 1, 1)) in away.mobility.on_linked(b.hello())
    assert away.mobility.on_message("b", TransferAccepted(TOUR, 1, 1), 12.0) == [
        MarkMigrated(TOUR, 1, 1, "b")
    ]
    assert away.known(1).state == "MOVED"


def test_a_copy_in_doubt_does_not_end_a_later_start(away):
    away.mobility.tick(10.0)
    restarted = Host("b", incarnation=2)
    restarted.mobility.start(TOUR, 2)
    assert restarted.mobility.on_linked(away.greeting()) == []
    assert restarted.known(2).state == "RUN"


def test_a_restored_copy_whose_end_is_known_does_not_continue():
    page = CoordinatorRecord(TOUR, 1, "PREPARED", 1, target="b", receiver_memory=1, block=b"block 1")
    host = Host("a")
    host.mobility.restore([page])
    host.mobility.on_linked(Host("b").hello(CoordinatorState(TOUR, 1, 3, 2, "EXITED", "b", "done")))
    assert host.known().state == "EXITED"

    def put(copy, *, runs):
        raise AssertionError("it has ended")

    assert host.mobility.resume_restored(put, 0.0) == []


@pytest.mark.parametrize(("memory", "gone"), [(7, False), (8, True)], ids=["the same", "another disk"])
def test_a_state_in_a_hello_counts_only_from_another_disk(memory, gone):
    """The state may not be durable yet, so the sender queries: that answer waits for the disk."""

    def hello(host, memory, *known):
        return Hello(
            host.role, host.host, host.incarnation, PROGRAM, PROGRAM, 1000, list(known), journal_id=memory
        )

    a, b = Host("a").hello(), Host("b").hello()
    mobility = Mobility(hello(a, 5), peers=["a", "b"], agents=[TOUR])
    mobility.on_linked(hello(b, 7))
    mobility.start(TOUR, 1)
    mobility.depart(TOUR, "b", seal, 0.0)
    mobility.on_unlinked("b")
    effects = mobility.on_linked(hello(b, memory, CoordinatorState(TOUR, 1, 2, 2, "RUN")))
    assert any(isinstance(effect, MarkMigrated) for effect in effects) == gone
    assert (
        any(isinstance(effect, Send) and isinstance(effect.message, TransferQuery) for effect in effects)
        != gone
    )
