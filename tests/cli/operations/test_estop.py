"""`lfield estop` on a flying mission: safe devices, unconfirmed devices, unreached hosts."""

from __future__ import annotations

import json
import re
import resource
import signal

import pytest

pytestmark = pytest.mark.process

#: Each copter takes off, and then tries to release itself repeatedly.
PROGRAM = """
resource Copter {
    Mavlink fc;
    init(string[] arg) {
        fc.arm();
        fc.takeoff(2.0);
        write("flies\\n");
        while (true) {
            sleep(0.2);
            try { fc.hold(); }
            catch (DeviceException stopped) { again(); }
        }
    }
    private void again() {
        try {
            fc.release();
            write("released\\n");
        } catch (DeviceException e) {
            write("not released: " + e.message() + "\\n");
        }
    }
}
coordinator Nobody { init(string[] arg) { sleep(1000.0); } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Copter:wing@bravo\n//Nobody:one@alpha\n"
COPTER = "driver: mavlink, endpoint: 'udp:127.0.0.1:14550', waivers: [device_watchdog]"
DEVICES = f"""
silence: 2.0
agents:
  lead: {{devices: {{fc: {{{COPTER}, system: 1}}}}}}
  wing: {{devices: {{fc: {{{COPTER}, system: 2}}}}}}
"""


class Team:
    """Two hosts in separate processes; `words` are the options for the deployment and the addresses."""

    def __init__(self, lfield, environment):
        deployment = lfield.mission(PROGRAM, DEPLOYMENT, DEVICES)
        self.words = ("--deploy", deployment, *lfield.maps(["alpha", "bravo"]))
        self.hosts = {
            name: lfield.start("up", *self.words, "--host", name, "--sim", env=environment)
            for name in ("alpha", "bravo")
        }
        for host in self.hosts.values():
            host.wait_for("flies")


@pytest.fixture
def team(alone, lfield):
    yield Team(lfield, alone)
    lfield.end()


def test_every_device_is_safe_and_not_released_before_the_stop_is_lifted(lfield, team, here):
    pressed = here("estop", *team.words, "--no-wait", "--reason", "a child on the field", status=0)
    assert sorted(pressed.out) == ["alpha: lead.fc: safe", "bravo: wing.fc: safe"]
    for host in team.hosts.values():
        host.wait_for(r"safe state 'land': the emergency stop was pressed: a child on the field")
        host.wait_for(r"not released: .*'lfield estop --lift' must come first")
        assert not any("| released" in line or line.endswith("released") for line in host.out)
    lifted = here("estop", *team.words, "--lift", status=0)
    assert sorted(lifted.out) == ["alpha: lead.fc: may be released", "bravo: wing.fc: may be released"]
    for host in team.hosts.values():
        host.wait_for(r"^(?!.*not).*released$")


@pytest.mark.few(0)
def test_unconfirmed_devices_and_unreached_hosts_are_named(lfield, team, alone, here):
    here("sim", "fault", "wing.fc", "silence=true", env=alone, status=0)
    pressed = here("estop", *team.words, "--no-wait", status=3)
    assert pressed.out == ["alpha: lead.fc: safe"]
    assert pressed.err == [
        "bravo: wing.fc: NOT CONFIRMED: its safe state was not confirmed in 5 s",
    ]
    pressed = here("estop", *team.words, "--no-wait", "--json", status=3)
    found = {host: answer["devices"] for host, answer in json.loads("".join(pressed.out)).items()}
    assert found["alpha"] == {"lead.fc": {"confirmed": True, "at_rest": None, "problem": ""}}
    assert found["bravo"]["wing.fc"]["confirmed"] is False
    assert found["bravo"]["wing.fc"]["problem"]
    team.hosts["bravo"].popen.kill()
    team.hosts["bravo"].popen.wait()
    again = here("estop", *team.words, "--no-wait", status=3)
    assert again.out == ["alpha: lead.fc: safe"]
    (line,) = again.err
    assert line.startswith("bravo: NOT REACHED, its devices have not confirmed: ")


@pytest.mark.few(0)
def test_an_emergency_stop_is_executed_though_its_command_was_killed(lfield, team, alone):
    lfield("sim", "fault", "wing.fc", "silence=true", env=alone, status=0)
    pressed = lfield.start("estop", *team.words, "--reason", "and away")
    team.hosts["bravo"].wait_for("EMERGENCY STOP by operator: .*and away")
    pressed.popen.kill()
    pressed.popen.wait()
    again = lfield("estop", *team.words, "--no-wait")
    assert "bravo: wing.fc: NOT CONFIRMED" in again.said
    lfield("ps", *team.words, status=0)
    assert not any("a bug in lfield" in host.said for host in team.hosts.values())


def test_a_mission_that_does_not_run_is_not_reached(lfield):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT, DEVICES)
    pressed = lfield("estop", "--deploy", deployment, *lfield.maps(["alpha", "bravo"]), status=69)
    assert len(pressed.err) == 2
    assert all("NOT REACHED" in line for line in pressed.err)


def lines_of(process, device: str) -> list[str]:
    return [line.partition(f"{device}: ")[2] for line in process.out if device in line]


@pytest.mark.few(0)
def test_the_descent_is_shown_until_rest_and_devices_not_at_rest_are_named(lfield, own):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT, DEVICES.replace("waivers", "rest_within: 8, waivers"))
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim", env=own)
    for host in ("alpha", "bravo"):
        team.wait_for(rf"{host} +\| flies")
    first, second = (lfield.start("estop", env=own) for _ in range(2))
    for pressed in (first, second):
        assert pressed.wait() == 0, pressed.said
        assert pressed.out[0].startswith("stopping mission-")
        for device in ("lead.fc", "wing.fc"):
            assert lines_of(pressed, device)[0] == "safe"
            assert lines_of(pressed, device)[-1] == "at rest"
    lfield("sim", "fault", "wing.fc", "silence=true", env=own, status=0)
    looking = lfield.start("estop", env=own)
    looking.wait_for("lead.fc: at rest")
    looking.wait_for("wing.fc: no longer reporting")
    looking.signal(signal.SIGINT)
    assert looking.wait() in (3, 130), looking.said
    text = "\n".join(looking.err)
    assert "stopped watching; the order is unchanged: 'lfield ps' shows the devices" in text
    assert re.search("bravo: wing.fc: NOT .*; last seen ", text)
    assert "lead.fc" not in text
    looking = lfield("estop", "--json", env=own, status=3)
    assert re.search("bravo: wing.fc: NOT .*; last seen ", looking.err[-1])
    (answers,) = map(json.loads, looking.out)
    assert answers["alpha"]["devices"]["lead.fc"]["at_rest"] is True
    assert answers["bravo"]["devices"]["wing.fc"]["at_rest"] is False


@pytest.mark.few(0)
def test_a_host_that_ends_by_the_stop_is_seen_at_rest_first(lfield, own):
    """The stop ends the program, and the host ends after its vehicle has landed."""
    program = """
    resource Copter {
        Mavlink fc;
        init(string[] arg) { }
        portal fly() { fc.arm(); fc.takeoff(2.0); write("flies\\n"); while (true) { sleep(0.2); fc.hold(); } }
    }
    coordinator Pilot { init(string[] arg) { findCopter("lead").fly(); } }
    """
    devices = "silence: 2.0\nagents: {lead: {devices: {fc: {" + COPTER + "}}}}\n"
    deployment = lfield.mission(program, "//Copter:lead@alpha\n//Pilot:one@alpha\n", devices)
    run = lfield.start(
        "up",
        "--deploy",
        deployment,
        "--host",
        "alpha",
        "--sim",
        "--until-done",
        *lfield.maps(["alpha"]),
        env=own,
    )
    run.wait_for("flies")
    pressed = lfield("estop", env=own, status=0)
    lines = lines_of(pressed, "lead.fc")
    assert (lines[0], lines[-1]) == ("safe", "at rest")
    assert len(lines) > 2
    assert run.wait() == 1


class Kept:
    """One host with a journal that can be killed and restarted."""

    def __init__(self, lfield, environment):
        devices = "silence: 2.0\nagents: {lead: {devices: {fc: {" + COPTER + "}}}}\n"
        deployment = lfield.mission(PROGRAM, "//Copter:lead@alpha\n//Nobody:one@alpha\n", devices)
        state = lfield.folder / "state"
        arguments = ("--deploy", deployment, "--host", "alpha", "--sim", "--state", state)
        arguments += tuple(lfield.maps(["alpha"]))
        self._start = lambda: lfield.start("up", *arguments, env=environment)
        self.host = self._start()
        self.host.wait_for("flies")
        (self.journal,) = state.rglob("host.journal")

    def killed_and_started(self):
        self.host.popen.kill()
        self.host.popen.wait()
        self.host = self._start()
        return self.host


@pytest.mark.few(0)
def test_a_host_killed_and_started_again_is_still_stopped(lfield, own):
    stored_run = Kept(lfield, own)
    pressed = lfield("estop", "--no-wait", "--reason", "a child on the field", env=own)
    assert (lfield.status(pressed), pressed.err) == (0, []), pressed.said
    output = lfield("inspect", stored_run.journal, env=own)
    still = "the emergency stop was pressed: a child on the field"
    assert f"stopped   until 'lfield estop --lift': {still}" in output.out, output.said
    host = stored_run.killed_and_started()
    host.wait_for(f"EMERGENCY STOP still active: {still}; end it with 'lfield estop --lift'")
    host.wait_for(f"lead.fc in safe state 'land': {still}")
    host.wait_for(f"lead died of an uncaught DeviceException: fc: held in its safe state: {still}")
    assert f'"lead.fc": "{still}"' in lfield("ps", "--json", env=own).said
    lifted = lfield("estop", "--lift", env=own)
    assert (lfield.status(lifted), lifted.out[-1]) == (0, "alpha: lead.fc: may be released"), lifted.said
    assert "stopped" not in lfield("inspect", stored_run.journal, env=own).said
    host = stored_run.killed_and_started()
    host.wait_for("flies")
    assert "EMERGENCY" not in host.said


@pytest.mark.few(0)
def test_a_stop_that_cannot_be_stored_is_reported(lfield, own):
    stored_run = Kept(lfield, own)
    resource.prlimit(stored_run.host.pid, resource.RLIMIT_FSIZE, (0, 0))
    pressed = lfield("estop", "--no-wait", env=own)
    assert "alpha: lead.fc: safe" in pressed.out, pressed.said
    assert re.fullmatch(
        r"alpha: emergency stop not stored: .+; after a restart this host would not restore it",
        pressed.err[-1],
    ), pressed.said


BELL = """
resource Bell {
    init(string[] arg) { }
    portal ring() { write("läutet\\n"); }
}
coordinator Ringer {
    init(string[] arg) { findBell(arg[1]).ring(); sleep(1000.0); }
}
"""
BELL_DEPLOYED = "//Bell:bell@alpha\n//Ringer:tom@alpha?bell\n"
#: A terminal with ASCII encoding.
ASCII = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}


@pytest.mark.few(0)
def test_undecodable_bytes_do_not_prevent_commands_to_a_running_mission(lfield, own):
    deployment = lfield.mission(BELL, BELL_DEPLOYED, name="n\udcf6rd/mission")
    team = lfield.start("up", "--deploy", deployment, "--all", "--sim", env=own)
    team.wait_for("läutet")
    lfield("estop", "--no-wait", "--reason", "gr\udcf6\udcdfe", env=own, status=0)
    team.wait_for(r"EMERGENCY STOP by .*: the emergency stop was pressed: gr\\u\{dcf6\}\\u\{dcdf\}e")
    for arguments in (["estop", "--lift", "--reason", "\udcff"], ["pause"], ["resume"], ["ps"]):
        lfield(*arguments, env=own, status=0)
    for arguments in (["logs"], ["events", "--no-follow"]):
        result = lfield(*arguments, env=own | ASCII, status=0)
        assert r"l\u{e4}utet" in result.said
    for arguments in (
        ["forget", "\udcff"],
        ["recover", "\udcff"],
        ["events", "--host", "\udcff"],
        ["ps", "--run", "\udcff"],
    ):
        result = lfield(*arguments, env=own, status=64)
        assert r"\u{dcff}" in result.said


@pytest.fixture
def half_team(lfield, alone):
    """The arguments of commands for two hosts, of which only alpha runs."""
    deployment = lfield.mission(BELL, BELL_DEPLOYED + "//Bell:other@bravo\n")
    arguments = ("--deploy", deployment, *lfield.maps(["alpha", "bravo"]))
    lfield.start("up", *arguments, "--host", "alpha", env=alone).wait_for("listening on")
    yield arguments
    lfield.end()


@pytest.mark.few(0)
def test_a_host_that_does_not_run_has_nothing_to_lift(lfield, half_team) -> None:
    lfield("estop", *half_team, "--no-wait", status=3)
    lifted = lfield("estop", *half_team, "--lift", status=0)
    assert [line.partition(":")[0] for line in lifted.out] == ["alpha", "bravo"]
    assert lifted.err == []


@pytest.mark.few(0)
def test_json_has_each_host_with_its_devices_or_its_error(lfield, half_team) -> None:
    stopped = lfield("estop", *half_team, "--no-wait", "--json", status=3)
    (line,) = stopped.out
    found = json.loads(line)
    assert found["alpha"] == {"devices": {}, "trouble": ""}
    assert found["bravo"]["code"] == "no-listener"
    lifted = lfield("estop", *half_team, "--lift", "--json", status=0)
    assert json.loads(lifted.out[0])["alpha"] == {"devices": {}, "trouble": ""}
