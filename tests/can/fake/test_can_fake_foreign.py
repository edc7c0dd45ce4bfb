"""A foreign client controls the fake: the CiA 402 client of `canopen`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import canopen
import pytest
from can_endpoints import opened, serial, tcp
from canopen import objectdictionary
from canopen.profiles.p402 import BaseNode402

from lfield.testing.driver_bench import running_fake
from lfield_sim.can.cia402.cia402_table import INCREMENTS, entries

pytestmark = pytest.mark.process
TYPES = {
    "u8": objectdictionary.UNSIGNED8,
    "u16": objectdictionary.UNSIGNED16,
    "u32": objectdictionary.UNSIGNED32,
    "i8": objectdictionary.INTEGER8,
    "i16": objectdictionary.INTEGER16,
    "i32": objectdictionary.INTEGER32,
    "text": objectdictionary.VISIBLE_STRING,
}


class Patient(BaseNode402):
    """The client, for a loaded computer: its own timeouts are fractions of a second."""

    LONG_TIMEOUT = 60.0
    TIMEOUT_SWITCH_OP_MODE = TIMEOUT_SWITCH_STATE_FINAL = TIMEOUT_SWITCH_STATE_SINGLE = LONG_TIMEOUT
    TIMEOUT_CHECK_TPDO = TIMEOUT_RESET_FAULT = LONG_TIMEOUT

    def __init__(self, number: int, known: objectdictionary.ObjectDictionary) -> None:
        super().__init__(number, known)
        self.sdo.RESPONSE_TIMEOUT = self.LONG_TIMEOUT


def dictionary() -> objectdictionary.ObjectDictionary:
    """The objects of the drive as a canopen dictionary."""
    known, table = objectdictionary.ObjectDictionary(), entries(5, INCREMENTS, 1.0, 5.0)
    for (index, subindex), entry in table.items():
        variable = objectdictionary.ODVariable(f"{index:04X}.{subindex}", index, subindex)
        variable.data_type, variable.access_type = TYPES[entry.type], entry.access
        if (index, 1) not in table:
            known.add_object(variable)
            continue
        if index not in known.indices:
            known.add_object(objectdictionary.ODRecord(f"{index:04X}", index))
        known[index].add_member(variable)
    return known


@pytest.fixture(params=["socketcand", "slcan"])
def node(request) -> Iterator[BaseNode402]:
    """The drive, operational, through each endpoint."""
    addresses = {"socketcand": ("socketcand:127.0.0.1:0", tcp), "slcan": ("slcan-pty", serial)}
    address, place = addresses[request.param]
    with running_fake("can", "--listen", address, "--device", "cia402:5,load=0.2,brake=yes") as fake:
        network = canopen.Network()
        network.bus = opened(place(fake.endpoint))
        network.connect()
        try:
            drive = Patient(5, dictionary())
            network.add_node(drive)
            drive.nmt.wait_for_heartbeat(drive.LONG_TIMEOUT)
            drive.setup_402_state_machine()
            drive.nmt.state = "OPERATIONAL"
            drive.nmt.wait_for_heartbeat(drive.LONG_TIMEOUT)
            yield drive
        finally:
            network.disconnect()


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_foreign_client_runs_profiles_and_a_quick_stop(node):
    assert node.sdo[0x1008].raw == "lfield fake CiA 402 drive"
    node.state = "OPERATION ENABLED"
    node.op_mode = "PROFILED POSITION"
    assert (node.state, node.op_mode) == ("OPERATION ENABLED", "PROFILED POSITION")
    node.rpdo[2][0x607A].raw = INCREMENTS
    node.rpdo[2][0x6040].raw = 0x1F
    node.rpdo[2].transmit()
    until(lambda: abs(node.tpdo_values[0x6064] - INCREMENTS) < 40)
    until(lambda: bool(node.statusword & 1 << 10))
    node.rpdo[2][0x6040].raw = 0x0F
    node.rpdo[2].transmit()
    node.op_mode = "PROFILED VELOCITY"
    node.rpdo[3][0x6040].raw = 0x0F
    node.rpdo[3][0x60FF].raw = 2 * INCREMENTS
    node.rpdo[3].transmit()
    until(lambda: abs(node.tpdo_values[0x606C] - 2 * INCREMENTS) < 100)
    node.controlword = 0x0002
    until(lambda: node.state == "SWITCH ON DISABLED" and node.tpdo_values[0x606C] == 0)


def test_foreign_client_homes_the_drive(node):
    node.sdo[0x6098].raw = 35
    node.state = "OPERATION ENABLED"
    node.op_mode = "HOMING"
    assert node.homing(timeout=node.LONG_TIMEOUT)
    assert node.is_homed()


def test_foreign_client_gets_the_specified_sdo_aborts(node):
    with pytest.raises(canopen.SdoAbortedError, match="range"):
        node.sdo[0x6060].raw = 7
    with pytest.raises(canopen.SdoAbortedError, match="does not exist"):
        node.sdo.upload(0x5555, 0)
    with pytest.raises(canopen.SdoAbortedError, match="read only"):
        node.sdo.download(0x6041, 0, bytes(2))
    node.sdo.download(0x607A, 0, b"\x01\x02\x03\x04", force_segment=True)
    assert node.sdo[0x607A].raw == 0x04030201
