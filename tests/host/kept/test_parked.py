"""A coordinator of another mission waits, wherever it is kept: nobody begins it anew or writes over it."""

from __future__ import annotations

from lfield.host.team.keeping import Recovery
from lfield.journal.pages import CopyPage, ProgramPage

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


def test_a_home_with_a_new_disk_does_not_begin_what_is_parked_elsewhere(fleet):
    async def story(team):
        await park_at_away(team)
        del team.disks["home"]
        home, away = await team.up(team.mission(CHANGED, FROM_HOME), keeps=True)
        await team.until(
            lambda: (
                "guest is parked on away for the program and deployment that it belongs to: not started again"
                in home.log
            )
        )
        assert not home.holds("guest")
        assert parked(away) == [("guest", 1, "RUN")]
        await home.host.stop()
        await away.host.stop()
        _, away = await team.up(team.mission(PROGRAM, FROM_HOME), keeps=True)
        await team.until(lambda: "guest goes on where it was kept" in away.log)

    fleet(story)


def test_a_home_that_was_changed_does_not_begin_it_either(fleet):
    async def story(team):
        home, away = await team.up(team.mission(PROGRAM, FROM_AWAY), "home", "away", keeps=True)
        await team.until(lambda: away.output)
        await away.host.stop()
        await home.host.stop()
        home, away = await team.up(team.mission(PROGRAM, FROM_HOME), keeps=True)
        await team.until(lambda: "guest is parked on away" in home.log)
        assert not home.holds("guest")
        assert parked(away) == [("guest", 1, "RUN")]

    fleet(story)


def test_its_number_is_not_given_out_again(fleet):
    """A person says that there was no earlier start: what comes is not taken, and nothing is lost."""

    async def story(team):
        await park_at_away(team)
        other = team.mission(CHANGED, FROM_HOME)
        del team.disks["home"]
        home, away = (team.make(other, name, keeps=True) for name in ("home", "away"))
        home.host.options.first_start = True
        await home.host.start()
        await team.until(lambda: home.holds("guest"))
        await away.host.start()
        await team.until(lambda: "keeps another start of guest under that number" in home.log)
        assert parked(away) == [("guest", 1, "RUN")]
        await away.host.stop()
        (again,) = await team.up(other, "away", keeps=True)
        assert parked(again) == [("guest", 1, "RUN")]

    fleet(story)


def test_a_program_of_which_no_block_is_left_is_not_kept():
    old, new, waits = (ProgramPage(bytes([n]) * 32, b"") for n in range(3))
    copies = [CopyPage("guest", 1, "RUN", program=waits.digest, block=b"..."), CopyPage("guest", 2, "ABSENT")]
    found = Recovery([old, new, waits, *copies], new.digest)
    assert found.outdated == [old]
    assert (found.parked, found.copies) == ([copies[0]], [copies[1]])
