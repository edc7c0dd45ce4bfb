"""Missions in virtual time with the real drivers and fakes of the examples, and the actions of tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.errors import MissionTestError, Stuck
from lfield.testing.mission.mission_team import MissionTeam

EXAMPLES = Path(__file__).parents[2] / "examples"
FLIGHT = EXAMPLES / "01-first-flight" / "mission.dL"

WALK = """
resource Post {
    init(string[] arg) { }
    portal work(real seconds) { print("works"); sleep(seconds); }
    portal never() { while (true) sleep(1.0); }
}
coordinator Boss {
    init(string[] arg) {
        findPost("one").work(1.0);
        findPost("two").work(2.0);
        //more
        print("over");
    }
}
"""
HOSTS = "//Post:one@alpha\n//Post:two@bravo\n//Boss:boss@alpha\n"


@pytest.fixture
def walk(tmp_path, lfield_mission):
    """Makes a team of two hosts without devices; `more` is the end of its coordinator's program."""

    def made(more: str = "", **options: object) -> MissionTeam:
        (tmp_path / "walk.L").write_text(WALK.replace("//more", more))
        (tmp_path / "walk.dL").write_text(HOSTS)
        return lfield_mission(tmp_path / "walk.dL", **options)

    return made


def test_two_copters_fly_with_the_real_driver_and_fake(lfield_mission):
    team = lfield_mission(FLIGHT)
    team.run(until="taking off")
    team.run(9.0)
    assert team.fake("lead.fc").facts["airborne"] is True
    team.run(until_done=True)
    assert team.ended == {"pilot": "done"}
    assert len(team.hops) == 11
    assert [hop.agent for hop in team.hops] == ["pilot"] * 11
    assert 1.9 < max(point.up for point in team.tracks["lead.fc"]) < 2.3
    assert team.fake("lead.fc").facts["airborne"] is False
    assert team.has_moved


def test_a_closed_team_keeps_no_task_of_a_host_or_a_simulated_device(lfield_mission):
    """Pinned tasks would stay in memory until the end of all tests."""
    team = lfield_mission(FLIGHT)
    team.run(1.0)
    machines = {*team._fleet.machines.values(), *(computer.machine for computer in team._fleet.stations)}
    assert {"alpha", "bravo", "lead.fc", "wing.fc"} <= {machine.name for machine in machines}
    assert all(machine.pinned for machine in machines)
    team.close()
    assert not any(machine.pinned for machine in machines)


@pytest.mark.few(0)
def test_the_same_seed_gives_the_same_flight_and_another_does_not(lfield_mission):
    observed = []
    for seed in (3, 3, 4):
        team = lfield_mission(FLIGHT, seed=seed)
        team.run(until_done=True)
        observed.append((team.log, team.tracks))
    assert observed[0] == observed[1]
    assert observed[0][0] != observed[2][0]


@pytest.mark.few(0)
def test_a_failed_motor_and_an_empty_battery_are_reported_by_the_driver(lfield_mission):
    team = lfield_mission(FLIGHT, fakes={"wing.fc": ["battery=0.5"]})
    team.at(15.0, lambda: team.fake("lead.fc").set("motor_failure=true"))
    team.run(until_done=True)
    assert team.said("Potential Thrust Loss", "alpha")
    assert team.said("ended early: the autopilot says: Potential Thrust Loss")
    assert team.said("wing 47 %") or team.said("wing 48 %")
    assert [mark.device for mark in team.marks] == ["lead.fc"]


def test_simulated_computers_know_the_time_of_day_from_the_start(walk):
    team = walk()
    team.run(until_done=True)
    assert team.said("works") == 2
    # Otherwise the events of the hosts could not be ordered.
    assert team.said("system clock set") == team.said("event timestamps") == 0


def test_links_are_cut_and_hosts_killed_at_the_times_of_the_test(walk):
    team = walk()
    team.at(0.5, lambda: team.cut("alpha", "bravo"))
    team.at(8.0, lambda: team.heal("alpha", "bravo"))
    team.run(until_done=True)
    assert team.now > 8.0
    assert team.ended == {"boss": "done"}
    team = walk()
    team.run(until=lambda: team.said("works") == 2)
    team.crash("bravo")
    team.run(2.0)
    assert team.ended == {}
    team.boot("bravo")
    team.run(until="RestartException")
    assert team.said("works") == 2


def test_an_action_at_a_line_of_l_runs_once(walk):
    team = walk('for (int n = 0; n < 3; n = n + 1) findPost("one").work(0.1);')
    times = []
    # The call of agent two, from the host of agent one, and later the start of each round.
    team.when("walk.L:10", lambda: times.append(team.now))
    team.when("walk.L:11", lambda: team.crash("bravo"))
    team.run(until=lambda: "bravo" not in team._fleet.runs)
    assert len(times) == 1
    assert times[0] > 1.0
    assert team.hops[-1].target == "bravo"


def test_an_action_at_a_line_runs_before_the_line(walk):
    """The rule holds for lines without waits: a field, an init, the middle of a method, a catch."""
    for line, last in (("walk.L:11", "works"), ("walk.L:12", "before")):
        team = walk('print("before"); int[] none = null;\nprint("after");')
        team.when(line, lambda team=team: team.crash("bravo"))
        team.run(30.0)
        assert team.said(last)
        assert not team.said({"works": "before", "before": "after"}[last])
        team.boot("bravo")


FIELDS = """
resource Post {
    int spare = 3;
    init(string[] arg) {
        print("begins");
    }
    portal work(int n) {
        try {
            print(12 / n);
        } catch (ArithmeticException e) { print("caught"); } finally { print("finally"); }
    }
}
coordinator Boss {
    init(string[] arg) {
        findPost("one").work(3);
        findPost("one").work(0);
    }
}
"""


@pytest.mark.parametrize(
    ("line", "said"),
    [(3, []), (5, []), (9, ["begins"]), (10, ["begins", "4"]), (16, ["begins", "4", "finally"])],
)
def test_lines_of_fields_init_and_finally_are_valid(tmp_path, lfield_mission, line, said):
    (tmp_path / "fields.L").write_text(FIELDS)
    (tmp_path / "fields.dL").write_text("//Post:one@alpha\n//Boss:boss@alpha\n")
    team = lfield_mission(tmp_path / "fields.dL")
    team.when(f"fields.L:{line}", lambda: team.crash("alpha"))
    team.run(30.0)
    words = ("begins", "4", "caught", "finally")
    assert [word for entry in team.log if (word := entry.text.rpartition(" ")[2]) in words] == said


@pytest.mark.parametrize("line", ["walk.L:1", "walk.L:900", "other.L:10", "walk.L", "10"])
def test_a_line_without_code_is_refused(walk, line):
    team = walk()
    with pytest.raises(MissionTestError, match="is not a line of the mission with code"):
        team.when(line, lambda: None)


def test_a_mission_that_does_not_end_reports_the_position_of_every_agent(walk):
    team = walk('findPost("two").never();')
    with pytest.raises(Stuck) as stuck:
        team.run(until_done=True, at_most=20.0)
    assert "the coordinators have not ended after 20 s" in str(stuck.value)
    assert "one on alpha: idle" in stuck.value.standing
    (boss,) = (line for line in stuck.value.standing if line.startswith("boss"))
    assert "boss on bravo: waits for two.never()" in boss
    assert "(walk.L:11)" in boss
    assert any("Post.never (walk.L:5)" in line for line in stuck.value.standing)


def test_a_wait_for_a_disconnected_host_names_its_call(walk):
    team = walk()
    team.run(until="works")
    team.cut("alpha", "bravo")
    with pytest.raises(Stuck, match=r"boss on alpha: leaving for two.work\(\) at Boss.init \(walk.L:10\)"):
        team.run(until_done=True, at_most=5.0)


def test_a_host_that_ends_by_itself_fails_the_test_with_its_log(lfield_mission, tmp_path):
    # A drive on a failed bus cannot be opened.
    team = lfield_mission(FLIGHT, fakes={"lead.fc": ["silence=true"]})
    with pytest.raises(Stuck, match="alpha has ended by itself") as stuck:
        team.run(until_done=True)
    assert any("alpha logged:" in line and "lead.fc" in line for line in stuck.value.standing)


def test_an_unknown_name_is_refused_with_the_known_ones(lfield_mission, walk):
    team = lfield_mission(FLIGHT)
    with pytest.raises(MissionTestError, match=r"there is no simulated device 'lead' .*lead.fc, wing.fc"):
        team.fake("lead")
    with pytest.raises(MissionTestError, match=r"lead.fc: there is no fault 'wings'"):
        team.fake("lead.fc").set("wings=off")
    with pytest.raises(MissionTestError, match=r"there is no host 'lead'; there are: alpha, bravo"):
        team.crash("lead")
    with pytest.raises(pytest.fail.Exception, match=r"there is no simulated device 'nobody.fc'"):
        walk(fakes={"nobody.fc": ["silence=true"]})
    with pytest.raises(pytest.fail.Exception, match=r"lead.fc: --fault: 'battery@lead.fc' is not a fault"):
        lfield_mission(FLIGHT, fakes={"lead.fc": ["battery"]})


def test_an_invalid_program_is_shown_as_by_lfield_check(walk):
    with pytest.raises(pytest.fail.Exception, match=r"walk\.L:11:\d+: error") as failed:
        walk("int n = true;")
    assert "^" in str(failed.value)


@pytest.mark.few(0)
def test_a_stop_brings_devices_to_rest_first(lfield_mission):
    team = lfield_mission(FLIGHT)
    team.run(until="lead: at north")
    team.stop()
    team.run(until=lambda: not team._fleet.runs)
    assert team.fake("lead.fc").facts["airborne"] is False
    assert team.fake("wing.fc").facts["airborne"] is False


def test_an_operator_pauses_and_resumes_a_mission(walk):
    team = walk("sleep(5.0);")
    team.run(5.0)
    team.pause()
    team.run(20.0)
    assert (team.said("over"), team.ended) == (0, {})
    assert [mark.text for mark in team.marks] == ["the mission is paused"]
    team.resume()
    team.run(until_done=True)
    assert (team.said("over"), team.ended) == (1, {"boss": "done"})


def test_devices_come_to_rest_in_a_pause(lfield_mission):
    team = lfield_mission(FLIGHT)
    team.run(until="lead: at north")
    team.pause()
    team.run(20.0)
    # The safe state of its binding is `land`.
    assert team.fake("lead.fc").facts["airborne"] is False


def test_computation_takes_time(walk):
    team = walk(
        "int n = 0;"
        "try { within (0.5) { while (true) n = n + 1; } } catch (TimeLimitException e) { print(n); }"
    )
    team.run(until_done=True)
    (count,) = (int(line.text.split()[-1]) for line in team.log if line.text.split()[-1].isdecimal())
    # A million instructions a second, two for each round of the loop.
    assert 200_000 < count < 280_000
    assert team.calls[-1].ended + 0.5 < team.now


def test_a_busy_loop_of_l_ends_at_the_time_limit(walk):
    team = walk("while (true) { }")
    with pytest.raises(Stuck, match="the coordinators have not ended after 10 s") as stuck:
        team.run(until_done=True, at_most=10.0)
    assert any("boss on bravo: ready at Boss.init (walk.L:11)" in line for line in stuck.value.standing)


def test_endless_calls_to_an_instant_double_end_at_the_time_limit(walk):
    class Quick:
        def work(self, seconds: float) -> None:
            return None

    team = walk('while (true) findPost("two").work(0.0);', doubles={"two": Quick()})
    with pytest.raises(Stuck, match="the coordinators have not ended after 1 s"):
        team.run(until_done=True, at_most=1.0)


@pytest.mark.few(0)
def test_waiver_lines_of_the_demo_are_shorter_than_its_other_lines(lfield_mission):
    team = lfield_mission(FLIGHT)
    team.run(12.0)
    waivers = [line.text for line in team.log if "watchdog" in line.text]
    # Lines about the clocks of the simulated computers are not in the demo.
    others = [line.text for line in team.log if "clock" not in line.text and line.text not in waivers]
    assert len(waivers) == 2
    assert max(map(len, waivers)) < max(map(len, others))
