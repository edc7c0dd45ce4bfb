"""`lfield up --fresh`: the coordinators it discards, and the conditions that prevent it."""

from __future__ import annotations

import asyncio
import io
import sys

import pytest
from msgspec.structs import replace
from scripted_snapshots import batch_of

from lfield.cli.run.journal_reset_prompt import reset_journal
from lfield.clock import ManualClock
from lfield.errors import AddressError, CoordinatorAlive, UsageError
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal_loader import JournalOwner
from lfield.journal.records import BundleRecord, CoordinatorRecord, FenceRecord, RunMarker, StartCounter
from lfield.operator.client import SNAPSHOT
from lfield.operator.journal_reset import RESET_REASON, plan_reset
from lfield.operator.team_model.host_model import host_states
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.observer_messages import ForgetRequest, ForgetResponse, JournalStatus, ParkedStatus, Status
from lfield.wire.subscription_messages import EventBatch

HERE = CoordinatorRecord("pilot", 3, "RUN", 4, 2, program=b"p" * 32, block=b"block")
AWAY = CoordinatorRecord(
    "scout", 2, "MOVED", 7, 5, target="bravo", receiver_memory=9, program=b"p" * 32, block=b"block"
)
OVER = CoordinatorRecord("boss", 1, "EXITED", outcome="done", ended_on="alpha")
OWNER = JournalOwner("harvest", "alpha", "this computer")


def batch(*known: CoordinatorState, parked: tuple[ParkedStatus, ...] = ()) -> EventBatch:
    output = Status("bravo", "", 0.0, b"", b"", [], list(known), [], [], [])
    return batch_of(replace(output, journal=JournalStatus(0, "", list(parked))))


def plan(pages, answers):
    """The reset of alpha, after those answers of other hosts."""
    return plan_reset("alpha", pages, host_states(answers))


def test_a_reset_ends_local_coordinators_as_lost_and_closes_the_run():
    pages = [StartCounter(3), RunMarker(True), BundleRecord(b"b" * 32), HERE, OVER, FenceRecord("pilot", 2)]
    found = plan(pages, {})
    assert (found.discarded, found.departed) == ([HERE], [])
    ended, run, bundle = found.records
    # After a reset an unsigned bundle is reported again.
    assert (run, bundle) == (RunMarker(open=False), BundleRecord(b""))
    assert (ended.agent, ended.generation, ended.sequence) == ("pilot", 3, 4)
    assert (ended.state, ended.outcome, ended.detail, ended.ended_on) == (
        "EXITED",
        "lost",
        RESET_REASON,
        "alpha",
    )
    assert ended.block == b""


@pytest.mark.parametrize("state", ["PREPARED", "MOVED"])
def test_a_departed_coordinator_blocks_a_reset_until_its_end_is_known(state):
    page = replace(AWAY, state=state)
    assert plan([page], {"bravo": AddressError("b:1", "nobody")}).departed == [page]
    assert plan([page], {"bravo": batch()}).departed == [page]
    assert plan([page], {"bravo": batch(CoordinatorState("scout", 2, 7, 6, "RUN"))}).departed == [page]
    assert plan(
        [page], {"bravo": batch(CoordinatorState("scout", 1, 7, 6, "EXITED", "bravo", "done"))}
    ).departed
    found = plan(
        [page],
        {"bravo": batch(CoordinatorState("scout", 2, 7, 6, "EXITED", "bravo", "died", "why"))},
    )
    assert (found.discarded, found.departed) == ([], [])
    assert (found.records[0].outcome, found.records[0].detail, found.records[0].ended_on) == (
        "died",
        "why",
        "bravo",
    )


def test_a_coordinator_parked_elsewhere_is_discarded_but_its_shadow_is_no_proof():
    parked = ParkedStatus("scout", 2, 6, b"q" * 32, "RUN", "")
    found = plan([AWAY], {"bravo": batch(), "carol": batch(parked=(parked,))})
    assert found.parked == {AWAY: "carol"}
    assert (found.discarded, found.departed) == ([AWAY], [])
    assert found.records[0].outcome == "lost"
    shadow = replace(parked, state="MOVED", where="carol")
    assert plan([AWAY], {"bravo": batch(parked=(shadow,))}).departed == [AWAY]


@pytest.mark.parametrize("reached", [True, False])
def test_a_coordinator_parked_elsewhere_is_forgotten_there_or_nothing_changes(
    tmp_path, monkeypatch, capsys, reached
):
    file, requests = tmp_path / "host.journal", []
    parked = batch(parked=(ParkedStatus("scout", 2, 6, b"q" * 32, "RUN", ""),))

    async def ask_all(transport, addresses, request):
        requests.append((addresses, request.message))
        answer = ForgetResponse([2]) if reached else AddressError("b:1", "no answer within 8 s")
        return dict.fromkeys(addresses, parked if request is SNAPSHOT else answer)

    monkeypatch.setattr("lfield.operator.client.ask_all", ask_all)
    kept(file, AWAY)
    others = {"bravo": "b:1"}
    if reached:
        assert reset_journal(file, OWNER, others, print, None, yes=True)
        assert [page.outcome for page in kept(file) if isinstance(page, CoordinatorRecord)] == ["lost"]
    else:
        with pytest.raises(CoordinatorAlive, match=r"bravo.* has not given it up: .*no answer within 8 s"):
            reset_journal(file, OWNER, others, print, None, yes=True)
        assert AWAY in kept(file)
    assert "  scout, start 2, after 5 hops, parked at bravo\n" in capsys.readouterr().out
    assert requests == [(others, SNAPSHOT.message), (others, ForgetRequest("scout"))]


def kept(file, *pages):
    journal = FileJournal(file, OWNER, print, ManualClock(1_800_000_000.0))
    if pages:
        asyncio.run(journal.persist(pages))
    journal.close()
    return journal.records()


def test_a_reset_without_confirmation_changes_nothing(tmp_path, monkeypatch, capsys):
    file = tmp_path / "host.journal"
    kept(file, HERE, RunMarker(True), StartCounter(3))
    monkeypatch.setattr(sys, "stdin", io.StringIO("yes\n"))
    with pytest.raises(
        UsageError, match="nothing was deleted: no terminal to confirm on; confirm with --yes"
    ):
        reset_journal(file, OWNER, {}, print, None, yes=False)
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda question: "no")
    assert not reset_journal(file, OWNER, {}, print, None, yes=False)
    assert HERE in kept(file)
    assert "  pilot, start 3, after 2 hops\n" in capsys.readouterr().out
    monkeypatch.setattr("builtins.input", lambda question: "yes")
    assert reset_journal(file, OWNER, {}, print, None, yes=False)
    pages = kept(file)
    assert {page.outcome for page in pages if isinstance(page, CoordinatorRecord)} == {"lost"}
    assert RunMarker(False) in pages
    assert StartCounter(3) in pages


def test_a_reset_is_refused_while_a_coordinator_may_be_alive_elsewhere(tmp_path):
    file = tmp_path / "host.journal"
    kept(file, HERE, AWAY)
    with pytest.raises(
        CoordinatorAlive, match=r"scout, start 2, left for bravo \(transfer 7\) and may continue there"
    ):
        reset_journal(file, OWNER, {}, print, None, yes=True)
    assert HERE in kept(file)
