"""Concurrent calls, and hosts that crash, are cut off or paused meanwhile. In virtual time."""

from __future__ import annotations

from pathlib import Path
from secrets import token_bytes

import pytest

from lfield.journal.records import PendingCallRecord
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, HostRun
from lfield.testing.mission_operator import OperatorLink
from lfield.wire.observer_messages import EmergencyStop, Pause, with_epoch

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal work(int number, real seconds) emit int {
        write("sets " + i2s(number) + "\\n");
        try { sleep(seconds); }
        catch (CancelledException e) { write("leaves " + i2s(number) + ": " + e.message() + "\\n"); throw e; }
        write("gives " + i2s(number) + "\\n");
        return 10 * number;
    }
}
coordinator Boss {
    init(string[] arg) {
        int[] got = new int[2];
        string how = "came back";
        try {
            //body
        } catch (RestartException e) { how = "restarted at " + e.source() + ": " + e.message(); }
          catch (TimeLimitException e) { how = "late"; }
          catch (UnreachableResourceException e) { how = "unreachable"; }
        print("boss: " + how + " " + i2s(got[0]) + " " + i2s(got[1]));
        sleep(s2f(arg[1]));
    }
}
"""
BOTH = """
            together {{
                got[0] = findPost("one").work(1, {0});
                got[1] = findPost("two").work(2, {1});
            }}
"""
#: The boss starts at bravo, then goes to carol, where it stays until the end.
DEPLOYMENT = "//Post:zero@alpha\n//Post:one@bravo\n//Post:two@carol\n//Boss:boss@alpha?{0}\n"


class Team(Fleet):
    """Three hosts, two of which execute calls."""

    def __init__(
        self,
        folder: Path,
        one: float = 0.0,
        two: float = 0.0,
        body: str = BOTH,
        rest: float = 100.0,
        text: str = PROGRAM,
    ) -> None:
        program = text.replace("//body", body.format(one, two))
        (folder / "mission.L").write_text(program)
        (folder / "mission.dL").write_text(DEPLOYMENT.format(rest))
        super().__init__(load_mission(folder / "mission.dL", simulate=True), 1)

    def count_logged(self, text: str, host: str = "") -> int:
        """The number of log lines with a text."""
        return sum(text in line and host in ("", name) for _, name, line in self.log)

    def until(self, text: str) -> None:
        """Run until a text is logged."""
        end = self.now + 60.0
        while not self.count_logged(text):
            assert self.now < end, f"{text!r} was not logged"
            self.run(0.05)

    def again(self, host: str) -> None:
        """Crash a host and restart it immediately."""
        self.crash(host)
        self.boot(host)
        self.run(3.0)

    def begun(self, host: str) -> list[str]:
        """The outcomes in the records of calls on the disk of a host."""
        return [page.outcome for page in self.disks[host].records() if isinstance(page, PendingCallRecord)]


def test_begun_calls_are_stored_and_deleted_after_their_results_were_fetched(tmp_path: Path) -> None:
    team = Team(tmp_path, 0.5, 2.0)
    team.until("sets 2")
    assert team.begun("bravo") == team.begun("carol") == [""]
    team.until("gives 1")
    team.run(0.1)
    assert team.begun("bravo") == ["done"]
    team.until("boss: came back 10 20")
    # The last host keeps its result until the block with it is stored: here, when the boss has ended.
    assert team.begun("carol") == ["done"] or team.begun("bravo") == ["done"]
    team = Team(tmp_path, 0.5, 2.0, rest=0.0)
    team.until("boss: came back 10 20")
    team.run(3.0)
    assert team.begun("bravo") == team.begun("carol") == []


@pytest.mark.parametrize("times", [1, 2])
def test_a_crash_between_begin_and_fetch_is_reported_and_nothing_begins_twice(
    tmp_path: Path, times: int
) -> None:
    team = Team(tmp_path, 8.0, 12.0)
    team.until("sets 2")
    for _ in range(times):
        team.again("bravo")
    team.until("boss: restarted at one")
    assert team.count_logged("its host restarted while one.work() ran; it may have been executed")
    assert team.count_logged("sets 1") == team.count_logged("sets 2") == 1
    assert team.count_logged("gives 2") == 1


@pytest.mark.parametrize("times", [1, 2])
def test_a_crash_between_result_and_fetch_keeps_the_result(tmp_path: Path, times: int) -> None:
    team = Team(tmp_path, 1.0, 12.0)
    team.until("gives 1")
    team.run(0.1)
    for _ in range(times):
        team.again("bravo")
    team.until("boss: came back 10 20")
    assert team.count_logged("sets 1") == team.count_logged("sets 2") == 1


def test_after_a_crash_the_waiting_boss_fetches_the_other_results(tmp_path: Path) -> None:
    team = Team(tmp_path, 1.0, 12.0)
    team.until("gives 1")
    team.run(0.1)
    team.again("carol")
    # The boss was there only to fetch: none of its actions is unknown, but the call was lost.
    team.until("boss: restarted at two")
    assert team.count_logged("boss resumed from the journal", "carol") == 1
    assert team.count_logged("sets 1") == team.count_logged("sets 2") == 1


def test_a_boss_recovered_where_it_began_calls_is_informed_again_after_a_restart(
    tmp_path: Path,
) -> None:
    """The actions of an earlier start after it had left are still unknown: it must not just continue."""
    team = Team(tmp_path, 1.0, 8.0, "heartbeatInterval(1.0);" + BOTH)
    team.until("sets 2")
    team.crash("carol")
    team.until("boss recovered on this host")
    team.until("boss: restarted at")
    team.again("bravo")
    team.boot("carol")
    team.run(20.0)
    assert team.count_logged("boss: restarted at", "bravo") == 2
    assert team.count_logged("sets 1") == team.count_logged("sets 2") == 1


def test_a_boss_that_ends_leaves_no_call_running_also_on_an_unreachable_host(tmp_path: Path) -> None:
    team = Team(tmp_path, 40.0, 1.0, rest=0.0)
    team.until("sets 2")
    team.cut("bravo", "carol")
    team.cut("bravo", "alpha")
    team.until("gives 2")
    team.run(1.0)
    assert "fetches from bravo" in [agent.state for agent in team.runs["carol"].host.status().agents]
    (pending_call,) = team.runs["bravo"].host.status().pending_calls
    assert (pending_call.agent, pending_call.resource, pending_call.portal, pending_call.state) == (
        "boss",
        "one",
        "work",
        "running",
    )
    team.until("boss: unreachable 0 0")
    team.run(5.0)
    assert team.count_logged("leaves 1") == 0
    team.heal("bravo", "carol")
    team.heal("bravo", "alpha")
    team.until("leaves 1: boss has ended (done)")
    assert team.count_logged("gives 1") == 0
    team.run(3.0)
    assert team.begun("bravo") == []


def test_a_time_limit_ends_a_call_on_an_unreachable_host(tmp_path: Path) -> None:
    body = "within (5.0) {{" + BOTH + "}}"
    team = Team(tmp_path, 40.0, 1.0, body)
    team.until("sets 2")
    team.cut("bravo", "carol")
    team.cut("bravo", "alpha")
    started = team.now
    team.until("leaves 1: the time limit of boss is over")
    assert team.now < started + 5.5
    team.until("boss: late")
    # After the limit the boss hopped to cancel the call, with the usual wait for the host.
    assert team.now < started + 5.0 + 2 * 10.0 + 2.0


def test_a_limit_noticed_first_by_the_host_of_a_call_is_reported_as_one(tmp_path: Path) -> None:
    """The time in transit is not counted by a coordinator, so its clock is slightly behind."""
    team = Team(tmp_path, 40.0, 1.0, "within (3.0) {{" + BOTH + "}}")
    team.until("boss: ")
    assert team.count_logged("boss: late 0 0") == 1
    assert team.count_logged("leaves 1") == 1


def test_a_time_limit_includes_the_downtime_of_the_boss_host(tmp_path: Path) -> None:
    team = Team(tmp_path, 40.0, 40.0, "within (8.0) {{" + BOTH + "}}")
    team.until("sets 2")
    team.crash("carol")
    team.run(10.0)
    assert team.count_logged("leaves 1: the time limit of boss is over")
    team.boot("carol")
    started = team.now
    team.until("boss: ")
    assert team.count_logged("boss: late")
    assert team.now < started + 4.0


def order(life: HostRun, *, lift: bool) -> EmergencyStop | Pause:
    return with_epoch(Pause(token_bytes(16), lift), life.core.orders.epochs)


def test_a_call_of_a_remote_boss_ends_when_its_host_is_paused(tmp_path: Path) -> None:
    team = Team(tmp_path, 6.0, 12.0)
    team.until("sets 2")

    def say(*, lift: bool) -> None:
        life = team.runs["bravo"]
        life.process.loop.enter(lambda: life.host.on_message("", order(life, lift=lift), OperatorLink()))

    say(lift=False)
    team.run(2.0)
    assert team.begun("bravo") == ["thrown"]
    say(lift=True)
    team.until("boss: restarted at one: the mission was paused; this call may have begun")
    assert team.count_logged("sets 1") == 1


LEASED = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal climb() {
        fc.release();
        for (int n = 1; n < 200; n = n + 1) { fc.takeoff(1.0 * n); sleep(0.2); }
    }
    portal rest(real seconds) { print("rests"); sleep(seconds); }
}
coordinator Boss {
    init(string[] arg) {
        heartbeatInterval(100.0);
        try { together { findPost("one").climb(); findPost("two").rest(20.0); } }
        catch (RestartException e) { print("told: " + e.message()); }
        sleep(100.0);
    }
}
"""


def test_a_device_used_for_a_remote_boss_is_safe_when_the_lease_of_its_host_ends(
    tmp_path: Path,
) -> None:
    team = Team(tmp_path, text=LEASED)
    team.until("rests")
    team.run(1.0)
    for host in ("alpha", "carol"):
        team.cut("bravo", host)
    team.run(4.0)
    device = next(d for d in team.runs["bravo"].host.status().devices if d.name == "one.fc")
    assert "the lease of bravo has ended" in device.latched
    assert "it was used for boss" in device.latched
    assert team.begun("bravo") == ["thrown"]
    climbs = [command.at for command in team.hardware["one.fc"].record if command.what == "takeoff"]
    assert len(climbs) > 1
    assert climbs[-1] < team.now - 1.0
    for host in ("alpha", "carol"):
        team.heal("bravo", host)
    team.until("told: the lease of bravo has ended")
