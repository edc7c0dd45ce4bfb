"""After a crash a vehicle cannot be armed before an operator ends the lock-out. Hosts in virtual time."""

from __future__ import annotations

from secrets import token_bytes

import pytest

from lfield.authority.identity import ALL_RIGHTS, Identity
from lfield.wire.observer_messages import EmergencyStop, with_epoch

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal up() { fc.waitReady(60.0); fc.arm(); fc.takeoff(6.0); }
    portal again() {
        string done = "";
        try { fc.release(); done = done + " released"; } catch (DeviceException e) { print(e.message()); }
        try { fc.waitReady(5.0); done = done + " ready"; } catch (DeviceException e) { }
        try { fc.arm(); done = done + " armed"; } catch (DeviceException e) { }
        print("done:" + done);
    }
}
coordinator Walker {
    init(string[] arg) {
        Post post = findPost("p");
        try { post.up(); print("in the air"); } catch (RestartException e) { print(e.message()); }
        while (true) {
            try { sleep(2.0); post.again(); } catch (Exception e) { print("goes on after " + e.message()); }
        }
    }
}
"""
BINDINGS = """
agents:
  p:
    devices:
      fc: {{driver: mavlink, endpoint: "udp:127.0.0.1:14550", system: 1, kind: copter, autopilot: {autopilot},
           safe_state: land, waivers: [device_watchdog]}}
"""


class Operator:
    """Lifts the lock-out of the devices of a host."""

    identity = Identity("person", "anna", ALL_RIGHTS)

    def send(self, message: object) -> None:
        """The host answers."""


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("autopilot", "ends"),
    [("ardupilot", "power_off"), ("px4", "guard"), ("px4", "crash"), ("ardupilot", "crash")],
)
def test_lock_out_persists_over_guard_host_and_computer_restarts(tmp_path, lfield_mission, autopilot, ends):
    (tmp_path / "mission.L").write_text(PROGRAM)
    (tmp_path / "mission.dL").write_text("//Post:p@alpha\n//Walker:walker@bravo\n")
    (tmp_path / "mission.devices.yaml").write_text(BINDINGS.format(autopilot=autopilot))
    team = lfield_mission(tmp_path / "mission.dL")
    team.run(until="in the air")
    team.fake("p.fc").set("motor_failure=true")
    team.run(until="LOCKED OUT: it crashed: ")
    team.fake("p.fc").set("motor_failure=false")
    fleet = team._fleet
    if ends == "guard":
        host = fleet.runs["alpha"].process
        next(each for each in fleet.computers["alpha"].processes if each is not host).die(-9)
    else:
        team.run(0.5)
        getattr(team, ends)("alpha")
        team.boot("alpha")
    started = len(team.log)
    team.run(until="'lfield estop --lift' must come first")
    team.run(6.0)
    tried = [line.text for line in team.log[started:] if "done:" in line.text]
    assert len(tried) >= 2
    assert {text.split("done:")[1].strip() for text in tried} == {""}
    life = fleet.runs["alpha"]
    lift = with_epoch(EmergencyStop(token_bytes(16), "", lift=True), life.core.orders.epochs)
    life.process.loop.enter(lambda: life.host.on_message("", lift, Operator()))
    team.run(until="done: released ready armed", at_most=60.0)
