"""The package `dronecan` as a foreign client of simulated nodes, and as a foreign node for the driver."""

from __future__ import annotations

import asyncio
import collections
import time

import dronecan
import pytest
from dronecan.driver.common import AbstractDriver, CANFrame

from lfield.driver import DeviceError
from lfield.testing.driver_bench import running_fake
from lfield_can.bus.frames import Frame

uavcan = dronecan.uavcan
UNIQUE_ID = "00112233445566778899aabbccddeeff"


def position_command(index, value):
    command = uavcan.equipment.actuator.Command()
    command.actuator_id, command.command_type, command.command_value = index, 1, value
    return uavcan.equipment.actuator.ArrayCommand(commands=[command])


@pytest.mark.few(0)
@pytest.mark.process
def test_foreign_client_allocates_ids_reads_and_commands_simulated_nodes():
    """With its own slcan driver, allocator and node monitor."""
    devices = (
        f"dronecan:42,dynamic=yes,uid={UNIQUE_ID},functions=servo:0+esc:1",
        "dronecan:40,functions=battery:0",
    )
    arguments = [argument for device in devices for argument in ("--device", device)]
    with running_fake("can", "--listen", "slcan-pty", *arguments) as fake:
        port = fake.endpoint.removesuffix("@115200")
        node = dronecan.make_node(port, node_id=126, bitrate=1_000_000)
        monitor = dronecan.app.node_monitor.NodeMonitor(node)
        allocator = dronecan.app.dynamic_node_id.CentralizedServer(node, monitor)
        try:
            found = {}
            for kind in (
                uavcan.equipment.actuator.Status,
                uavcan.equipment.esc.Status,
                uavcan.equipment.power.BatteryInfo,
            ):
                node.add_handler(kind, lambda event, kind=kind: found.update({kind: event}))

            def command():
                node.broadcast(position_command(0, 0.5))
                node.broadcast(uavcan.equipment.esc.RawCommand(cmd=[0, 4096]))

            node.periodic(0.05, command)

            def complete():
                servo = found.get(uavcan.equipment.actuator.Status)
                esc = found.get(uavcan.equipment.esc.Status)
                names = {str(entry.info.name) for entry in monitor.find_all(lambda each: each.info)}
                return (
                    servo is not None
                    and esc is not None
                    and uavcan.equipment.power.BatteryInfo in found
                    and abs(servo.message.position - 0.5) < 0.01
                    and abs(esc.message.rpm - 4500) < 100
                    and names == {"lfield.fake.servo", "lfield.fake.battery"}
                )

            end = time.monotonic() + 60.0
            while not complete():
                assert time.monotonic() < end, found
                node.spin(0.1)
            assert (bytes.fromhex(UNIQUE_ID), 125) in allocator.get_allocation_table()
            battery = found[uavcan.equipment.power.BatteryInfo]
            assert battery.transfer.source_node_id == 40
            assert str(battery.message.model_name) == "lfield pack"
        finally:
            # The allocator keeps its table in a SQLite connection.
            allocator.close()
            node.close()


class MemoryDriver(AbstractDriver):
    """The CAN interface of a foreign node: the bus of the bench."""

    def __init__(self, bus) -> None:
        super().__init__()
        self.bus, self.frames = bus, collections.deque()
        bus.device = self.frames.append

    def receive(self, timeout=None):
        if not self.frames:
            return None
        frame = self.frames.popleft()
        return CANFrame(frame.id, frame.data, frame.extended)

    def send_frame(self, frame):
        self.bus.received(Frame(frame.id, bytes(frame.data), frame.extended))

    def close(self):
        pass


class ForeignServo:
    """A servo made with the package: it jumps to the position of each command."""

    def __init__(self, bus) -> None:
        self.position, self.commands, self.masters = 0.1, [], set()
        info = uavcan.protocol.GetNodeInfo.Response()
        info.name = "org.example.servo"
        info.hardware_version.unique_id = list(bytes.fromhex(UNIQUE_ID))
        node = self.node = dronecan.node.Node(MemoryDriver(bus), node_id=42, mode=0, node_info=info)
        node.add_handler(uavcan.equipment.actuator.ArrayCommand, self.on_command)
        node.add_handler(uavcan.protocol.NodeStatus, self.on_status)
        node.periodic(0.05, self.report)

    def on_command(self, event):
        for command in event.message.commands:
            self.position = command.command_value
            self.commands.append((command.actuator_id, command.command_type))

    def on_status(self, event):
        self.masters.add((event.transfer.source_node_id, event.message.mode))

    def report(self):
        status = uavcan.equipment.actuator.Status()
        status.actuator_id, status.position, status.speed = 3, self.position, 0.0
        status.force, status.power_rating_pct = float("nan"), 127
        self.node.broadcast(status)

    async def live(self):
        while True:
            self.node.spin(0)
            await asyncio.sleep(0.01)


def test_driver_moves_a_foreign_dronecan_servo(bench, binding, bus):
    servo = ForeignServo(bus)
    options = {"node": 42, "index": 3, "unique_id": UNIQUE_ID}
    bound = binding("DroneCanServo", options=options, waivers=["device_watchdog"], safe_state="rest")
    b = bench(bound, bus=bus, fakes=[servo.live])

    async def scenario(device):
        assert await device.open() == "DroneCAN node 42 org.example.servo, software 0.0"
        assert await device.serial() == f"uid {UNIQUE_ID}"
        assert b.values["position"] == pytest.approx(0.1, abs=1e-3)
        assert "torque" not in b.values
        assert "load" not in b.values
        await device.execute("moveTo", [-0.75])
        await device.make_safe("rest")
        assert servo.position == 0.0
        assert set(servo.commands) == {(3, 1)}
        assert servo.masters == {(126, 0)}
        b.driver.quiet()
        await asyncio.sleep(0.2)
        count = len(servo.commands)
        await asyncio.sleep(0.2)
        assert len(servo.commands) == count
        assert device.moving() == ""

    b.run_real(scenario, opened=False)


def test_node_with_another_unique_id_is_refused(bench, binding, bus):
    servo = ForeignServo(bus)
    options = {"node": 42, "index": 3, "unique_id": UNIQUE_ID[::-1]}
    bound = binding("DroneCanServo", options=options, waivers=["device_watchdog"], safe_state="hold")
    with pytest.raises(DeviceError, match=f"node 42 has the unique id {UNIQUE_ID}, not that of its binding"):
        bench(bound, bus=bus, fakes=[servo.live]).run_real(lambda device: None)
