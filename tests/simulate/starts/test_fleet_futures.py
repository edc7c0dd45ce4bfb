"""Futures in a team whose hosts crash, are cut off, or restart. In virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest

from test_fleet_together import Team

#: The calls start on bravo and on carol, where the boss stays.
BEGIN = """
            future<int>[] calls = {{async findPost("one").work(1, {0}), async findPost("two").work(2, {1})}};
"""
BOTH = f"{BEGIN} for (int i = 0; i < 2; i += 1) got[i] = calls[i].await();"
RACE = f"{BEGIN} int first = calls.race(); got[first] = calls[first].await();"
NEXT = f"""{BEGIN}
            for (int i = calls.next(); i >= 0; i = calls.next()) {{{{
                print("ended " + i2s(i));
                try {{{{ got[i] = calls[i].await(); }}}} finally {{{{ calls[i] = null; }}}}
            }}}}
"""


def test_the_first_of_two_hosts_wins_and_the_other_call_is_cancelled(tmp_path: Path) -> None:
    team = Team(tmp_path, 2.0, 30.0, RACE)
    team.until("boss: came back 10 0")
    assert team.count_logged("sets 1") == team.count_logged("sets 2") == 1
    assert team.count_logged("leaves 2: boss has cancelled work()") == 1
    assert team.now < 15.0


def test_the_end_of_a_call_is_reported_although_the_link_was_down_at_that_time(tmp_path: Path) -> None:
    team = Team(tmp_path, 2.0, 30.0, RACE)
    team.until("sets 2")
    team.cut("bravo", "carol")
    team.cut("bravo", "alpha")
    team.until("gives 1")
    team.run(1.0)
    assert not team.count_logged("boss: ")
    team.heal("bravo", "carol")
    team.heal("bravo", "alpha")
    team.until("boss: came back 10 0")
    assert team.count_logged("sets 1") == team.count_logged("sets 2") == 1


def test_an_unreachable_host_loses_the_race(tmp_path: Path) -> None:
    team = Team(tmp_path, 2.0, 25.0, RACE)
    team.until("sets 2")
    team.cut("bravo", "carol")
    team.cut("bravo", "alpha")
    team.until("boss: came back 0 20")
    assert team.count_logged("gives 1") == 1


def test_an_unreachable_host_does_not_delay_the_winner(tmp_path: Path) -> None:
    """The call on bravo fails 10 s after the link was lost; the coordinator does not wait for it again."""
    team = Team(tmp_path, 60.0, 15.0, RACE)
    team.until("sets 2")
    team.cut("bravo", "carol")
    team.cut("bravo", "alpha")
    team.until("gives 2")
    team.run(0.5)
    assert team.count_logged("boss: came back 0 20") == 1


@pytest.mark.parametrize(("before", "is_cut"), [(0.5, True), (4.0, True), (1.0, False), (4.0, False)])
def test_an_unreachable_host_does_not_delay_the_cancellation_on_others(
    tmp_path: Path, before: float, is_cut: bool
) -> None:
    """The first branch is on the unreachable host, and that of the winner on the host of the coordinator."""
    body = """
            future<int>[] calls = {{async findPost("one").work(1, 60.0), async findPost("two").work(2, 60.0),
                async findPost("zero").work(3, {0})}};
            calls.race();
"""
    team = Team(tmp_path, before, body=body)
    team.until("sets 3")
    if is_cut:
        team.cut("bravo", "carol")
        team.cut("bravo", "alpha")
    else:
        team.power_off("bravo")
    team.until("gives 3")
    team.run(0.5)
    assert team.count_logged("leaves 2: boss has cancelled work()") == 1


@pytest.mark.parametrize("times", [1, 2])
def test_a_call_on_a_crashed_host_is_lost_and_not_begun_twice(tmp_path: Path, times: int) -> None:
    team = Team(tmp_path, 8.0, 12.0, NEXT)
    team.until("sets 2")
    for _ in range(times):
        team.again("bravo")
    team.until("boss: restarted at one")
    assert team.count_logged("ended 0")
    assert team.count_logged("its host restarted while one.work() ran; it may have been executed")
    assert team.count_logged("sets 1") == team.count_logged("sets 2") == 1


def test_a_stored_result_survives_a_crash_of_its_host(tmp_path: Path) -> None:
    team = Team(
        tmp_path, 1.0, 6.0, f"{BEGIN} sleep(8.0); got[1] = calls[1].await(); got[0] = calls[0].await();"
    )
    team.until("gives 1")
    team.run(0.1)
    assert team.begun("bravo") == ["done"]
    team.again("bravo")
    team.until("boss: came back 10 20")
    assert team.count_logged("sets 1") == team.count_logged("sets 2") == 1


def test_a_crash_of_the_waiting_host_does_not_repeat_open_futures(tmp_path: Path) -> None:
    body = """
            future<int> one = null;
            try {{
                one = async findPost("one").work(1, {0});
                future<int> two = async findPost("two").work(2, {1});
                got[1] = two.await();
            }} catch (RestartException e) {{ print("told at " + e.source()); }}
            got[0] = one.await();
"""
    team = Team(tmp_path, 9.0, 30.0, body)
    team.until("sets 2")
    team.again("carol")
    team.until("told at two")
    team.until("boss: came back 10 0")
    assert team.count_logged("sets 1") == team.count_logged("sets 2") == 1


def test_a_recovered_coordinator_may_not_fetch_calls_of_its_earlier_start(
    tmp_path: Path,
) -> None:
    body = f"heartbeatInterval(1.0); {BEGIN} got[1] = calls[1].await(); got[0] = calls[0].await();"
    team = Team(tmp_path, 30.0, 30.0, body)
    team.until("sets 2")
    team.run(1.0)
    team.crash("carol")
    team.until("boss recovered on this host")
    team.until("boss: restarted at")
    assert team.count_logged("sets 1") == team.count_logged("sets 2") == 1
    team.run(5.0)
    assert team.count_logged("leaves 1") == 1


def test_a_coordinator_that_ends_leaves_no_call_running(tmp_path: Path) -> None:
    team = Team(tmp_path, 40.0, 1.0, f"{BEGIN} got[1] = calls[1].await();", rest=0.0)
    team.until("boss: came back 0 20")
    team.until("leaves 1: boss has ended (done)")
    team.run(3.0)
    assert team.begun("bravo") == team.begun("carol") == []


def test_a_limit_around_a_race_ends_it_and_cancels_its_calls(tmp_path: Path) -> None:
    team = Team(tmp_path, 30.0, 30.0, "within (4.0) {{" + RACE + "}}")
    team.until("boss: late 0 0")
    team.run(1.0)
    assert team.count_logged("leaves 1") == team.count_logged("leaves 2") == 1
