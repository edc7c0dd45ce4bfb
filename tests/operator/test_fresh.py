"""`lfield up --fresh`: what is thrown away, and what stands in the way of that."""

from __future__ import annotations

import asyncio
import io
import sys

import pytest
from msgspec.structs import replace

from lfield.cli.run.fresh import begun_anew
from lfield.clock import ManualClock
from lfield.errors import AddressError, CoordinatorAlive, UsageError
from lfield.journal.file import FileJournal
from lfield.journal.opening import Owner
from lfield.journal.pages import BundlePage, CopyPage, Fence, Run, Starts
from lfield.operator.ask import STATUS
from lfield.operator.fresh import WORD, anew
from lfield.wire.coordinators import Known
from lfield.wire.observing import Forget, Forgotten, JournalStatus, ParkedStatus, Status

HERE = CopyPage("pilot", 3, "RUN", 4, 2, program=b"p" * 32, block=b"block")
AWAY = CopyPage("scout", 2, "MOVED", 7, 5, target="bravo", memory=9, program=b"p" * 32, block=b"block")
OVER = CopyPage("boss", 1, "EXITED", outcome="done", ended_on="alpha")
OWNER = Owner("harvest", "alpha", "this computer")


def status(*known: Known, parked: tuple[ParkedStatus, ...] = ()) -> Status:
    said = Status("bravo", "", 0.0, b"", b"", [], list(known), [], [], [])
    return replace(said, journal=JournalStatus(0, "", list(parked)))


def test_what_is_here_ends_as_lost_by_a_persons_word_and_the_run_is_closed():
    pages = [Starts(3), Run(True), BundlePage(b"b" * 32), HERE, OVER, Fence("pilot", 2)]
    found = anew("alpha", pages, {})
    assert (found.thrown, found.away) == ([HERE], [])
    ended, run, bundle = found.pages
    # Whoever begins anew is told again when the bundle is not signed by somebody who may.
    assert (run, bundle) == (Run(open=False), BundlePage(b""))
    assert (ended.agent, ended.generation, ended.sequence) == ("pilot", 3, 4)
    assert (ended.state, ended.outcome, ended.detail, ended.ended_on) == ("EXITED", "lost", WORD, "alpha")
    assert ended.block == b""


@pytest.mark.parametrize("state", ["PREPARED", "MOVED"])
def test_who_has_left_is_in_the_way_unless_somebody_says_what_became_of_it(state):
    page = replace(AWAY, state=state)
    assert anew("alpha", [page], {"bravo": AddressError("b:1", "nobody")}).away == [page]
    assert anew("alpha", [page], {"bravo": status()}).away == [page]
    assert anew("alpha", [page], {"bravo": status(Known("scout", 2, 7, 6, "RUN"))}).away == [page]
    assert anew("alpha", [page], {"bravo": status(Known("scout", 1, 7, 6, "EXITED", "bravo", "done"))}).away
    found = anew(
        "alpha", [page], {"bravo": status(Known("scout", 2, 7, 6, "EXITED", "bravo", "died", "why"))}
    )
    assert (found.thrown, found.away) == ([], [])
    assert (found.pages[0].outcome, found.pages[0].detail, found.pages[0].ended_on) == (
        "died",
        "why",
        "bravo",
    )


def test_who_is_parked_elsewhere_is_thrown_away_and_its_shadow_there_is_no_word():
    parked = ParkedStatus("scout", 2, 6, b"q" * 32, "RUN", "")
    found = anew("alpha", [AWAY], {"bravo": status(), "carol": status(parked=(parked,))})
    assert found.parked == {AWAY: "carol"}
    assert (found.thrown, found.away) == ([AWAY], [])
    assert found.pages[0].outcome == "lost"
    shadow = replace(parked, state="MOVED", where="carol")
    assert anew("alpha", [AWAY], {"bravo": status(parked=(shadow,))}).away == [AWAY]


@pytest.mark.parametrize("reached", [True, False])
def test_who_is_parked_elsewhere_is_given_up_there_or_nothing_is_thrown_away(
    tmp_path, monkeypatch, capsys, reached
):
    file, asked = tmp_path / "host.journal", []
    parked = status(parked=(ParkedStatus("scout", 2, 6, b"q" * 32, "RUN", ""),))

    async def ask_all(transport, addresses, request):
        asked.append((addresses, request.message))
        heard = Forgotten([2]) if reached else AddressError("b:1", "no answer within 8 s")
        return dict.fromkeys(addresses, parked if request is STATUS else heard)

    monkeypatch.setattr("lfield.operator.ask.ask_all", ask_all)
    kept(file, AWAY)
    others = {"bravo": "b:1"}
    if reached:
        assert begun_anew(file, OWNER, others, print, None, yes=True)
        assert [page.outcome for page in kept(file) if isinstance(page, CopyPage)] == ["lost"]
    else:
        with pytest.raises(CoordinatorAlive, match=r"bravo.* has not given it up: .*no answer within 8 s"):
            begun_anew(file, OWNER, others, print, None, yes=True)
        assert AWAY in kept(file)
    assert "  scout, start 2, after 5 hops, parked at bravo\n" in capsys.readouterr().out
    assert asked == [(others, STATUS.message), (others, Forget("scout"))]


def kept(file, *pages):
    journal = FileJournal(file, OWNER, print, ManualClock(1_800_000_000.0))
    if pages:
        asyncio.run(journal.keep(pages))
    journal.close()
    return journal.pages()


def test_it_asks_and_a_no_or_nobody_changes_nothing(tmp_path, monkeypatch, capsys):
    file = tmp_path / "host.journal"
    kept(file, HERE, Run(True), Starts(3))
    monkeypatch.setattr(sys, "stdin", io.StringIO("yes\n"))
    with pytest.raises(UsageError, match="nothing was thrown away: nobody can be asked here; add --yes"):
        begun_anew(file, OWNER, {}, print, None, yes=False)
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda question: "no")
    assert not begun_anew(file, OWNER, {}, print, None, yes=False)
    assert HERE in kept(file)
    assert "  pilot, start 3, after 2 hops\n" in capsys.readouterr().out
    monkeypatch.setattr("builtins.input", lambda question: "yes")
    assert begun_anew(file, OWNER, {}, print, None, yes=False)
    pages = kept(file)
    assert {page.outcome for page in pages if isinstance(page, CopyPage)} == {"lost"}
    assert Run(False) in pages
    assert Starts(3) in pages


def test_it_is_refused_while_a_coordinator_may_be_alive_elsewhere(tmp_path):
    file = tmp_path / "host.journal"
    kept(file, HERE, AWAY)
    with pytest.raises(
        CoordinatorAlive, match=r"scout, start 2, left for bravo \(transfer 7\) and may go on"
    ):
        begun_anew(file, OWNER, {}, print, None, yes=True)
    assert HERE in kept(file)
