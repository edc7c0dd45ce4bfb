"""The unchanged SDK of the vendor with the fake: in virtual time, and in a process with a pseudo-terminal."""

from __future__ import annotations

import os
import signal
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager

import dynamixel_sdk as sdk
import pytest
from chain_wire import ChainWire

from lfield.driver.binding import DeviceBinding
from lfield.driver.sims import main as run_sim
from lfield.testing.driver_bench import RunningFake, running_fake
from lfield_sim.dynamixel import SIM
from lfield_sim.dynamixel.ax_series import make_servo
from lfield_sim.dynamixel.servo import Servo
from lfield_sim.dynamixel.servo_chain import ServoChain
from lfield_sim.dynamixel.servo_model import model_named

LED, TORQUE, GOAL, POSITION, VOLTS, TEMPERATURE = 65, 64, 116, 132, 144, 146
IDS = (1, 2, 3, 4, 5, 6)


class VirtualPort(ChainWire, sdk.PortHandler):
    """The port of the SDK, connected to a chain."""

    def __init__(self, chain: ServoChain) -> None:
        super().__init__("virtual")
        self.connect(chain, 57_600)


def virtual(*ids: int, model: str = "XM430-W350", **settings: int) -> VirtualPort:
    servos = [Servo(model_named(model)) for _ in ids]
    for id, servo in zip(ids, servos, strict=True):
        for name, value in {"id": id, **settings}.items():
            servo.table.put(name, value)
    return VirtualPort(ServoChain(servos))


@pytest.fixture
def packets() -> sdk.Protocol2PacketHandler:
    return sdk.Protocol2PacketHandler()


def test_sdk_pings_one_servo_and_all_servos(packets):
    port = virtual(*IDS)
    assert packets.ping(port, 3) == (1020, sdk.COMM_SUCCESS, 0)
    assert packets.broadcastPing(port) == ({id: [1020, 52] for id in IDS}, sdk.COMM_SUCCESS)
    assert packets.ping(port, 77)[1] == sdk.COMM_RX_TIMEOUT


def test_sdk_reads_and_writes_of_every_size(packets):
    port = virtual(1)
    assert packets.write1ByteTxRx(port, 1, LED, 1) == (0, 0)
    assert packets.read1ByteTxRx(port, 1, LED) == (1, 0, 0)
    assert packets.write2ByteTxRx(port, 1, 102, 65_536 - 50) == (0, 0)
    assert packets.read2ByteTxRx(port, 1, 102) == (65_486, 0, 0)
    assert packets.write4ByteTxRx(port, 1, GOAL, 3000) == (0, 0)
    assert packets.read4ByteTxRx(port, 1, GOAL) == (3000, 0, 0)
    assert packets.write1ByteTxRx(port, 1, LED, 9) == (0, 4)


def test_sdk_action_executes_registered_writes(packets):
    port = virtual(1, 2)
    for id in (1, 2):
        assert packets.regWriteTxRx(port, id, LED, 1, [1]) == (0, 0)
        assert packets.read1ByteTxRx(port, id, LED)[0] == 0
    assert packets.action(port, sdk.BROADCAST_ID) == 0
    assert [packets.read1ByteTxRx(port, id, LED)[0] for id in (1, 2)] == [1, 1]


def test_sdk_reads_groups_of_servos(packets):
    port = virtual(*IDS)
    group = sdk.GroupSyncRead(port, packets, POSITION, 4)
    for id in IDS:
        assert group.addParam(id)
    for read in (group.txRxPacket, group.fastSyncRead):
        assert read() == 0
        assert [group.getData(id, POSITION, 4) for id in IDS] == [2048] * 6
    bulk = sdk.GroupBulkRead(port, packets)
    assert bulk.addParam(1, VOLTS, 2)
    assert bulk.addParam(2, TEMPERATURE, 1)
    for read in (bulk.txRxPacket, bulk.fastBulkRead):
        assert read() == 0
        assert (bulk.getData(1, VOLTS, 2), bulk.getData(2, TEMPERATURE, 1)) == (120, 30)


def test_sdk_group_read_fails_with_a_missing_servo(packets):
    port = virtual(1, 2, 3)
    port.chain.faults.apply(["dead@2=true"])
    group = sdk.GroupSyncRead(port, packets, POSITION, 4)
    for id in (1, 2, 3):
        group.addParam(id)
    assert group.txRxPacket() == sdk.COMM_RX_TIMEOUT
    assert not group.isAvailable(1, POSITION, 4)
    assert group.fastSyncRead() == sdk.COMM_RX_CORRUPT


def test_sdk_writes_groups_of_servos(packets):
    port = virtual(1, 2)
    sync = sdk.GroupSyncWrite(port, packets, GOAL, 4)
    assert sync.addParam(1, [0xE8, 3, 0, 0])
    assert sync.addParam(2, [0xD0, 7, 0, 0])
    assert sync.txPacket() == 0
    assert [packets.read4ByteTxRx(port, id, GOAL)[0] for id in (1, 2)] == [1000, 2000]
    bulk = sdk.GroupBulkWrite(port, packets)
    assert bulk.addParam(1, LED, 1, [1])
    assert bulk.addParam(2, GOAL, 4, [1, 0, 0, 0])
    assert bulk.txPacket() == 0
    assert packets.read1ByteTxRx(port, 1, LED)[0] == 1
    assert packets.read4ByteTxRx(port, 2, GOAL)[0] == 1


def test_sdk_reboots_clears_and_resets_a_servo(packets):
    port = virtual(7, operating_mode=4)
    packets.write1ByteTxRx(port, 7, LED, 1)
    assert packets.reboot(port, 7) == (0, 0)
    port.wait(0.2)
    assert packets.read1ByteTxRx(port, 7, LED)[0] == 0
    packets.write1ByteTxRx(port, 7, TORQUE, 1)
    packets.write4ByteTxRx(port, 7, GOAL, 10_000)
    port.wait(4.0)
    assert packets.read4ByteTxRx(port, 7, POSITION)[0] == 10_000
    assert packets.clearMultiTurn(port, 7) == (0, 0)
    assert packets.read4ByteTxRx(port, 7, POSITION)[0] == 10_000 % 4096
    assert packets.factoryReset(port, 7, 0xFF) == (0, 0)
    port.wait(0.2)
    assert packets.ping(port, 1)[1] == 0


def test_sdk_reads_and_writes_with_protocol_1():
    port, packets = virtual(1, protocol_type=1), sdk.Protocol1PacketHandler()
    assert packets.ping(port, 1) == (1020, 0, 0)
    assert packets.write4ByteTxRx(port, 1, GOAL, 1000) == (0, 0)
    assert packets.read4ByteTxRx(port, 1, GOAL) == (1000, 0, 0)


def test_sdk_moves_an_ax_servo_and_receives_its_errors():
    servo = make_servo(model_named("AX-12A"))
    servo.start_with(5, 57_600, 1, 0.0)
    port, packets = VirtualPort(ServoChain([servo])), sdk.Protocol1PacketHandler()
    assert packets.ping(port, 5) == (12, 0, 0)
    assert packets.write2ByteTxRx(port, 5, 32, 200) == (0, 0)
    assert packets.write2ByteTxRx(port, 5, 30, 700) == (0, 0)
    port.wait(2.0)
    assert packets.read2ByteTxRx(port, 5, 36) == (700, 0, 0)
    assert packets.write2ByteTxRx(port, 5, 8, 600) == (0, 0)
    assert packets.write2ByteTxRx(port, 5, 30, 700) == (0, 0x02), "angle limit"
    port.chain.faults.apply(["overload=true"])
    packets.write1ByteTxRx(port, 5, 24, 1)
    port.wait(2.0)
    assert packets.read1ByteTxRx(port, 5, 24) == (0, 0, 0x20), "every answer contains the error"


# ---- pseudo-terminal -----------------------------------------------------------------------------


@contextmanager
def running(*options: str) -> Iterator[tuple[RunningFake, str]]:
    """The fake as a process, and the path of its port."""
    with running_fake("dynamixel", *options) as fake:
        kind, path, _ = fake.endpoint.split(":")
        assert kind == "serial"
        yield fake, path
    assert fake.process.returncode == 0
    assert not os.path.lexists(path), "the fake has not removed its link"


@pytest.fixture
def long_sdk_timeout(monkeypatch) -> None:
    """Increase the timeout of the SDK: 34 ms are too short on a loaded computer."""
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 250)


def opened(path: str, baud: int) -> sdk.PortHandler:
    port = sdk.PortHandler(path)
    assert port.openPort()
    assert port.setBaudRate(baud)
    return port


@pytest.mark.process
def test_sdk_session_with_a_pseudo_terminal(packets, long_sdk_timeout):
    servos = [f"--servo={id}:XL330-M288:arm.joint{id}" for id in IDS]
    with running("--baud", "1000000", *servos) as (fake, path):
        port = opened(path, 1_000_000)
        assert packets.ping(port, 1) == (1200, 0, 0)
        assert sorted(packets.broadcastPing(port)[0]) == list(IDS)
        group = sdk.GroupSyncRead(port, packets, POSITION, 4)
        for id in IDS:
            group.addParam(id)
        assert (group.txRxPacket(), group.fastSyncRead()) == (0, 0)
        packets.write1ByteTxRx(port, 1, TORQUE, 1)
        packets.write4ByteTxRx(port, 1, GOAL, 2600)
        deadline = time.monotonic() + 60.0
        while packets.read4ByteTxRx(port, 1, POSITION)[0] != 2600:
            assert time.monotonic() < deadline
        assert fake.fault("dead@arm.joint2=true")["devices"]["2"] == "arm.joint2"
        assert packets.ping(port, 2)[1] == sdk.COMM_RX_TIMEOUT
        with pytest.raises(AssertionError, match="joint9"):
            fake.fault("dead@arm.joint9=true")
        port.closePort()


@pytest.mark.process
def test_wrong_baud_rate_gets_no_answer_and_a_nonstandard_rate_works(packets, long_sdk_timeout):
    with running("--servo", "1:XM430-W350", "--baud", "3000000") as (_, path):
        port = opened(path, 57_600)
        assert packets.ping(port, 1)[1] == sdk.COMM_RX_TIMEOUT
        assert port.setBaudRate(3_000_000)
        assert packets.ping(port, 1)[1] == 0
        assert packets.write1ByteTxRx(port, 1, 8, 7) == (0, 0), "answered at the old baud rate"
        assert packets.ping(port, 1)[1] == sdk.COMM_RX_TIMEOUT
        port.ser.baudrate = 4_500_000
        assert packets.ping(port, 1)[1] == 0
        port.closePort()


@pytest.mark.process
def test_unplugged_terminal_fails_and_can_be_opened_again(packets, long_sdk_timeout, tmp_path):
    path = str(tmp_path / "ttyDXL")
    with running("--listen", path) as (fake, port_path):
        assert port_path == path
        port = opened(path, 57_600)
        assert packets.write1ByteTxRx(port, 1, LED, 1) == (0, 0)
        fake.fault("unplug=true")
        assert not os.path.lexists(path)
        with pytest.raises((OSError, termios.error), match="Input/output error"):
            packets.ping(port, 1)
        fake.fault("unplug=false")
        port.ser.close()
        port = opened(path, 57_600)
        assert packets.read1ByteTxRx(port, 1, LED) == (1, 0, 0), "the servos kept their power"
        port.closePort()


@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_ends_the_servo_fake(number):
    with running() as (fake, _):
        fake.process.send_signal(number)
        assert fake.process.wait(60) == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--servo", "300:XM430-W350"], "write ID:MODEL[:NAME], with an id from 0 to 252"),
        (["--servo", "1:XM430-W350", "--servo", "1:XL330-M288"], "there is a servo 1 already"),
        (["--servo", "1:XM999"], "there is no simulation of the servo 'XM999'; there are: "),
        (["--servo", "1:XL330-M288", "--protocol", "1.0"], "XL330-M288 does not support protocol 1.0"),
        (["--servo", "1:XL330-M288", "--baud", "4500000"], "XL330-M288 does not support 4500000 baud"),
        (["--return-delay", "900"], "the return delay is from 0 to 508 microseconds"),
        (["--fault", "dead@7=true"], "there is no device '7'"),
        (["--listen", "/dev/null"], "cannot use /dev/null: there is a file or a device of that name"),
        (["--listen", "/nowhere/at/all/tty"], "cannot use /nowhere/at/all/tty: No such file or directory"),
    ],
)
def test_invalid_option_of_the_servo_fake_is_refused(capsys, options, words):
    assert run_sim(["lfield_sim.dynamixel:SIM", *options]) in (64, 69)
    assert words in capsys.readouterr().err


def binding(field: str, type: str, **options: object) -> DeviceBinding:
    common = {"agent": "a", "driver": "dynamixel", "endpoint": "sim:a", "safe_state": "hold"}
    return DeviceBinding(field=field, type=type, options=options, **common)


def test_fake_of_a_protocol_1_binding_is_an_ax_servo():
    assert SIM.arguments([binding("neck", "Dynamixel", id=3, protocol=1)])[2:] == [
        "--servo",
        "3:AX-12A:a.neck",
    ]
    options = SIM.arguments([binding("neck", "Dynamixel", id=3, protocol=1, model="XM430-W350")])
    assert options[-2:] == ["--protocol", "1.0"]


def test_simulated_chain_has_the_servos_of_the_bindings():
    devices = [
        binding("gripper", "Dynamixel", id=7, model="XL330-M288"),
        binding("arm", "DynamixelGroup", ids=[1, 2, 7], model=""),
    ]
    assert SIM.arguments(devices) == [
        "--baud", "1000000", "--servo", "1:XM430-W350:a.arm.1", "--servo", "2:XM430-W350:a.arm.2",
        "--servo", "7:XL330-M288:a.gripper",
    ]  # fmt: skip
