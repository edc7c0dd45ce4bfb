"""`lfield ps`: the coordinators in a journal, and the state of the journal."""

from __future__ import annotations

import io

from rich.console import Console
from scripted_snapshots import states_of

from lfield.cli.views.team_status_view import team_tables
from lfield.client.status_json import status_data
from lfield.journal.records import ProgramRecord

PROGRAM = """
resource Post {
    int calls;
    init(string[] arg) { }
    portal stay(real seconds) { calls = calls + 1; write("call\\n"); sleep(seconds); }
}
coordinator Guest {
    init(string[] arg) {
        while (true) {
            try { findPost(arg[1]).stay(1.0); } catch (LimitException full) { sleep(0.5); }
        }
    }
}
"""
LATER = PROGRAM.replace("while (true)", "sleep(5.0);")
TWO_HOSTS = "//Guest:guest@home?post\n//Post:post@away\n"
DEPLOYMENT = "//Guest:guest@home?post\n//Post:post@home\n"


def shown(*hosts) -> str:
    out = io.StringIO()
    Console(file=out, width=240).print(
        team_tables(states_of({running.host.name: running.host.status() for running in hosts}))
    )
    return out.getvalue()


async def test_the_status_shows_the_journal_and_its_errors(team, /):
    (home,) = await team.up(team.mission(PROGRAM, DEPLOYMENT), keeps=True)
    await team.until(lambda: len(home.output) == 3)
    journal = home.host.status().journal
    assert journal.commits >= 3
    assert (journal.trouble, journal.parked) == ("", [])
    assert "in the last minute" in shown(home)


async def test_a_coordinator_waits_for_a_failing_disk(team, /):
    home, away = await team.up(team.mission(LATER, TWO_HOSTS), keeps=True)
    team.disks["home"].broken = True
    await team.until(lambda: home.host.status().journal.trouble)
    (agent,) = home.host.status().agents
    assert (agent.id, agent.state) == ("guest", "waits for its disk")
    assert "failing: " in shown(home)
    assert "its disk fails" in shown(home)
    team.disks["home"].broken = False
    await team.until(lambda: away.output == ["call"])
    assert home.host.status().journal.trouble == ""


async def test_a_coordinator_does_not_leave_while_it_is_persisted(team, /):
    home = team.make(team.mission(PROGRAM, DEPLOYMENT), "home", keeps=True)
    team.disks["home"].sync = 0.5
    await home.host.start()
    states = set()

    def has_output() -> bool:
        states.update(agent.state for agent in home.host.status().agents if agent.id == "guest")
        return len(home.output) == 3

    await team.until(has_output)
    assert "persisting" in states
    assert "leaving" not in states


async def test_a_coordinator_of_another_program_is_parked_and_explained(team, /):
    mission = team.mission(PROGRAM, DEPLOYMENT)
    (home,) = await team.up(mission, keeps=True)
    await team.until(lambda: len(home.output) == 2)
    await home.host.stop()
    (again,) = await team.up(
        team.mission(PROGRAM + "\n// another\nclass Other { }\n", DEPLOYMENT), keeps=True
    )
    digest = home.host.hello().mission_hash
    (parked,) = again.host.status().journal.parked
    assert (parked.agent, parked.generation, parked.program) == ("guest", 1, digest)
    assert f"parked: belongs to another mission ({digest.hex()[:16]})" in shown(again)
    assert (
        status_data(states_of({"home": again.host.status()}))["home"]["journal"]["parked"][0]["id"] == "guest"
    )
    pages = again.host.journal_writer.records
    (explained,) = (page for page in pages if isinstance(page, ProgramRecord))
    assert (explained.digest, explained.members) == (digest, ("guest", "post"))


async def test_an_unstored_revocation_list_is_shown(team, /):
    (home,) = await team.up(team.mission(PROGRAM, DEPLOYMENT))
    assert "failing" not in shown(home)
    home.host.options.admission.persist_error = "revocation list 3 is not kept: the disk is full"
    assert "home is failing: revocation list 3 is not kept: the disk is full" in shown(home)
    assert status_data(states_of({"home": home.host.status()}))["home"]["unkept"].startswith(
        "revocation list 3"
    )


async def test_a_host_without_a_journal_is_shown_as_not_saved(team, /):
    (home,) = await team.up(team.mission(PROGRAM, DEPLOYMENT))
    assert home.host.status().journal is None
    assert "not saved" in shown(home)


async def test_ends_of_earlier_starts_are_shown_once(team, /):
    mission = team.mission("coordinator Guest { init(string[] arg) { } }", "//Guest:guest@home\n")
    for run in range(1, 4):
        (home,) = await team.up(mission, keeps=True)
        await team.until(lambda host=home.host, run=run: len(host.status().coordinators) == run)
        await home.host.stop()
    assert [known.outcome for known in home.host.status().coordinators] == ["done"] * 3
    assert shown(home).count("done") == 1
