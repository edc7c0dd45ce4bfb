"""A coordinator parked for another mission is kept on every host: it is neither restarted nor overwritten."""

from __future__ import annotations

from lfield.host.migration.write_ahead import JournalContents
from lfield.journal.records import CoordinatorRecord, ProgramRecord
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import PersistRecord, Send
from lfield.wire.coordinator_messages import Transfer, TransferAccepted, TransferQuery
from lfield.wire.messages import Hello

PROGRAM = """
resource Post {
    int calls;
    init(string[] arg) { }
    portal stay(real seconds) { calls = calls + 1; write("arrived\\n"); sleep(seconds); }
}
coordinator Guest {
    init(string[] arg) { findPost(arg[1]).stay(1000.0); }
}
"""
CHANGED = PROGRAM + "class Other { }\n"
FROM_HOME = "//Guest:guest@home?post\n//Post:post@away\n//Post:other@home\n"
FROM_AWAY = FROM_HOME.replace("guest@home", "guest@away")


def parked(running):
    return [(one.agent, one.generation, one.state) for one in running.host.status().journal.parked]


async def park_at_away(team):
    """Guest, start 1, is parked on away; both hosts have stopped."""
    home, away = await team.up(team.mission(PROGRAM, FROM_HOME), keeps=True)
    await team.until(lambda: away.output)
    await away.host.stop()
    await home.host.stop()


async def test_a_home_with_a_new_disk_does_not_start_a_coordinator_parked_elsewhere(team, /):
    await park_at_away(team)
    del team.disks["home"]
    home, away = await team.up(team.mission(CHANGED, FROM_HOME), keeps=True)
    await team.until(
        lambda: (
            "guest not started again: it is parked on away for the program and deployment that it belongs"
            in home.log
        )
    )
    assert not home.holds("guest")
    assert parked(away) == [("guest", 1, "RUN")]
    await home.host.stop()
    await away.host.stop()
    _, away = await team.up(team.mission(PROGRAM, FROM_HOME), keeps=True)
    await team.until(lambda: "guest resumed from the journal" in away.log)


async def test_a_changed_home_does_not_start_a_coordinator_parked_elsewhere(team, /):
    home, away = await team.up(team.mission(PROGRAM, FROM_AWAY), "home", "away", keeps=True)
    await team.until(lambda: away.output)
    await away.host.stop()
    await home.host.stop()
    home, away = await team.up(team.mission(PROGRAM, FROM_HOME), keeps=True)
    await team.until(lambda: "guest not started again: it is parked on away" in home.log)
    assert not home.holds("guest")
    assert parked(away) == [("guest", 1, "RUN")]


async def test_the_number_of_a_parked_start_is_not_overwritten(team, /):
    """An operator states that there was no earlier start: the arriving copy is refused, and nothing is
    lost."""
    await park_at_away(team)
    other = team.mission(CHANGED, FROM_HOME, without=("away",))
    del team.disks["home"]
    home, away = (team.make(other, name, keeps=True) for name in ("home", "away"))
    home.host.options.first_start = True
    await home.host.start()
    await team.until(lambda: home.holds("guest"))
    await away.host.start()
    await team.until(lambda: "has another start of guest under that number" in home.log)
    assert parked(away) == [("guest", 1, "RUN")]
    await away.host.stop()
    (again,) = await team.up(other, "away", keeps=True)
    assert parked(again) == [("guest", 1, "RUN")]


def test_a_program_without_blocks_is_outdated():
    old, new, waits = (ProgramRecord(bytes([n]) * 32, b"") for n in range(3))
    copies = [
        CoordinatorRecord("guest", 1, "RUN", program=waits.digest, block=b"..."),
        CoordinatorRecord("guest", 2, "ABSENT"),
    ]
    found = JournalContents([old, new, waits, *copies], new.digest)
    assert found.outdated == [old]
    assert (found.parked, found.copies) == ([copies[0]], [copies[1]])


def test_declare_lost_ends_all_parked_starts_of_an_agent():
    """Two starts of two missions, and one whose number is used by a transfer that was refused."""
    own = Hello("host", "away", 9, b"n" * 32, b"n" * 32, 1000, journal_id=5)
    mobility = Mobility(own, peers=["home", "away"], agents=["guest"])
    agents = [("other", 1, b"a"), ("other", 2, b"b"), ("guest", 1, b"a"), ("third", 1, b"a")]
    mobility.restore(
        [], [CoordinatorRecord(*one, "RUN", program=of * 32, block=b"...") for *one, of in agents]
    )
    arrived = Transfer("guest", 1, 1, 1, b"n" * 32, 5, 3)
    (refusal,) = mobility.on_transfer("home", arrived, b"new", lambda *_: None)
    assert "has another start of guest under that number" in refusal.message.reason
    for agent, starts in (("guest", [1]), ("other", [1, 2])):
        ended, effects = mobility.declare_lost(agent, "by an operator")
        pages = [effect.record for effect in effects if isinstance(effect, PersistRecord)]
        assert ended == starts == [page.generation for page in pages]
        assert {(page.state, page.outcome, page.block) for page in pages} == {("EXITED", "lost", b"")}
        assert mobility.declare_lost(agent, "again")[0] == []
    assert [page.agent for page in mobility.parked] == ["third"]


def test_a_start_ended_while_parked_still_answers_that_it_arrived():
    """A sender that was down meanwhile asks again: it does not repeat actions that were done here."""
    own = Hello("host", "away", 9, b"n" * 32, b"n" * 32, 1000, journal_id=5)
    mobility = Mobility(own, peers=["home"], agents=["other"])
    mobility.restore([], [CoordinatorRecord("guest", 1, "RUN", 2, 2, program=b"a" * 32, block=b"...")])
    (page,) = (
        effect.record for effect in mobility.declare_lost("guest", "")[1] if isinstance(effect, PersistRecord)
    )
    assert (page.sequence, page.hops) == (2, 2)
    again = Mobility(own, peers=["home"], agents=["guest"])
    again.restore([page])
    answers = again.on_message("home", TransferQuery("guest", 1, 2, 5), 0.0)
    assert Send("home", TransferAccepted("guest", 1, 2)) in answers
