"""A device by DBC file on the time of the test; cantools encodes the commands and decodes the status."""

from __future__ import annotations

import math
from pathlib import Path

import cantools
import pytest
from can_fake_bench import Bench

import lfield_sim.can
from lfield.errors import InputFileError, UsageError
from lfield_sim.can.dbc_device import load

GRIPPER = Path(lfield_sim.can.__file__).with_name("gripper.dbc")

DATABASE = cantools.database.load_file(GRIPPER)


class GripperBench(Bench):
    def __init__(self, options: str = "") -> None:
        super().__init__(f"dbc:{GRIPPER}:arm.grip{options}")

    def command(self, width: float, force: float = 0.0, enable: int = 1) -> None:
        values = {"TargetWidth": width, "TargetForce": force, "Enable": enable}
        self.send(256, DATABASE.encode_message("GripperCommand", values))

    @property
    def status(self) -> dict[str, float]:
        self.wait(0.055)
        return DATABASE.decode_message("GripperStatus", self.last(257))


def test_status_is_sent_at_the_rate_of_the_file():
    bench = GripperBench()
    assert [frame.identifier for frame in bench.wait(1.02)] == [257] * 20
    assert bench.status == {"Width": 0.0, "Force": 0.0, "Enable": 0, "Fault": 0, "Temperature": 25.0}


def test_signals_follow_with_a_lag_and_saturate():
    bench = GripperBench(",lag=0.5")
    bench.command(0.08, 50.0)
    bench.wait(0.5)
    assert bench.devices[0].value("GripperStatus", "Width") == pytest.approx(0.08 * -math.expm1(-1), rel=0.02)
    bench.wait(4.0)
    assert bench.status["Width"] == pytest.approx(0.08, abs=2e-4)
    assert (bench.status["Force"], bench.status["Enable"]) == (pytest.approx(50.0, abs=0.1), 1)
    bench.send(
        256,
        DATABASE.encode_message(
            "GripperCommand", {"TargetWidth": 0.5, "TargetForce": 0, "Enable": 1}, strict=False
        ),
    )
    bench.wait(4.0)
    assert bench.status["Width"] == pytest.approx(0.1, abs=2e-4)


def test_commands_expire_after_the_timeout_option():
    bench = GripperBench(",timeout=0.3")
    bench.command(0.1)
    bench.wait(0.2)
    assert bench.status["Enable"] == 1
    bench.wait(0.3)
    stopped = bench.status
    assert stopped["Enable"] == 0
    bench.wait(1.0)
    assert bench.status["Width"] == stopped["Width"] < 0.1


def test_remote_request_stuck_overheat_and_lost_status():
    bench = GripperBench()
    bench.send(257, remote=True)
    assert [frame.identifier for frame in bench.wait()] == [257]
    bench.command(0.1)
    bench.fault("stuck@gripper=true", "overheat@arm.grip=true")
    bench.wait(1.0)
    assert bench.status == {"Width": 0.0, "Force": 0.0, "Enable": 0, "Fault": 1, "Temperature": 130.0}
    bench.fault("lost_tpdo=true")
    bench.wait(0.01)
    assert bench.wait(1.0) == []


def test_options_select_one_command_and_status_signal():
    bench = GripperBench(",command=GripperCommand.TargetForce,status=GripperStatus.Width")
    bench.command(0.0, 0.05e3)
    bench.wait(3.0)
    assert bench.status["Width"] == pytest.approx(0.1, abs=2e-4)
    assert bench.status["Enable"] == 0


@pytest.mark.parametrize("options", [",commands=GripperCommand", ",node=Gripper"])
def test_options_name_the_commands_or_the_node(options):
    bench = GripperBench(options)
    bench.command(0.1)
    bench.wait(3.0)
    assert bench.status["Width"] == pytest.approx(0.1, abs=2e-4)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"dbc:{GRIPPER},node=Nobody", "no message"),
        (f"dbc:{GRIPPER},command=A.b,status=C.d", "is not a signal"),
        (f"dbc:{GRIPPER},speed=1", "has no 'speed'"),
        (f"dbc:{GRIPPER},lag=0", "above 0"),
        ("cia402:128", "from 1 to 127"),
        ("cia402:5,load=heavy", "not 'heavy'"),
        ("odrive:x", "is not a node id"),
        ("vesc:1", "is not a device"),
        ("cia402:", "is not a device"),
        ("cia402:5,load", "is not a device"),
    ],
)
def test_invalid_device_text_is_a_usage_error(text, words):
    with pytest.raises(UsageError, match=words):
        Bench(text)


def test_missing_dbc_file_is_an_input_file_error():
    with pytest.raises(InputFileError, match=r"cannot read /nowhere\.dbc: no such file"):
        Bench("dbc:/nowhere.dbc")


def test_two_devices_with_one_node_id_are_refused():
    with pytest.raises(UsageError, match="same node id"):
        Bench("cia402:5", "odrive:5")


FIELD = """VERSION ""
BU_: Host Pump
BO_ 256 Command: 8 Host
 SG_ Target : 0|16@1- (0.1,0) [-100|100] "rad/s" Pump
BO_ 2561 Status: 8 Pump
 SG_ Actual : 0|16@1- (0.1,0) [-100|100] "rad/s" Host
BO_ 2562 Broken: 2 Pump
 SG_ far : 60|8@1+ (1,0) [0|0] "" Host
VAL_ 256 nothing 0 "off; really" 1 "on" ;
VAL_ 2561 Actual 0 "stands" ;
"""


@pytest.mark.parametrize("encoding", ["utf-8-sig", "cp1252"])
def test_dbc_file_with_common_faults_is_simulated(tmp_path, encoding):
    """Names for an absent signal, ids without bit 31, a signal beyond its frame."""
    path = tmp_path / "field.dbc"
    path.write_bytes(FIELD.replace("Host Pump", 'Host Pump\nCM_ "°";').encode(encoding))
    data = load(str(path), commands="Command")
    assert [message.name for message in data.own] == ["Status"]
    assert data.own[0].is_extended_frame
    assert data.links == {("Status", "Actual"): ("Command", "Target")}
