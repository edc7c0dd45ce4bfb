"""Parameter files of ground stations: accepted forms, and refusals with the line."""

from __future__ import annotations

import pytest

from lfield.driver import MissionFileError
from lfield_mavlink.files.parameter_facts import effective_after_restart, own_values
from lfield_mavlink.files.parameter_file import read_parameters
from lfield_mavlink.modes import ARDUPILOT, PX4

QGC = """# Onboard parameters for Vehicle 1
#
# Stack: {stack}
# Vehicle: {vehicle}
# Version: 1.15.0
# Git Revision: 0
#
# Vehicle-Id Component-Id Name Value Type
1\t1\tMPC_XY_VEL_MAX\t12.500000000000000000\t9
1\t1\tCOM_RCL_EXCEPT\t4\t6
1\t42\tCAM_MODE\t3\t6
"""


def read(text):
    data = text if isinstance(text, bytes) else text.encode()
    return read_parameters("f.param", data)


@pytest.mark.parametrize(
    "text",
    [
        "A_B,1\nC2,-2.5\n",
        "A_B 1\nC2 -2.5\n",
        "A_B\t1\r\nC2\t-2.5\r\n",
        "#NOTE: 1.1.2026\nA_B, 1 # a reason\n\n   # nothing\nC2 , -2.5",
        "A_B=1\nC2 = -25e-1\n",
        "\ufeffA_B,0x01\nC2,-2.5\n",
        "A_B,1\nC2,-2.5\nA_B,1\n",
        "1 1 A_B 1.0 9\n1\t1\tC2\t-2.5\t9\n",
    ],
)
def test_every_file_form_gives_the_same_values(text):
    found = read(text)
    assert found.values == {"A_B": 1.0, "C2": -2.5}
    assert (found.firmware, found.kind, found.others) == ("", "", 0)


@pytest.mark.parametrize(
    ("stack", "vehicle", "firmware", "kind"),
    [
        ("PX4 Pro", "Multi-Rotor", "px4", "copter"),
        ("PX4 Pro", "Quadrotor", "px4", "copter"),
        ("ArduPilot", "Fixed Wing", "ardupilot", "plane"),
        ("ArduPilot", "VTOL", "ardupilot", "plane"),
        ("ArduPilot", "Surface boat", "ardupilot", "rover"),
        ("ArduPilot", "Ground rover", "ardupilot", "rover"),
        ("ArduPilot", "Submarine", "ardupilot", "submarine"),
        ("MyPilot", "Balloon", "", ""),
    ],
)
def test_qgroundcontrol_header_gives_firmware_and_vehicle_kind(stack, vehicle, firmware, kind):
    found = read(QGC.format(stack=stack, vehicle=vehicle))
    assert (found.firmware, found.kind) == (firmware, kind)
    assert found.values == {"MPC_XY_VEL_MAX": 12.5, "COM_RCL_EXCEPT": 4.0}
    assert found.others == 1


def test_read_only_marks_are_read():
    found = read("A,1 @READONLY\nB,2\nC 3 # @READONLY\n")
    assert found.values == {"A": 1.0, "B": 2.0, "C": 3.0}
    assert found.read_only == {"A", "C"}


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("", ""),
        ("# nothing\n", ""),
        ("A,1\nB\n", "line 2"),
        ("A,1,2\n", "line 1"),
        ("A,one\n", "line 1"),
        ("A,nan\n", "line 1"),
        ("A,inf\n", "line 1"),
        ("A,0x\n", "line 1"),
        ("A,1e400\n", "line 1"),
        ("A,1\nA,2\n", "line 2"),
        ("2A,1\n", "line 1"),
        ("A-B,1\n", "line 1"),
        ("A23456789012345678,1\n", "line 1"),
        ("@include other.parm\n", "line 1"),
        ("1\t1\tA\t1\n", "line 1"),
        (b"A,1\n\xff,2\n", ""),
        ("A,1".encode("utf-16"), ""),
        ("QGC WPL 110\n0\t1\t0\t16\n", "line 1"),
    ],
)
def test_malformed_parameter_file_is_refused_with_its_line(text, where):
    with pytest.raises(MissionFileError) as error:
        read(text)
    assert (error.value.file, error.value.where) == ("f.param", where)


def test_autopilot_owned_and_restart_parameters_are_listed():
    names = [
        "STAT_BOOTCNT",
        "BARO1_GND_PRESS",
        "COMPASS_DEV_ID",
        "RTL_ALT",
        "SERIAL2_PROTOCOL",
        "BATT2_MONITOR",
    ]
    assert own_values(ARDUPILOT, names) == names[:3]
    assert effective_after_restart(ARDUPILOT, names) == names[4:]
    assert own_values(PX4, ["CAL_ACC0_ID", "CAL_ACC0_XOFF"]) == ["CAL_ACC0_ID"]
    assert effective_after_restart(PX4, ["SYS_AUTOSTART", "MPC_XY_VEL_MAX"]) == ["SYS_AUTOSTART"]
