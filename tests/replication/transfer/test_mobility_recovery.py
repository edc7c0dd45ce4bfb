"""A holder is permanently lost: another host recovers from its shadow; earlier starts end when informed."""

from itertools import combinations, permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mobility_hosts import PROGRAM, TOUR, Host, seal, transfer

from lfield.journal.records import CoordinatorRecord
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import (
    CoordinatorStarted,
    PersistRecord,
    ResumeWithException,
    Send,
    TerminateCopy,
)
from lfield.replication.transfer.generations import (
    GENERATION_STRIDE,
    is_recovery,
    next_recovery,
    next_start,
    outranks,
)
from lfield.wire.coordinator_messages import (
    NEVER_ARRIVED,
    SUPERSEDED,
    CoordinatorState,
    Terminated,
    TransferAccepted,
    TransferQuery,
    TransferRefused,
)
from lfield.wire.messages import Hello

RECOVERED = GENERATION_STRIDE + 1  # by host a, the first of the team


@pytest.fixture
def left() -> Host:
    """Host a, which the coordinator has left for b; it was accepted there."""
    host = Host("a")
    host.mobility.start(TOUR, 1)
    host.mobility.on_linked(Host("b").hello())
    host.mobility.depart(TOUR, "b", seal, 0.0)
    host.mobility.on_message("b", TransferAccepted(TOUR, 1, 1), 0.1)
    return host


def put(copy):
    return seal


def states(host: Host) -> dict[int, str]:
    return {known.generation: known.outcome or known.state for known in host.mobility.known_states()}


def kept(*pages: CoordinatorRecord, name: str = "a") -> Mobility:
    own = Hello("host", name, 9, PROGRAM, PROGRAM, 1000, journal_id=5)
    mobility = Mobility(own, peers=["a", "b", "c"], agents=[TOUR])
    mobility.restore(pages)
    return mobility


# Numbers


@given(newest=st.integers(0, 10 * GENERATION_STRIDE), hosts=st.sets(st.integers(0, 50), min_size=2))
def test_a_new_number_is_above_all_starts_and_unique(newest, hosts):
    minted = [next_recovery(newest, host) for host in hosts]
    assert all(number > newest and is_recovery(number) for number in minted)
    again = next_start(newest)
    assert again > newest
    assert not is_recovery(again)
    assert len({*minted, again}) == len(hosts) + 1


def test_a_home_counts_from_1_until_it_knows_of_a_recovery():
    assert [next_start(n) for n in (0, 1, GENERATION_STRIDE - 2)] == [1, 2, GENERATION_STRIDE - 1]
    assert next_start(RECOVERED) == 2 * GENERATION_STRIDE
    assert next_start(2 * GENERATION_STRIDE) == 3 * GENERATION_STRIDE


def test_the_precedence_of_starts_is_a_total_order():
    order = [3 * GENERATION_STRIDE + 2, RECOVERED, 1, 2, GENERATION_STRIDE, 2 * GENERATION_STRIDE]
    for better, worse in combinations(order, 2):
        assert outranks(better, worse)
        assert not outranks(worse, better)


# Recoveries from a shadow


def test_a_recovery_continues_at_the_call_for_which_the_coordinator_left(left):
    assert left.mobility.recoverable_state(TOUR) == CoordinatorState(
        TOUR, 1, 1, 0, "MOVED", "b", receiver_memory=1
    )
    effects = left.mobility.recover(TOUR, RECOVERED, put)
    detail = f"{TOUR} was recovered (start {RECOVERED}, says a), so start 1 was stopped"
    reason = (
        f"{TOUR} was recovered on a from its departure for b; this call may have begun, "
        "and later actions are unknown"
    )
    assert effects == [
        Send("b", Terminated(TOUR, 1, "superseded", detail, "a", is_of_this_run=True)),
        ResumeWithException(TOUR, RECOVERED, 0, "RestartException", reason, recovered=True),
    ]
    assert states(left) == {1: "superseded", RECOVERED: "RUN"}


def test_a_recovery_is_durable_before_it_is_announced_or_begins():
    mobility = kept(CoordinatorRecord(TOUR, 1, "MOVED", 3, 2, target="b", program=PROGRAM, block=b"shadow"))
    effects = mobility.recover(TOUR, RECOVERED, put)
    pages = [effect.record for effect in effects if isinstance(effect, PersistRecord)]
    assert isinstance(effects[0], PersistRecord)
    assert isinstance(effects[-1], ResumeWithException)
    assert [(page.generation, page.state, page.block) for page in pages] == [
        (RECOVERED, "RUN", b"shadow"),
        (1, "EXITED", b""),
    ]


def test_a_recovered_copy_in_doubt_is_removed_and_its_late_answer_ignored(left):
    left.mobility.recover(TOUR, RECOVERED, put)
    left.mobility.depart(TOUR, "b", seal, 1.0)
    left.mobility.tick(20.0)
    (doubt,) = [known for known in left.mobility.known_states() if known.state == "IN DOUBT"]
    assert left.mobility.recoverable_state(TOUR) == doubt
    effects = left.mobility.recover(TOUR, 2 * GENERATION_STRIDE + 1, put)
    assert [type(effect) for effect in effects] == [TerminateCopy, Send, ResumeWithException]
    late = TransferAccepted(TOUR, RECOVERED, 1)
    assert left.mobility.on_message("b", late, 21.0) == []
    assert states(left) == {1: "superseded", RECOVERED: "superseded", 2 * GENERATION_STRIDE + 1: "RUN"}


def test_a_coordinator_without_an_acting_call_starts_again():
    mobility = kept(CoordinatorRecord(TOUR, 1, "RUN"))
    assert mobility.recover(TOUR, RECOVERED, put)[-1] == CoordinatorStarted(TOUR, RECOVERED)
    assert mobility.resume_restored(lambda *_, **__: pytest.fail("it was superseded"), 0.0) == []


def test_an_unreadable_copy_is_left_unchanged(left):
    assert left.mobility.recover(TOUR, RECOVERED, lambda copy: None) == []
    assert states(left) == {1: "MOVED"}


def test_a_running_copy_cannot_be_recovered(left):
    host = Host("c")
    host.mobility.start(TOUR, 1)
    assert host.mobility.recoverable_state(TOUR) is None
    with pytest.raises(ValueError, match="cannot be recovered"):
        host.mobility.recover(TOUR, RECOVERED, put)
    with pytest.raises(ValueError, match="cannot be recovered"):
        left.mobility.recover(TOUR, 1, put)


def test_an_answer_before_the_copy_is_restored_is_requested_again():
    """The answer was relayed, or sent before the restart; the machine cannot continue the copy yet."""
    page = CoordinatorRecord(TOUR, 1, "PREPARED", 1, target="b", receiver_memory=1, block=b"block 1")
    mobility, refused = kept(page), TransferRefused(TOUR, 1, 1, NEVER_ARRIVED, "it never arrived")
    mobility.on_linked(Hello("host", "b", 1, PROGRAM, PROGRAM, 1000, journal_id=1))
    assert mobility.on_message("b", refused, 0.1) == []
    query = Send("b", TransferQuery(TOUR, 1, 1, 1))
    assert mobility.resume_restored(lambda copy, *, runs: seal, 0.2) == [query]
    (resumed,) = mobility.on_message("b", refused, 60.0)
    assert isinstance(resumed, ResumeWithException)


# Other hosts are informed

NEWS = {
    "running": CoordinatorState(TOUR, RECOVERED, 0, 2, "RUN"),
    "moved": CoordinatorState(TOUR, RECOVERED, 4, 2, "MOVED", "c", receiver_memory=1),
    "done": CoordinatorState(TOUR, RECOVERED, 4, 2, "EXITED", "c", "done"),
    "lost": CoordinatorState(TOUR, RECOVERED, 4, 2, "EXITED", "c", "lost"),
}


@pytest.mark.parametrize("news", NEWS)
def test_a_returning_host_that_was_declared_lost_does_not_continue(news):
    back = kept(CoordinatorRecord(TOUR, 1, "RUN", 3, 2, program=PROGRAM, block=b"block"), name="b")
    back.on_linked(Host("a").hello(NEWS[news]))
    assert back.resume_restored(lambda *_, **__: pytest.fail("it was superseded"), 0.0) == []
    outcomes = {known.generation: known.outcome for known in back.known_states()}
    assert outcomes[1] == "superseded"


@pytest.mark.parametrize("news", NEWS)
def test_a_running_copy_is_stopped_when_its_host_learns_of_the_recovery(news):
    host = Host("c")
    host.mobility.start(TOUR, 1)
    effects = host.mobility.on_linked(Host("a").hello(NEWS[news]))
    (stop,) = [effect for effect in effects if isinstance(effect, TerminateCopy)]
    assert (stop.generation, "recovered" in stop.reason) == (1, True)


def test_an_end_of_a_recovery_supersedes_the_earlier_start():
    host = Host("c")
    host.mobility.start(TOUR, 1)
    host.mobility.on_message("a", Terminated(TOUR, RECOVERED, "done", "", "a"), 0.0)
    assert states(host) == {1: "superseded", RECOVERED: "done"}


def test_an_arriving_earlier_start_is_refused_where_a_recovery_is_known(left):
    left.mobility.recover(TOUR, RECOVERED, put)
    left.mobility.on_ended(TOUR, RECOVERED, "done")
    for generation, sequence in ((1, 7), (2, 3)):
        *_, answer = left.receive("c", transfer(sequence, generation), b"block 7")
        assert isinstance(answer.message, TransferRefused)
        assert answer.message.kind == SUPERSEDED
    assert left.injected == []


def test_an_arriving_recovery_stops_the_earlier_start():
    host = Host("c")
    host.mobility.start(TOUR, 1)
    effects = host.receive("a", transfer(1, RECOVERED), b"block 1")
    assert [effect.generation for effect in effects if isinstance(effect, TerminateCopy)] == [1]
    assert states(host) == {1: "superseded", RECOVERED: "RUN"}


def test_a_start_after_the_end_of_a_recovery_is_not_stopped_by_it(left):
    left.mobility.recover(TOUR, RECOVERED, put)
    left.mobility.on_ended(TOUR, RECOVERED, "done")
    left.mobility.start(TOUR, 2 * GENERATION_STRIDE)
    left.mobility.on_linked(Host("c").hello(NEWS["done"]))
    assert states(left)[2 * GENERATION_STRIDE] == "RUN"


@pytest.mark.parametrize("order", list(permutations([1, RECOVERED, 2 * GENERATION_STRIDE])))
def test_a_live_recovery_continues_in_any_order_of_messages(order):
    host = Host("b")
    for generation in order:
        host.mobility.on_linked(Host("c").hello(CoordinatorState(TOUR, generation, 9, 1, "RUN")))
        host.receive("c", transfer(9, generation), b"block 9")
    assert states(host)[RECOVERED] == "RUN"
    assert {states(host).get(other, "superseded") for other in (1, 2 * GENERATION_STRIDE)} == {"superseded"}
