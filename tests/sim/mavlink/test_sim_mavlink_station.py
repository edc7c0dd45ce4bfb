"""What the fakes do without a ground station while they stand: the traces b-gcs-arming of the three."""

from __future__ import annotations

import pytest
from mavlink_client import ACCEPTED, ARM, FAILED, GUIDED, MODE, REJECTED, Client


def without_station(kind="copter", flavour="ardupilot", **parameters):
    """A client that stands in GUIDED and has been unreachable for eight seconds."""
    c = Client(kind, flavour=flavour)
    c.autopilot.parameters.update(parameters)
    c.heartbeat()
    if flavour == "ardupilot":
        c.command(MODE, 1, GUIDED if kind == "copter" else 15)
    c.wait(12.0)
    return c


def test_a_disarmed_copter_misses_its_station_and_is_not_armed_until_a_moment_after_it_is_back():
    c = without_station(FS_GCS_ENABLE=5, FS_GCS_TIMEOUT=2)
    assert "GCS Failsafe" in c.texts()
    assert [m.system_status for m in c.messages if m.get_type() == "HEARTBEAT"][-1] == 5
    assert c.autopilot.mode == "GUIDED", "the mode stays"
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


def test_heartbeats_of_another_station_clear_nothing():
    c = without_station(FS_GCS_ENABLE=5, FS_GCS_TIMEOUT=2)
    c.out.srcSystem = 254
    c.heartbeat()
    c.wait(1.0)
    assert c.autopilot.arm() == FAILED


def test_a_disarmed_rover_holds_and_is_armed_all_the_same():
    c = without_station("rover", FS_GCS_ENABLE=1, FS_GCS_TIMEOUT=2)
    assert "Radio Failsafe" in c.texts()
    assert c.autopilot.mode == "HOLD"
    assert c.command(ARM, 1) == ACCEPTED


@pytest.mark.parametrize(("action", "result"), [(3, REJECTED), (0, ACCEPTED)])
def test_px4_loses_its_pre_arm_bit_without_a_word(action, result):
    c = without_station(flavour="px4", NAV_DLL_ACT=action, COM_DL_LOSS_T=5)
    assert bool(c.ask(1).onboard_control_sensors_health & 0x10000000) == (result == ACCEPTED)
    assert c.command(ARM, 1) == result
    c.wait(0.5)
    assert c.texts() == []
    c.heartbeat()
    assert c.command(ARM, 1) == ACCEPTED, "and has it back at once"
