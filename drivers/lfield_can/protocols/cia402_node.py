"""A CiA 402 drive as a CANopen node: its messages, its set-up, our heartbeat."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping

from lfield_can import log_messages
from lfield_can.bus.frames import Frame
from lfield_can.protocols import cia402_setup as setting
from lfield_can.protocols import cia402_tables as t
from lfield_can.protocols import pdo_setup
from lfield_can.protocols.axis_protocol import AxisProtocol, ProtocolContext
from lfield_can.protocols.canopen_node import CanopenNode
from lfield_can.protocols.cia402_tables import Units
from lfield_can.protocols.pdo_setup import PdoConfiguration
from lfield_can.timing import PeriodicTask

#: Seconds for one step of a state machine.
STEP_TIMEOUT = 1.0
#: Seconds without process data after which position and velocity are unknown.
MAX_VALUE_AGE = 0.3


class Cia402Node(AxisProtocol):
    """One drive: set-up and messages."""

    def __init__(self, context: ProtocolContext) -> None:
        super().__init__(context)
        option = self.binding.option
        if self.node == 0:
            raise context.error("a CANopen node id is 1 to 127; node 0 addresses all")
        if option("counts") == 0:
            raise context.error(
                "cia402 requires 'counts' in its binding: position counts per turn of the motor"
            )
        self.units = Units(
            self.turns,
            option("counts"),
            option("velocity_unit"),
            option("rated_torque"),
            option("rated_current"),
        )
        self.objects = CanopenNode(self.binding.field, self.node, self.bus.post)
        self._heartbeat_task = PeriodicTask(context.clock)
        #: The process data of the drive, empty before they are configured.
        self.pdo_configuration = PdoConfiguration()
        self._sync_id = t.SYNC
        self._watchdog_time = 0.0
        #: Our heartbeat, which the drive monitors.
        self._heartbeat_frame = Frame(t.HEARTBEAT + self.binding.option("master"), bytes([t.OPERATIONAL]))
        self._nmt: int | None = None
        self.statusword = self._error_code = self._register = 0
        #: The time when position and velocity were last received.
        self._reported_at = dict.fromkeys((t.POSITION, t.VELOCITY), -MAX_VALUE_AGE)
        #: The number of receptions of each by process data.
        self._report_counts = Counter[int]()
        #: Bits of the supported modes, 0 if not reported.
        self.modes = 0
        self.configured = False
        self._has_voltage = True

    # -- messages of the drive --------------------------------------------------------------------------

    def ids(self) -> frozenset[int]:
        """All frames of a node with this id."""
        codes = (t.EMERGENCY, *t.TRANSMITTED, t.SDO_ANSWER, t.HEARTBEAT)
        return frozenset(code + self.node for code in codes)

    def overheard(self) -> frozenset[int]:
        """Requests of other clients, such as a vendor's tool."""
        return frozenset((t.SDO_REQUEST + self.node,))

    def on_overheard(self, frame: Frame) -> None:
        """Handles a request of another client or of this one."""
        self.objects.on_bus_request(frame.data)

    def on_frame(self, frame: Frame) -> Mapping[str, object] | None:
        code = frame.id - self.node
        if code == t.SDO_ANSWER:
            self.objects.on_answer(frame.data)
            return {}
        if code in t.TRANSMITTED:
            return self._on_process_data(frame)
        try:
            values = t.LAYOUTS[code].unpack(frame.data)
        except struct.error:
            return None
        return self._on_heartbeat(*values) if code == t.HEARTBEAT else self._on_emergency(*values)

    def _on_process_data(self, frame: Frame) -> dict[str, object] | None:
        if not self.pdo_configuration.data.is_tpdo(frame.id):
            return {}  # not mapped by this driver, or not yet
        values = self.pdo_configuration.data.read(frame.id, frame.data)
        if values is None:
            return None
        self._report_counts.update(values.keys())
        return self.on_values(values)

    def on_values(self, values: Mapping[int, int]) -> dict[str, object] | None:
        """Handles values of objects, by PDO or SDO; returns None for an invalid status word."""
        readings: dict[str, object] = {}
        if t.STATUS in values:
            status = self.on_status(values[t.STATUS])
            if status is None:
                return None
            readings.update(status)
        now = self.context.clock.monotonic()
        self._reported_at.update({entry: now for entry in self._reported_at if entry in values})
        if t.POSITION in values:
            readings["position"] = self.state.position = self.units.position(values[t.POSITION])
        if t.VELOCITY in values:
            readings["velocity"] = self.state.velocity = self.units.velocity(values[t.VELOCITY])
        if t.TORQUE in values and self.units.rated_torque:
            readings["torque"] = self.units.torque(values[t.TORQUE])
        if t.CURRENT in values and self.units.rated_current:
            readings["current"] = values[t.CURRENT] / 1000.0 * self.units.rated_current
        return readings

    def _on_heartbeat(self, value: int) -> dict[str, object]:
        self._nmt = value & 0x7F
        if self._nmt == t.BOOTED:
            self.state.referenced = False
        if self.configured and self._nmt != t.OPERATIONAL:
            self.configured, self.needs_setup = False, True
            self.reset_state("not operational")
            return self._state_telemetry()
        if self.pdo_configuration.by_changes:
            return self._unchanged_telemetry()
        if self.context.clock.monotonic() - min(self._reported_at.values()) > MAX_VALUE_AGE:
            self.state.position = self.state.velocity = None
        return {}

    def _unchanged_telemetry(self) -> dict[str, object]:
        """Values that are sent only on change remain valid while the node responds."""
        state = self.state
        if not self.configured or state.position is None or state.velocity is None:
            return {}
        return {**self._state_telemetry(), "position": state.position, "velocity": state.velocity}

    def on_status(self, statusword: int) -> dict[str, object] | None:
        state = t.state_of(statusword)
        if not state:
            return None
        self.statusword, self.state.state = statusword, state
        self.state.enabled = state == "operation enabled"
        if not state.startswith("fault"):
            self._error_code = self._register = 0
        fault = t.error_text(self._error_code, self._register) or "fault"
        self.state.fault = fault if state.startswith("fault") else ""
        return self._state_telemetry()

    def _on_emergency(self, code: int, register: int) -> dict[str, object]:
        self._error_code, self._register = code, register
        if code:
            self.context.note(log_messages.EMERGENCY.line(reason=t.error_text(code, register)))
        return {}

    def _state_telemetry(self) -> dict[str, object]:
        state = self.state
        return {
            "state": state.state,
            "fault": state.fault,
            "enabled": state.enabled,
            "referenced": state.referenced,
        }

    def reset_state(self, state: str) -> None:
        """Discards the previous state."""
        self.state.state, self.state.enabled = state, False
        self.state.position = self.state.velocity = None

    def on_silence(self) -> None:
        """Discards the state of a drive that has not responded for too long."""
        self.reset_state("silent")

    # -- setting up -------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Reads the EDS file."""
        if path := self.binding.option("eds"):
            self.objects.load(path, self.context.note)

    def call(self) -> None:
        """Requests the device type: a node need not send heartbeats before its set-up."""
        self.objects.ping()

    async def setup(self) -> str:
        """Identifies the drive, sets it up, and starts its process data."""
        node, note, error = self.objects, self.context.note, self.context.error
        self.configured = False
        identity = await setting.identify(node, error)
        self.conflict = ""
        if await node.has_id_conflict():
            self.conflict = f"two devices answer to this node id ({self.node}); give each its own"
            raise error(self.conflict)
        # Some drives change their process data only before they are operational (CiA 301, 7.3.2.2).
        await self.bus.send(Frame(t.NMT, bytes([t.NMT_PREPARE, self.node])))
        await setting.set_heartbeat(node, error)
        self.pdo_configuration = PdoConfiguration()
        self.pdo_configuration = await pdo_setup.configure_pdos(node, self.node, error, note)
        node.set_write_handler(self.pdo_configuration.data.on_written)
        await setting.read_ratings(node, self.units)
        await setting.set_limits(node, self.binding, self.units, note)
        policy = self.binding.without_policy
        if policy and policy.do == "torque_hold" != self.binding.safe_state:
            raise error(
                "its quick stop has a single behaviour: 'do: torque_hold' requires 'safe_state: torque_hold'"
            )
        await setting.set_quick_stop(node, self.binding.safe_state, error, note)
        self.modes = await setting.optional(node, 0x6502) or 0
        if self._watchdog_time:
            await self.set_watchdog(self._watchdog_time)
        await self._start()
        self.configured, self.needs_setup = True, False
        return f"CiA 402 drive, node {self.node}, {identity}"

    async def serial(self) -> str:
        """`serial number 1001` from object 0x1018 of CiA 301; or ''."""
        number = await setting.optional(self.objects, 0x1018, 4)
        return f"serial number {number}" if number else ""

    async def _start(self) -> None:
        """Makes the node operational; waits for state and motion."""
        self._nmt = None
        if self.pdo_configuration.by_sync:
            self._sync_id = (await setting.optional(self.objects, 0x1005) or t.SYNC) & 0x7FF
            self.context.sync.require(self.node, self._sync_id)
        await self.bus.send(Frame(t.NMT, bytes([t.NMT_START, self.node])))
        await self.expect(lambda: self._nmt == t.OPERATIONAL, STEP_TIMEOUT, "it did not become operational")
        self.state.position = self.state.velocity = None
        if self.pdo_configuration.by_changes:
            await self.read_state()
        await self.expect(
            lambda: None not in (self.state.position, self.state.velocity) and bool(self.state.state),
            STEP_TIMEOUT,
            "it sent no process data",
        )

    async def set_watchdog(self, longest: float) -> float | None:
        """Sets the consumer heartbeat of the drive, which our heartbeats feed from now on."""
        self._watchdog_time = longest
        master: int = self.binding.option("master")
        self._heartbeat_task.start(longest / 4.0, lambda: self.bus.post(self._heartbeat_frame))
        note, safe_state = self.context.note, self.binding.safe_state
        seconds = await setting.set_watchdog(self.objects, master, longest, safe_state, note)
        # Monitoring starts with the first heartbeat that the drive receives (CiA 301, 7.2.8.2.2).
        await self.bus.send(self._heartbeat_frame)
        return seconds

    async def read_state(self) -> None:
        """Reads by SDO the values that process data contain. Raises DeviceError.

        An answer may be older than concurrent process data, which are not repeated without a change: data
        received since the request take precedence.
        """
        for entry in (t.POSITION, t.VELOCITY, t.STATUS):
            count = self._report_counts[entry]
            value = await self.objects.read(entry >> 16)
            if self._report_counts[entry] == count:
                self.on_values({entry: value})

    async def poll(self) -> Mapping[str, object]:
        """Reads the supply voltage, the cause of an unreported fault, and values that are sent only on
        change.

        A powered second node may have been connected without a boot-up message: then the following set-up
        reports it.
        """
        if await self.objects.has_id_conflict(briefly=True):
            self.configured, self.needs_setup = False, True
            self.reset_state("not set up")
            return self._state_telemetry()
        if self.pdo_configuration.by_changes:
            await self.read_state()
        volts = await self._supply()
        fault = await self._fault_cause()
        return {**(self._unchanged_telemetry() if self.pdo_configuration.by_changes else fault), **volts}

    async def _fault_cause(self) -> dict[str, object]:
        if not self.state.fault or self._error_code:
            return {}
        self._error_code = await setting.optional(self.objects, 0x603F) or 0
        self._register = await setting.optional(self.objects, 0x1001) or 0
        return self.on_status(self.statusword) or {}

    async def _supply(self) -> dict[str, object]:
        if not self._has_voltage:
            return {}
        millivolts = await setting.optional(self.objects, 0x6079)
        self._has_voltage = millivolts is not None
        return {} if millivolts is None else {"voltage": millivolts / 1000.0}

    def set_quiet(self, is_quiet: bool) -> None:
        """Stops (or starts) our heartbeats, which feed the watchdog of the drive."""
        if is_quiet:
            self._heartbeat_task.stop()
            self.context.sync.release(self.node)
            return
        if self._watchdog_time:
            # Immediately: its watchdog may be about to expire.
            self.bus.post(self._heartbeat_frame)
            self._heartbeat_task.resume()
        if self.pdo_configuration.by_sync:
            self.context.sync.require(self.node, self._sync_id)

    def close(self) -> None:
        """Stops heartbeats and transfers."""
        self._heartbeat_task.stop()
        self.context.sync.release(self.node)
        self.objects.close()
