"""Every transition of the sender and the receiver, one by one."""

import pytest
from mobility_hosts import TOUR, Host, seal, transfer

from lfield.replication.transfer.coordinator_copies import MAX_STARTS
from lfield.replication.transfer.effects import (
    LogAnomaly,
    MarkInDoubt,
    MarkMigrated,
    ResumeCopy,
    ResumeWithException,
    Send,
    SendTransfer,
    TransferRefusal,
)
from lfield.replication.transfer.generations import GENERATION_STRIDE
from lfield.replication.transfer.transfer_sender import PAUSED
from lfield.wire.coordinator_messages import (
    NEVER_ARRIVED,
    SUPERSEDED,
    CoordinatorState,
    Terminated,
    TransferAccepted,
    TransferQuery,
    TransferRefused,
)

UNREACHABLE = "UnreachableResourceException"


# The sender


def test_a_hop_is_one_transfer_and_one_acknowledgement(a, b):
    a.mobility.on_linked(b.greeting())
    b.mobility.on_linked(a.greeting())
    (sent,) = a.mobility.depart(TOUR, "b", seal, 0.0)
    assert sent == SendTransfer("b", transfer(1), b"block 1")
    assert a.known().state == "PREPARED"
    (_, answer) = b.receive("a", sent.header, sent.block)
    assert answer == Send("a", TransferAccepted(TOUR, 1, 1))
    assert b.injected == [(1, b"block 1")]
    assert b.known() == CoordinatorState(TOUR, 1, 1, 1, "RUN")
    assert a.mobility.on_message("b", answer.message, 0.1) == [MarkMigrated(TOUR, 1, 1, "b")]
    assert a.known() == CoordinatorState(TOUR, 1, 1, 0, "MOVED", "b", receiver_memory=1)
    assert a.mobility.shadow(TOUR, 1) == b"block 1"
    assert a.mobility.next_deadline() is None


def test_without_a_link_a_coordinator_waits_frozen_until_there_is_one(a, b):
    assert a.mobility.depart(TOUR, "b", seal, 0.0) == []
    assert a.known().state == "FROZEN"
    assert a.mobility.next_deadline() == 10.0
    assert a.mobility.tick(9.9) == []
    assert a.mobility.on_linked(Host("c").hello()) == []
    assert a.mobility.on_linked(b.hello()) == [SendTransfer("b", transfer(1), b"block 1")]


def test_a_departure_that_waits_for_a_link_can_be_cancelled(a, b):
    a.mobility.depart(TOUR, "b", seal, 0.0)
    assert a.mobility.cancel_departure(TOUR, 1)
    assert a.known().state == "RUN"
    assert a.mobility.next_deadline() is None
    assert a.mobility.on_linked(b.hello()) == []
    # It may leave again, under the number that was never sent.
    assert a.mobility.depart(TOUR, "b", seal, 1.0) == [SendTransfer("b", transfer(1), b"block 1")]


def test_a_sent_transfer_cannot_be_cancelled(away):
    assert not away.mobility.cancel_departure(TOUR, 1)
    assert away.known().state == "PREPARED"
    assert not away.mobility.cancel_departure(TOUR, 2)
    assert not away.mobility.cancel_departure("unknown", 1)


def test_a_running_coordinator_has_no_departure_to_cancel(a):
    assert not a.mobility.cancel_departure(TOUR, 1)


def test_an_unreachable_host_raises_an_exception_after_the_patience(a):
    a.mobility.depart(TOUR, "b", seal, 0.0)
    (resume,) = a.mobility.tick(10.0)
    assert resume == ResumeWithException(
        TOUR, 1, 0, UNREACHABLE, "b could not be reached within 10 s; is it up?"
    )
    assert a.known().state == "RUN"
    assert a.mobility.tick(20.0) == []


@pytest.mark.parametrize("message", [PAUSED, "its disk is full"])
def test_backpressure_of_a_host_is_ignored_when_its_link_is_lost(a, b, message):
    a.mobility.on_linked(b.hello())
    assert a.mobility.on_backpressure("b", message) == []
    assert a.mobility.depart(TOUR, "b", seal, 0.0) == []
    a.mobility.on_unlinked("b")
    (resume,) = a.mobility.tick(10.0)
    assert resume == ResumeWithException(
        TOUR, 1, 0, UNREACHABLE, "b could not be reached within 10 s; is it up?"
    )
    assert a.mobility.depart(TOUR, "b", seal, 20.0) == []
    assert a.mobility.on_linked(Host("b", 2).hello()) == [
        SendTransfer("b", transfer(1, receiver=2), b"block 1")
    ]


def test_a_new_link_clears_the_backpressure(a, b):
    a.mobility.on_linked(b.hello())
    a.mobility.on_backpressure("b", "its disk is full")
    a.mobility.depart(TOUR, "b", seal, 0.0)
    (sent,) = a.mobility.on_linked(b.hello())
    assert sent == SendTransfer("b", transfer(1), b"block 1")


def test_a_refusal_resumes_and_its_number_is_not_reused(away):
    (resume,) = away.mobility.on_message("b", TransferRefused(TOUR, 1, 1, "LimitException", "full"), 0.1)
    assert resume == ResumeWithException(TOUR, 1, 1, "LimitException", "full")
    (sent,) = away.mobility.depart(TOUR, "b", seal, 1.0)
    assert sent.header.sequence == 2
    assert sent.block == b"block 2"


def test_a_block_over_the_limit_of_the_peer_is_not_sent(a):
    a.mobility.on_linked(Host("b", max_block=3).hello())
    (resume,) = a.mobility.depart(TOUR, "b", seal, 0.0)
    assert resume == ResumeWithException(
        TOUR, 1, 1, "LimitException", f"{TOUR} has 7 bytes and b takes at most 3"
    )


def test_answers_with_other_numbers_or_from_other_hosts_have_no_effect(away):
    for host, answer in [
        ("b", TransferAccepted(TOUR, 1, 2)),
        ("b", TransferAccepted(TOUR, 2, 1)),
        ("c", TransferRefused(TOUR, 1, 1, UNREACHABLE, "")),
        ("c", TransferRefused(TOUR, 1, 1, NEVER_ARRIVED, "")),
        ("b", TransferRefused(TOUR, 1, 7, UNREACHABLE, "")),
        ("b", TransferRefused("Other:x", 1, 1, UNREACHABLE, "")),
    ]:
        assert away.mobility.on_message(host, answer, 0.0) == []
    assert away.known().state == "PREPARED"


def test_any_host_may_confirm_that_the_receiver_accepted(away):
    away.mobility.on_unlinked("b")
    assert [type(effect) for effect in away.mobility.on_message("c", TransferAccepted(TOUR, 1, 1), 0.0)] == [
        MarkMigrated
    ]
    assert away.known().state == "MOVED"


def test_any_host_may_report_a_recovery(away):
    away.mobility.on_message("c", TransferRefused(TOUR, 1, 1, SUPERSEDED, "recovered"), 0.0)
    assert away.known().outcome == "superseded"


def test_a_host_proves_a_transfer_to_another_only_by_a_higher_number_or_a_recovery(a):
    request = TransferQuery(TOUR, 1, 3, 99)
    assert a.mobility.prove_outcome(request) is None
    a.mobility.on_message("c", TransferQuery(TOUR, 1, 3, 1), 0.0)
    assert a.mobility.prove_outcome(request) is None
    a.mobility.on_message("c", TransferQuery(TOUR, 1, 4, 1), 0.0)
    assert a.mobility.prove_outcome(request) == TransferAccepted(TOUR, 1, 3)
    a.receive("c", transfer(1, generation=GENERATION_STRIDE + 1), b"block")
    assert a.mobility.prove_outcome(TransferQuery(TOUR, 1, 9, 99)).kind == SUPERSEDED


def test_after_a_lost_link_the_sender_queries(away, b):
    away.mobility.on_unlinked("b")
    assert away.mobility.on_linked(b.hello()) == [Send("b", TransferQuery(TOUR, 1, 1, 1))]


def test_a_transfer_that_never_arrived_is_repeated_within_the_patience(away):
    (sent,) = away.mobility.on_message("b", TransferRefused(TOUR, 1, 1, NEVER_ARRIVED, ""), 5.0)
    assert sent.header.sequence == 2
    away.mobility.on_unlinked("b")
    assert away.mobility.on_message("b", TransferRefused(TOUR, 1, 2, NEVER_ARRIVED, ""), 6.0) == []
    assert away.known().state == "FROZEN"


def test_a_transfer_that_never_arrived_is_resumed_after_the_patience(away):
    (resume,) = away.mobility.on_message("b", TransferRefused(TOUR, 1, 1, NEVER_ARRIVED, ""), 10.0)
    assert (resume.kind, resume.sequence) == (UNREACHABLE, 1)


def test_silence_leads_to_doubt_and_never_to_a_second_copy(away):
    (query,) = away.mobility.tick(10.0)
    assert isinstance(query, MarkInDoubt)
    assert "b has not confirmed within 10 s" in query.reason
    assert away.mobility.tick(1e6) == []
    assert away.known().state == "IN DOUBT"
    assert away.known().detail == query.reason


def test_a_restarted_receiver_leaves_the_sender_in_doubt(away):
    away.mobility.on_unlinked("b")
    (query,) = away.mobility.on_linked(Host("b", incarnation=2).hello())
    assert "restarted" in query.reason
    assert away.mobility.on_linked(Host("b", incarnation=2).hello()) == []
    assert away.mobility.tick(1e6) == []
    assert away.mobility.next_deadline() is None


def test_a_late_answer_ends_the_doubt(away):
    away.mobility.tick(10.0)
    (resume,) = away.mobility.on_message("b", TransferRefused(TOUR, 1, 1, "LimitException", "full"), 11.0)
    assert isinstance(resume, ResumeWithException)
    assert away.known().state == "RUN"


@pytest.mark.parametrize(
    ("state", "sequence", "moved"),
    [
        ("RUN", 1, True),
        ("FROZEN", 1, True),
        ("MOVED", 1, False),
        ("MOVED", 2, True),
        ("RUN", 0, False),
        ("PREPARED", 2, True),
    ],
)
def test_only_proof_ends_the_doubt(away, state, sequence, moved):
    away.mobility.tick(10.0)
    effects = away.mobility.on_linked(Host("c").hello(CoordinatorState(TOUR, 1, sequence, 1, state, "b")))
    assert effects == ([MarkMigrated(TOUR, 1, 1, "b")] if moved else [])


def test_a_return_ends_the_doubt_and_replaces_the_shadow(away):
    (_, answer) = away.receive("b", transfer(2, hops=2), b"block 2")
    assert answer == Send("b", TransferAccepted(TOUR, 1, 2))
    assert away.known() == CoordinatorState(TOUR, 1, 2, 2, "RUN")
    assert away.mobility.shadow(TOUR, 1) is None


def test_a_refused_return_proves_the_departure(away):
    away.refusal = TransferRefusal("LimitException", "full")
    departed, answer = away.receive("b", transfer(2), b"block 2")
    assert departed == MarkMigrated(TOUR, 1, 1, "b")
    assert answer.message.kind == "LimitException"
    assert away.known().state == "MOVED"


def test_a_query_for_a_later_number_proves_the_departure(away):
    departed, answer = away.mobility.on_message("b", TransferQuery(TOUR, 1, 2, 1), 1.0)
    assert departed == MarkMigrated(TOUR, 1, 1, "b")
    assert answer.message.kind == NEVER_ARRIVED


def test_invalid_operations_raise_an_error(a):
    with pytest.raises(ValueError, match="cannot be started"):
        a.mobility.start(TOUR, 1)
    with pytest.raises(ValueError, match="cannot be started"):
        a.mobility.start("Stranger:x", 1)
    with pytest.raises(ValueError, match="does not run here"):
        a.mobility.depart("Stranger:x", "b", seal, 0.0)
    with pytest.raises(ValueError, match="cannot end here"):
        a.mobility.on_ended(TOUR, 1, "lost")


# The receiver


def test_a_repeated_transfer_is_admitted_once(b):
    go, accepted = b.receive("a", transfer(1), b"block 1")
    assert go == ResumeCopy(TOUR, 1)
    assert b.receive("a", transfer(1), b"block 1") == [accepted]
    assert b.injected == [(1, b"block 1")]


def test_a_refused_transfer_stays_refused(b):
    b.refusal = TransferRefusal("LimitException", "full")
    (first,) = b.receive("a", transfer(1), b"block 1")
    b.refusal = None
    (second,) = b.receive("a", transfer(1), b"block 1")
    assert first == second == Send("a", TransferRefused(TOUR, 1, 1, "LimitException", "full"))
    (_, third) = b.receive("a", transfer(2), b"block 2")
    assert third.message == TransferAccepted(TOUR, 1, 2)


def test_a_transfer_that_arrives_after_its_query_is_refused(b):
    (answer,) = b.mobility.on_message("a", TransferQuery(TOUR, 1, 1, 1), 0.0)
    assert answer.message.kind == NEVER_ARRIVED
    (late,) = b.receive("a", transfer(1), b"block 1")
    assert late == answer
    assert b.injected == []
    assert b.mobility.known_states() == []


def test_a_query_about_an_accepted_transfer_is_answered(b):
    b.receive("a", transfer(1), b"block 1")
    assert b.mobility.on_message("a", TransferQuery(TOUR, 1, 1, 1), 0.0) == [
        Send("a", TransferAccepted(TOUR, 1, 1))
    ]


def test_an_overtaken_number_is_accepted_and_not_admitted(b):
    b.receive("a", transfer(5), b"block 5")
    assert b.receive("a", transfer(3), b"block 3") == [Send("a", TransferAccepted(TOUR, 1, 3))]
    assert b.injected == [(5, b"block 5")]


def test_a_message_for_an_earlier_life_is_not_answered(b):
    (note,) = b.receive("a", transfer(1, receiver=99), b"block 1")
    assert isinstance(note, LogAnomaly)
    (note,) = b.mobility.on_message("a", TransferQuery(TOUR, 1, 1, 99), 0.0)
    assert isinstance(note, LogAnomaly)
    (note,) = b.mobility.on_oversize("a", transfer(1, receiver=99), 5000)
    assert isinstance(note, LogAnomaly)


@pytest.mark.parametrize(
    ("header", "kind", "words"),
    [
        (transfer(1, program=b"q" * 32), UNREACHABLE, "belongs to program 717171717171"),
        (transfer(1, agent="Stranger:x"), UNREACHABLE, "knows no coordinator Stranger:x"),
    ],
)
def test_a_foreign_coordinator_or_program_is_refused_before_admission(b, header, kind, words):
    (answer,) = b.receive("a", header, b"block 1")
    assert answer.message.kind == kind
    assert words in answer.message.reason
    assert b.injected == []


def test_an_oversized_block_is_refused(b):
    (answer,) = b.receive("a", transfer(1), bytes(1001))
    (unread,) = b.mobility.on_oversize("a", transfer(1), 1001)
    assert answer == unread
    assert answer.message.reason == f"{TOUR} has 1001 bytes and b takes at most 1000"


def test_a_second_copy_is_refused_while_the_first_is_here(a):
    (answer,) = a.receive("b", transfer(9), b"block 9")
    assert answer.message == TransferRefused(TOUR, 1, 9, UNREACHABLE, f"{TOUR} is already on a")
    assert a.injected == []


def test_queries_about_unknown_starts_do_not_fill_the_memory(b):
    for generation in range(1, 1000):
        b.mobility.on_message("a", TransferQuery(TOUR, generation, 1, 1), 0.0)
        b.mobility.on_message("a", TransferQuery(f"Stranger:{generation}", 1, 1, 1), 0.0)
        if generation < MAX_STARTS:
            b.mobility.on_message("a", Terminated(TOUR, 2 * generation, "done", "", "a"), 0.0)
    assert len(b.mobility.known_states()) < MAX_STARTS
    (answer,) = b.receive("a", transfer(1, generation=5000), b"block 1")
    assert "starts of it" in answer.message.reason


def test_only_the_newest_ended_starts_are_kept(b):
    for generation in range(1, 1000):
        b.mobility.on_message("a", Terminated(TOUR, generation, "done", "", "a"), 0.0)
    assert [known.generation for known in b.mobility.known_states()] == list(range(1000 - MAX_STARTS, 1000))
    go, _ = b.receive("a", transfer(1, generation=5000), b"block 1")
    assert go == ResumeCopy(TOUR, 5000)
