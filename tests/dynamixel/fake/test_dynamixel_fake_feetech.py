"""The unchanged SDK of Feetech with the simulated STS3215; refused writes and volatile settings."""

from __future__ import annotations

import pytest
import scservo_sdk as sdk
from chain_wire import ChainWire

from lfield_sim.dynamixel.ax_series import make_servo
from lfield_sim.dynamixel.packets import encode1
from lfield_sim.dynamixel.servo import Servo
from lfield_sim.dynamixel.servo_chain import ServoChain
from lfield_sim.dynamixel.servo_model import model_named
from lfield_sim.dynamixel.sts_series import magnitude, signed

BAUD = 1_000_000
#: Addresses of registers: id, status return level, homing offset, torque, goal, lock, voltage.
ID, LEVEL, OFFSET, TORQUE, GOAL, LOCK, VOLTAGE = 5, 8, 31, 40, 42, 55, 62


class FeetechPort(ChainWire, sdk.PortHandler):
    """The port of the SDK, connected to a chain."""

    def __init__(self, chain: ServoChain) -> None:
        super().__init__("virtual")
        self.connect(chain, BAUD)


class Desk:
    """The client and the port of the SDK, and the servos with the ids 1 to `count`."""

    def __init__(self, count: int = 1) -> None:
        self.servos = [make_servo(model_named("STS3215")) for _ in range(count)]
        for number, servo in enumerate(self.servos, 1):
            servo.start_with(number, BAUD, 0, 0.0)
        self.port = FeetechPort(ServoChain(self.servos))
        self.client = sdk.sms_sts(self.port)

    @property
    def servo(self) -> Servo:
        return self.servos[0]

    def send(self, instruction: int, parameters: bytes) -> list:
        """Send an instruction to servo 1 and return the answers."""
        return self.port.chain.receive(encode1(1, instruction, parameters), self.port.now, BAUD)

    def write(self, address: int, *data: int) -> tuple[int, int]:
        """Write to servo 1. Return the result and the error byte."""
        return self.client.writeTxRx(1, address, len(data), list(data))


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_vendor_client_pings_moves_and_reads_servos():
    desk = Desk(3)
    client, port = desk.client, desk.port
    assert client.ping(2) == (777, sdk.COMM_SUCCESS, 0)
    assert client.ping(77)[1] == sdk.COMM_RX_TIMEOUT
    assert client.WritePosEx(1, 2500, 1000, 50) == (0, 0)
    port.wait(0.4)
    assert client.ReadPosSpeed(1)[1:] == (1000, 0, 0)
    assert client.ReadMoving(1) == (1, 0, 0)
    port.wait(2.0)
    assert client.ReadPos(1) == (2500, 0, 0)
    for number in (1, 2, 3):
        assert client.SyncWritePosEx(number, 1000 + number, 0, 0)
    assert client.groupSyncWrite.txPacket() == 0
    port.wait(3.0)
    group = sdk.GroupSyncRead(client, 56, 4)
    assert [group.addParam(number) for number in (1, 2, 3)] == [True] * 3
    assert group.txRxPacket() == 0
    assert [group.getData(number, 56, 2) for number in (1, 2, 3)] == [1001, 1002, 1003]
    assert client.RegWritePosEx(1, 2000, 0, 0) == (0, 0)
    port.wait(1.0)
    assert client.ReadPos(1)[0] == 1001
    assert client.RegAction() == 0
    port.wait(2.0)
    assert client.ReadPos(1)[0] == 2000


def test_wheel_mode_turns_with_its_ramp(desk):
    assert (desk.client.unLockEprom(1), desk.client.WheelMode(1)) == ((0, 0), (0, 0))
    assert desk.write(TORQUE, 1) == (0, 0)
    assert desk.client.WriteSpec(1, -1000, 10) == (0, 0)
    desk.port.wait(0.5)
    assert desk.client.ReadSpeed(1)[0] == pytest.approx(-500, abs=20)
    desk.port.wait(1.0)
    assert desk.client.ReadSpeed(1) == (-1000, 0, 0)


@pytest.mark.parametrize("value", [0, 1, -1, 2047, -2047, 5000, -5000])
def test_sign_and_magnitude_encoding_is_reversible_within_its_range(value):
    assert signed(magnitude(value, 1 << 11), 1 << 11) == max(-2047, min(2047, value))


def test_damaged_and_unknown_instructions_are_not_answered(desk):
    packet = encode1(1, 2, bytes((56, 2)))
    damaged = packet[:-1] + bytes((packet[-1] ^ 1,))
    assert desk.port.chain.receive(damaged, desk.port.now, BAUD) == []
    assert desk.send(0x55, b"") == []
    assert len(desk.send(2, bytes((56, 2)))) == 1


@pytest.mark.parametrize(
    ("address", "data", "register"),
    [
        (VOLTAGE, (99,), "present_voltage"),
        (3, (1, 2), "model_number"),
        (33, (7,), "operating_mode"),
        (LEVEL, (2,), "status_return_level"),
        (9, (255, 255), "min_position_limit"),
        (TORQUE, (3,), "torque_enable"),
        (41, (255,), "acceleration"),
        (9, (1,), "min_position_limit"),
    ],
)
def test_refused_write_changes_nothing_and_is_answered_as_success(desk, address, data, register):
    before = desk.servo.table[register]
    assert desk.write(address, *data) == (0, 0)
    assert desk.servo.table[register] == before


def test_reads_are_answered_without_answers_to_writes(desk):
    assert desk.write(LEVEL, 0) == (0, 0), "the servo answers this write"
    assert desk.write(TORQUE, 1)[0] == sdk.COMM_RX_TIMEOUT
    assert desk.client.read1ByteTxRx(1, TORQUE) == (1, 0, 0)


def test_locked_servo_loses_its_eeprom_without_power(desk):
    desk.write(OFFSET, 100, 0)
    assert desk.client.ReadPos(1)[0] == 1948, "the offset applies at once"
    desk.servo.reboot()
    desk.port.wait(0.2)
    assert desk.client.read2ByteTxRx(1, OFFSET) == (0, 0, 0)
    desk.client.unLockEprom(1)
    desk.write(OFFSET, 100, 0x08)
    desk.servo.reboot()
    desk.port.wait(0.2)
    assert desk.client.ReadPos(1)[0] == 2148, "an offset of -100 is subtracted"
    assert desk.client.read1ByteTxRx(1, LOCK) == (1, 0, 0)


def test_value_128_in_the_torque_register_centres_the_position(desk):
    desk.client.WritePosEx(1, 1000, 0, 0)
    desk.port.wait(2.0)
    assert desk.write(TORQUE, 128) == (0, 0)
    assert desk.client.ReadPos(1)[0] == 2048
    assert signed(desk.servo.table["homing_offset"], 1 << 11) == 1000 - 2048


def test_overload_reduces_the_torque_until_switched_on_again(desk):
    desk.client.WritePosEx(1, 3000, 0, 0)
    desk.port.chain.faults.apply(["overload=true"])
    desk.port.wait(1.9)
    assert desk.client.read1ByteTxRx(1, TORQUE) == (1, 0, 0)
    desk.port.wait(0.3)
    assert desk.client.read1ByteTxRx(1, TORQUE) == (1, 0, 0x20), "every answer contains the status"
    desk.port.wait(0.1)
    strength = desk.servo.model.strength
    assert desk.servo.motion.motor.current == pytest.approx(0.2 * strength.stall_current, rel=0.05)
    desk.port.chain.faults.apply(["overload=false"])
    desk.port.wait(1.0)
    assert desk.write(TORQUE, 0)[1] == 0x20
    desk.write(TORQUE, 1)
    desk.port.wait(0.1)
    assert desk.client.ping(1) == (777, 0, 0)


def test_overheating_switches_the_torque_off_and_goals_do_not_restore_it(desk):
    desk.write(TORQUE, 1)
    desk.port.chain.faults.apply(["hot=true"])
    desk.port.wait(6.0)
    assert desk.client.read1ByteTxRx(1, TORQUE) == (0, 0, 0x04)
    desk.write(GOAL, 0, 0)
    assert desk.servo.table["torque_enable"] == 0
    desk.write(TORQUE, 1)
    desk.port.wait(0.1)
    assert desk.servo.table["torque_enable"] == 0, "the servo is still hot"


@pytest.mark.parametrize(
    ("fault", "bit", "torque"), [("sag=5", 0x01, 1), ("encoder=true", 0x02, 1)], ids=["voltage", "encoder"]
)
def test_voltage_and_encoder_errors_are_only_reported(desk, fault, bit, torque):
    desk.write(TORQUE, 1)
    desk.port.chain.faults.apply([fault])
    desk.port.wait(0.5)
    assert desk.client.read1ByteTxRx(1, TORQUE) == (torque, 0, bit)


def test_over_current_switches_the_torque_off(desk):
    for address, value in ((28, 200), (38, 10)):
        desk.servo.table.put({28: "protection_current", 38: "over_current_time"}[address], value)
    desk.port.chain.faults.apply(["overload=true"])
    desk.client.WritePosEx(1, 3000, 0, 0)
    desk.port.wait(0.3)
    assert desk.client.read1ByteTxRx(1, TORQUE) == (0, 0, 0x08)


@pytest.mark.parametrize("model", ["STS3215", "XM430-W350", "AX-12A"])
def test_supply_dip_restarts_the_servo_once(model):
    servo = make_servo(model_named(model))
    chain = ServoChain([servo])
    servo.table.put("torque_enable", 1)
    chain.faults.apply(["brownout=true"])
    assert servo.table["torque_enable"] == 0
    chain.advance(1.0)
    servo.table.put("torque_enable", 1)
    chain.faults.apply(["hot=false"])
    assert servo.table["torque_enable"] == 1
