"""`lfield pause` and `resume` on a flying mission."""

import re

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Copter {
    Mavlink fc;
    int flights;
    init(string[] arg) { }
    portal fly(real seconds) {
        flights = flights + 1;
        fc.arm();
        fc.takeoff(2.0);
        print("flies " + i2s(flights));
        sleep(seconds);
    }
}
coordinator Survey {
    init(string[] arg) {
        Copter copter = findCopter(arg[1]);
        try { copter.fly(1000.0); }
        catch (RestartException paused) { print("told: " + paused.message()); }
        copter.fly(0.1);
        print("complete");
        sleep(1000.0);
    }
}
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Survey:survey@alpha?lead\n"
COPTER = "driver: mavlink, endpoint: 'udp:127.0.0.1:14550', waivers: [device_watchdog]"
DEVICES = f"agents: {{lead: {{devices: {{fc: {{{COPTER}, system: 1}}}}}}}}\n"


def test_a_paused_copter_lands_and_flies_again(lfield, own, here):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT, DEVICES)
    arguments = ("up", "--deploy", deployment, *lfield.maps(["alpha"]), "--host", "alpha", "--sim")
    host = lfield.start(*arguments, env=own)
    host.wait_for("flies 1")
    paused = here("pause", env=own, status=0)
    assert "alpha: lead.fc: safe" in paused.said
    output = here("ps", env=own)
    assert "paused: alpha; 'lfield resume' resumes the mission" in output.said
    assert "safe, at rest" in output.said
    here("estop", "--no-wait", env=own, status=0)
    barred = here("resume", env=own, status=0)
    assert "lead.fc: the emergency stop was pressed" in barred.said
    host.wait_for("told: the mission was paused; this call may have begun")


@pytest.mark.few(0)
def test_a_paused_device_is_released_and_flies_again(lfield, own):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT, DEVICES)
    arguments = ("up", "--deploy", deployment, *lfield.maps(["alpha"]), "--host", "alpha", "--sim")
    host = lfield.start(*arguments, env=own)
    host.wait_for("flies 1")
    lfield("pause", env=own, status=0)
    lfield("resume", env=own, status=0)
    host.wait_for("flies 2")
    host.wait_for("survey: complete")


@pytest.mark.few(0)
def test_an_unreached_host_is_named(lfield, own):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT, DEVICES)
    arguments = ("up", "--deploy", deployment, *lfield.maps(["alpha"]), "--host", "alpha", "--sim")
    host = lfield.start(*arguments, env=own)
    host.wait_for("flies 1")
    ghost = lfield.write("ghost.dL", DEPLOYMENT.replace("alpha", "ghost"))
    lfield.write("ghost.L", PROGRAM)
    paused = lfield("pause", "--no-wait", ghost, "--map", "ghost=127.0.0.1:1", env=own, status=69)
    assert "ghost: NOT REACHED" in paused.said


@pytest.mark.few(0)
def test_a_device_not_at_rest_in_time_is_named_and_its_host_is_paused(lfield, own):
    high = PROGRAM.replace("fc.takeoff(2.0)", "fc.takeoff(8.0)")
    deployment = lfield.mission(high, DEPLOYMENT, DEVICES.replace("waivers", "rest_within: 1, waivers"))
    arguments = ("up", "--deploy", deployment, *lfield.maps(["alpha"]), "--host", "alpha", "--sim")
    host = lfield.start(*arguments, env=own)
    host.wait_for("flies 1")
    paused = lfield("pause", env=own, status=3)
    assert "alpha: lead.fc: safe" in paused.out
    assert re.match(r"alpha: lead\.fc: NOT AT REST after \d s; last seen ", paused.err[-1]), paused.said
    assert "paused: alpha; 'lfield resume' resumes the mission" in lfield("ps", env=own).said
