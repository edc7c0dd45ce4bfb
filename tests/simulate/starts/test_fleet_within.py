"""`within` limits its block, also if hosts cannot be reached. Whole hosts, in virtual time."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from lfield.host.inputs import PauseOrdered
from lfield.host.team.reachability import ANSWER_GRACE
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, copies

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal work(int number, real seconds) emit int {
        write("sets " + i2s(number) + "\\n");
        sleep(seconds);
        write("gives " + i2s(number) + "\\n");
        return 10 * number;
    }
    portal tidies(real seconds) {
        try { sleep(60.0); } catch (CancelledException e) { sleep(seconds); throw e; }
    }
    portal synchronized alone(real seconds) { sleep(seconds); }
}
coordinator Boss {
    init(string[] arg) {
        int[] got = new int[2];
        sleep(3.0);
        print("asks");
        string how = "came back";
        try {
            //body
        } catch (TimeLimitException e) { how = "time limit: " + e.message(); }
          catch (Exception e) { how = "else: " + e.message(); }
        print("boss: " + how);
        sleep(100.0);
    }
}
"""
BOTH = """within (4.0) { together {
                got[0] = findPost("one").work(1, ONE);
                got[1] = findPost("two").work(2, TWO);
            } }"""
WORKS_TWICE = 'within (4.0) { findPost("one").work(1, 0.5); findPost("two").work(2, 20.0); }'
TEAM = "//Post:zero@alpha\n//Post:one@bravo\n//Post:two@carol\n//Boss:boss@alpha\n"

Event = Callable[[Fleet], None]


def slow(seconds: float) -> Event:
    """Set the latency of all messages between hosts."""

    def apply(fleet: Fleet) -> None:
        for one in fleet.machines:
            for other in fleet.machines:
                fleet.network.paths.slow[one, other] = seconds, seconds

    return apply


def isolate(host: str, *, quietly: bool = False) -> Event:
    """Cut a host off; with `quietly` its links stay open."""

    def apply(fleet: Fleet) -> None:
        for other in fleet.machines:
            if other != host and quietly:
                fleet.network.silence(host, other)
                fleet.network.silence(other, host)
            elif other != host:
                fleet.cut(host, other)

    return apply


def process(host: str, *, frozen: bool) -> Event:
    """Suspend or kill the process of a host."""

    def apply(fleet: Fleet) -> None:
        if frozen:
            fleet.runs[host].process.loop.freeze()
        else:
            fleet.crash(host)

    return apply


def cut_outgoing(host: str) -> Event:
    """Drop all packets from a host, but not those to it."""

    def apply(fleet: Fleet) -> None:
        for other in fleet.machines:
            fleet.network.silence(host, other)

    return apply


def cut_incoming(host: str) -> Event:
    """Drop all packets to a host, but not those from it."""

    def apply(fleet: Fleet) -> None:
        for other in fleet.machines:
            fleet.network.silence(other, host)

    return apply


def ends(
    folder: Path, body: str, script: dict[float, Event], within: float = 60.0, transit: float = 0.0
) -> tuple[float, str]:
    """The seconds until the end of the block, and its outcome; events are by seconds since its start."""
    (folder / "mission.L").write_text(PROGRAM.replace("//body", body))
    (folder / "mission.dL").write_text(TEAM)
    fleet = Fleet(load_mission(folder / "mission.dL", simulate=True), 1)
    if transit:
        slow(transit)(fleet)
    fleet.run(1.0)
    while not (asked_at := [at for at, _, text in fleet.log if "boss: asks" in text]):
        fleet.run(0.01)
        # Events before the block happen when the coordinator has just been started.
        for at in [at for at in script if at < 0]:
            script.pop(at)(fleet)
    try:
        while fleet.now < asked_at[0] + within:
            for at in [at for at in script if fleet.now - asked_at[0] >= at]:
                script.pop(at)(fleet)
            fleet.run(0.02)
            assert all(len(hosts) == 1 for hosts in copies(fleet).values()), "two copies run"
            for at, _, text in fleet.log:
                if "boss: boss: " in text:
                    assert sum("sets 1" in line for _, _, line in fleet.log) <= 1
                    return at - asked_at[0], text.split("boss: boss: ")[1].strip()
    finally:
        fleet.close()
    return within, "it has not ended"


def of(one: float, two: float) -> str:
    return BOTH.replace("ONE", str(one)).replace("TWO", str(two))


@pytest.mark.few(8)
@pytest.mark.parametrize(
    ("body", "script"),
    [
        # Both calls run, and the host of one is cut off: at the start, in the middle, at the very end.
        (of(20.0, 20.0), {0.5: isolate("bravo")}),
        (of(20.0, 20.0), {3.9: isolate("bravo")}),
        (of(0.5, 20.0), {1.0: isolate("bravo")}),
        (of(20.0, 0.5), {0.2: isolate("bravo")}),
        # It cannot be reached from the beginning, or its link is silent without notice.
        (of(0.5, 0.5), {-1.0: isolate("carol")}),
        (of(0.5, 0.5), {-1.0: isolate("bravo")}),
        (of(20.0, 20.0), {1.5: isolate("bravo", quietly=True)}),
        (of(20.0, 20.0), {1.0: process("bravo", frozen=True)}),
        (of(20.0, 20.0), {1.0: process("bravo", frozen=False)}),
        ('within (4.0) { findPost("one").work(1, 0.5); }', {-1.0: isolate("bravo", quietly=True)}),
        ('within (4.0) { findPost("one").work(1, 0.5); }', {-1.0: process("bravo", frozen=True)}),
        ('within (4.0) { reserve (findPost("one")) { sleep(1.0); } }', {-1.0: process("bravo", frozen=True)}),
        (WORKS_TWICE, {0.3: isolate("carol", quietly=True)}),
        # Nested blocks: the earlier end is effective, and no inner catch catches it.
        (f"within (30.0) {{ {of(20.0, 20.0)} }}", {0.5: isolate("bravo")}),
        (of(20.0, 20.0).replace("4.0", "30.0").join(("within (4.0) { ", " }")), {0.5: isolate("bravo")}),
        # Waits for another host.
        ('within (4.0) { findPost("one").work(1, 0.5); }', {-1.0: isolate("bravo")}),
        ('within (4.0) { reserve (findPost("one")) { sleep(1.0); } }', {-1.0: isolate("bravo")}),
        ("within (4.0) { sleep(60.0); }", {}),
        ('within (4.0) { findPost("zero").alone(60.0); }', {}),
        ("within (4.0) { while (true) { findPost(); yield(); } }", {}),
    ],
)
def test_a_block_ends_in_time_although_a_host_cannot_be_reached(
    tmp_path: Path, body: str, script: dict[float, Event]
) -> None:
    seconds, how = ends(tmp_path, body, dict(script))
    # The clocks of the hosts differ by a hundredth at most.
    assert seconds == pytest.approx(4.0, abs=0.1), how
    assert how.startswith("time limit: the time is over"), how
    assert "late" not in how


@pytest.mark.parametrize(
    "script",
    [
        {3.4: isolate("bravo", quietly=True)},
        # A host with a contact just before the end is also asked when the time is over.
        {3.88: isolate("bravo", quietly=True)},
        {3.94: isolate("bravo", quietly=True)},
        {3.99: isolate("bravo", quietly=True)},
        {3.96: isolate("carol", quietly=True)},
        # The coordinator is then on the isolated host.
        {3.0: isolate("carol", quietly=True)},
        {3.0: cut_outgoing("bravo")},
        {1.0: cut_incoming("bravo")},
        {3.0: process("bravo", frozen=True)},
        {3.0: lambda fleet: fleet.power_off("bravo")},
    ],
)
def test_a_link_that_becomes_silent_just_before_the_end_costs_one_sign_of_life(
    tmp_path: Path, script: dict[float, Event]
) -> None:
    """The coordinator is not sent over the silent link, where it would stay in doubt."""
    seconds, how = ends(tmp_path, of(20.0, 20.0), dict(script))
    assert seconds == pytest.approx(4.0 + ANSWER_GRACE, abs=0.1), how
    assert how.startswith("time limit: the time is over; one.work() was not reached"), how
    assert how.endswith("; the block ends 0.3 s late: it waited for its calls and their hosts"), how


def test_several_silent_hosts_cost_one_sign_of_life_together(tmp_path: Path) -> None:
    last = 'got[1] = findPost("two").work(2, 20.0);'
    body = of(20.0, 20.0).replace(last, f'{last} findPost("zero").work(3, 20.0);')
    # The call on carol was started last, so the coordinator is there.
    seconds, how = ends(tmp_path, body, {3.5: isolate("carol", quietly=True)})
    assert seconds == pytest.approx(4.0 + ANSWER_GRACE, abs=0.1), how
    assert how.count("was not reached") == 2, how


def test_an_exception_out_of_together_is_limited_by_the_enclosing_block(tmp_path: Path) -> None:
    body = """within (4.0) { together {
                got[0] = findPost("one").work(1, 20.0);
                sleep(1.0);
                got[1] = findPost("two").work(2, 20.0);
                findPost("zero").work(7 / (got.length() - 2), 1.0);
            } }"""
    seconds, how = ends(tmp_path, body, {0.5: isolate("bravo")})
    assert seconds < 4.1, how
    assert how.startswith(("else: division by zero", "time limit: "))


def test_a_copy_in_doubt_stays_and_the_exception_names_the_delay(tmp_path: Path) -> None:
    """The copy has been sent when the links become silent: nothing is repeated, and nothing is undone."""
    body = 'within (4.0) { findPost("two").work(2, 0.5); }'
    seconds, how = ends(
        tmp_path, body, {0.0: isolate("carol", quietly=True), 12.0: lambda fleet: fleet.heal_all()}
    )
    assert seconds > 12.0
    late = re.match(r"time limit: the time is over, ([0-9.]+) s late(.*)", how)
    assert late is not None, how
    assert float(late[1]) == pytest.approx(seconds - 4.0, abs=0.2)
    assert late[2].startswith((" since it was sent to carol", " since it was on its way", ": "))


def test_a_slow_cancellation_delays_the_block_and_is_reported(tmp_path: Path) -> None:
    seconds, how = ends(tmp_path, 'within (4.0) { findPost("zero").tidies(2.0); }', {})
    assert seconds == pytest.approx(6.0, abs=0.1)
    assert how == (
        "time limit: the time is over; zero.tidies() was cancelled, 2.0 s late: it took that long to end"
    )
    together = 'within (4.0) { together { findPost("one").tidies(2.0); findPost("two").tidies(1.0); } }'
    seconds, how = ends(tmp_path, together, {})
    assert seconds == pytest.approx(6.0, abs=0.2)
    assert re.search(
        r"; the block ends (1\.9|2\.[01]) s late: it waited for its calls and their hosts$", how
    ), how


def test_a_finally_block_is_not_interrupted_and_its_delay_is_reported(tmp_path: Path) -> None:
    body = "within (4.0) { try { sleep(3.0); } finally { sleep(3.0); } sleep(60.0); }"
    seconds, how = ends(tmp_path, body, {})
    assert seconds == pytest.approx(6.0, abs=0.1)
    reason = "since a running finally is not interrupted"
    assert re.match(rf"time limit: the time is over, (1\.9|2\.[01]) s late {reason}", how), how


def paused(host: str, *, on: bool) -> Event:
    """Pause or resume the mission at a host."""

    def apply(fleet: Fleet) -> None:
        life = fleet.runs[host]
        life.process.loop.enter(lambda: life.host.dispatch(PauseOrdered(on)))

    return apply


@pytest.mark.parametrize(
    ("body", "script"),
    [
        ("within (4.0) { sleep(20.0); }", {1.0: paused("alpha", on=True), 10.0: paused("alpha", on=False)}),
        (of(20.0, 20.0), {1.0: process("carol", frozen=True), 10.0: lambda fleet: fleet.heal_all()}),
    ],
)
def test_a_paused_or_suspended_host_delays_the_block_and_is_reported(
    tmp_path: Path, body: str, script: dict[float, Event]
) -> None:
    seconds, how = ends(tmp_path, body, dict(script))
    late = re.match(
        r"time limit: the time is over, ([0-9.]+) s late since its host was paused or suspended", how
    )
    assert late is not None, how
    assert float(late[1]) == pytest.approx(seconds - 4.0, abs=0.2)


def test_a_paused_remote_host_does_not_delay_a_block(tmp_path: Path) -> None:
    seconds, how = ends(tmp_path, of(20.0, 20.0), {1.0: paused("bravo", on=True)})
    assert seconds == pytest.approx(4.0, abs=0.1), how


@pytest.mark.parametrize(
    "body",
    [
        'within (4.0) { findPost("one").work(1, 20.0); }',
        'within (4.0) { findPost("one").work(1, 0.5); findPost("two").work(2, 20.0); }',
        'within (4.0) { findPost("one").work(1, 0.1); findPost("zero").work(2, 20.0); }',
        of(20.0, 20.0),
        'within (4.0) { reserve (findPost("one")) { sleep(20.0); } }',
    ],
)
def test_the_time_between_hosts_counts(tmp_path: Path, body: str) -> None:
    """0.5 s in each direction, which heartbeats have measured before the block begins."""
    seconds, how = ends(tmp_path, body, {}, transit=0.5)
    assert how.startswith("time limit: the time is over"), how
    late = re.search(r"([0-9.]+) s late", how)
    assert seconds - 4.0 - (float(late[1]) if late else 0.0) == pytest.approx(0.0, abs=0.15), how


@pytest.mark.parametrize("seconds", [0.3, 1.2])
def test_a_hop_that_would_arrive_too_late_is_not_begun(tmp_path: Path, seconds: float) -> None:
    """The coordinator stays, and the block ends in time; the exception names the reason. A query comes
    first."""
    body = f'within ({seconds}) {{ sleep({max(0.0, seconds - 0.3)}); findPost("one").work(1, 20.0); }}'
    elapsed, how = ends(tmp_path, body, {}, transit=0.5)
    assert elapsed == pytest.approx(seconds, abs=0.05), how
    assert re.search(
        r"the time is over before one\.work\(\) could begin: the transfer to bravo takes [01]\.[0-9] s", how
    ), how
    assert "late" not in how
