"""Standing fakes without a ground station, as in the b-gcs-arming traces of three autopilots."""

from __future__ import annotations

import pytest
from mavlink_client import ACCEPTED, ARM, FAILED, GUIDED, MODE, REJECTED, Client


def without_station(kind="copter", flavour="ardupilot", **parameters):
    """A client whose vehicle is in GUIDED mode without heartbeats for 12 seconds."""
    c = Client(kind, flavour=flavour)
    c.autopilot.parameters.update(parameters)
    c.heartbeat()
    if flavour == "ardupilot":
        c.command(MODE, 1, GUIDED if kind == "copter" else 15)
    c.wait(12.0)
    return c


def test_disarmed_copter_refuses_arming_until_the_station_returns():
    c = without_station(FS_GCS_ENABLE=5, FS_GCS_TIMEOUT=2)
    assert "GCS Failsafe" in c.texts()
    assert [m.system_status for m in c.messages if m.get_type() == "HEARTBEAT"][-1] == 5
    assert c.autopilot.mode == "GUIDED", "the mode is unchanged"
    assert c.command(ARM, 1) == FAILED
    c.wait(0.1)
    assert "Arm: GCS failsafe on" in c.texts()
    c.autopilot.parameters["FS_GCS_ENABLE"] = 0
    c.wait(15.0)
    assert c.command(ARM, 1) == FAILED, "the parameter does not clear it"
    c.heartbeat()
    for _ in range(4):
        assert c.command(ARM, 1) == FAILED
        c.wait(0.08)
    c.wait(0.06)
    assert "GCS Failsafe Cleared" in c.texts()
    assert c.command(ARM, 1) == ACCEPTED


def test_heartbeat_of_another_station_does_not_clear_the_failsafe():
    c = without_station(FS_GCS_ENABLE=5, FS_GCS_TIMEOUT=2)
    c.out.srcSystem = 254
    c.heartbeat()
    c.wait(1.0)
    assert c.autopilot.arm() == FAILED


def test_disarmed_rover_holds_and_can_be_armed():
    c = without_station("rover", FS_GCS_ENABLE=1, FS_GCS_TIMEOUT=2)
    assert "Radio Failsafe" in c.texts()
    assert c.autopilot.mode == "HOLD"
    assert c.command(ARM, 1) == ACCEPTED


@pytest.mark.parametrize(("action", "result"), [(3, REJECTED), (0, ACCEPTED)])
def test_px4_clears_its_pre_arm_bit_without_a_text(action, result):
    c = without_station(flavour="px4", NAV_DLL_ACT=action, COM_DL_LOSS_T=5)
    assert bool(c.ask(1).onboard_control_sensors_health & 0x10000000) == (result == ACCEPTED)
    assert c.command(ARM, 1) == result
    c.wait(0.5)
    assert c.texts() == []
    c.heartbeat()
    assert c.command(ARM, 1) == ACCEPTED, "the bit is restored at once"
