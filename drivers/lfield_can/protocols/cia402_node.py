"""A CiA 402 drive as a node of CANopen: what it says, how it is set up, our heartbeat to it."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

from lfield_can.bus.frames import Frame
from lfield_can.protocols import cia402_setup as setting
from lfield_can.protocols import cia402_tables as t
from lfield_can.protocols.axis_protocol import AxisProtocol, Wiring
from lfield_can.protocols.canopen_node import CanopenNode
from lfield_can.protocols.cia402_tables import Units
from lfield_can.timing import Repeating

#: Seconds for one step of a state machine.
STEP = 1.0
#: Seconds without process data after which position and velocity are not known any more.
OLD = 0.3


class Cia402Node(AxisProtocol):
    """One drive, set up and heard."""

    def __init__(self, wiring: Wiring) -> None:
        super().__init__(wiring)
        option = self.binding.option
        if self.node == 0:
            raise wiring.error("a CANopen node id is 1 to 127; node 0 is all of them")
        if option("counts") == 0:
            raise wiring.error(
                "cia402 needs 'counts' in its binding: position counts in one turn of the motor"
            )
        self.units = Units(
            self.turns,
            option("counts"),
            option("velocity_unit"),
            option("rated_torque"),
            option("rated_current"),
        )
        self.objects = CanopenNode(self.binding.field, self.node, self.bus.post)
        self._beats = Repeating(wiring.clock)
        self._handlers: Mapping[int, Callable[..., Mapping[str, object] | None]] = {
            t.HEARTBEAT: self._on_heartbeat,
            t.STATUS: self.on_status,
            t.MOTION: self._on_motion,
            t.FORCE: self._on_force,
            t.EMERGENCY: self._on_emergency,
        }
        self._longest = 0.0
        self._nmt: int | None = None
        self.statusword = self._error_code = self._register = 0
        self.mapped: frozenset[int] = frozenset()
        self._motion_at = -OLD
        #: Bits of the modes that it has, 0 when it does not tell.
        self.modes = 0
        self.configured = False
        self._has_voltage = True

    # -- what the drive says ----------------------------------------------------------------------------

    def ids(self) -> frozenset[int]:
        """Everything that a node of this id sends."""
        codes = (t.EMERGENCY, t.STATUS, t.MOTION, t.FORCE, t.SDO_ANSWER, t.HEARTBEAT)
        return frozenset(code + self.node for code in codes)

    def on_frame(self, frame: Frame) -> Mapping[str, object] | None:
        """One frame of the node."""
        code = frame.id - self.node
        if code == t.SDO_ANSWER:
            self.objects.on_answer(frame.data)
            return {}
        if code in t.TRANSMITTED and code not in self.mapped:
            return {}  # it is not ours yet: laid out as somebody else has set it up
        try:
            values = t.LAYOUTS[code].unpack(frame.data)
        except struct.error:
            return None
        return self._handlers[code](*values)

    def _on_heartbeat(self, value: int) -> dict[str, object]:
        self._nmt = value & 0x7F
        if self._nmt == t.BOOTED:
            self.state.referenced = False
        if self.configured and self._nmt != t.OPERATIONAL:
            self.configured, self.needs_setup = False, True
            self.forget("not operational")
        if self.wiring.clock.monotonic() - self._motion_at > OLD:
            self.state.position = self.state.velocity = None
        return {}

    def on_status(self, statusword: int) -> dict[str, object] | None:
        state = t.state_of(statusword)
        if not state:
            return None
        self.statusword, self.state.state = statusword, state
        self.state.enabled = state == "operation enabled"
        if not state.startswith("fault"):
            self._error_code = self._register = 0
        words = t.error_words(self._error_code, self._register) or "fault"
        self.state.fault = words if state.startswith("fault") else ""
        return self._told()

    def _on_motion(self, position: int, velocity: int) -> dict[str, object]:
        self._motion_at = self.wiring.clock.monotonic()
        self.state.position, self.state.velocity = (
            self.units.position(position),
            self.units.velocity(velocity),
        )
        return {"position": self.state.position, "velocity": self.state.velocity}

    def _on_force(self, torque: int, current: int) -> dict[str, object]:
        values: dict[str, object] = {}
        if self.units.rated_torque:
            values["torque"] = self.units.torque(torque)
        if self.units.rated_current:
            values["current"] = current / 1000.0 * self.units.rated_current
        return values

    def _on_emergency(self, code: int, register: int) -> dict[str, object]:
        self._error_code, self._register = code, register
        if code:
            self.wiring.note(f"emergency: {t.error_words(code, register)}")
        return {}

    def _told(self) -> dict[str, object]:
        state = self.state
        return {
            "state": state.state,
            "fault": state.fault,
            "enabled": state.enabled,
            "referenced": state.referenced,
        }

    def forget(self, state: str) -> None:
        """What was known is not true any more."""
        self.state.state, self.state.enabled = state, False
        self.state.position = self.state.velocity = None

    def silent(self) -> None:
        """Not heard for too long."""
        self.forget("silent")

    # -- setting up -------------------------------------------------------------------------------------

    def prepare(self) -> None:
        """Read the EDS file."""
        if path := self.binding.option("eds"):
            self.objects.load(path)

    def call(self) -> None:
        """Ask for the device type: a node need not have heartbeats before it is set up."""
        self.objects.ping()

    async def setup(self) -> str:
        """Identify it, set everything up, and start its process data."""
        node, note, error = self.objects, self.wiring.note, self.wiring.error
        self.configured = False
        identity = await setting.identify(node, error)
        await setting.set_heartbeat(node)
        self.mapped = await setting.map_process_data(node, self.node, note)
        await setting.read_ratings(node, self.units)
        await setting.set_limits(node, self.binding, self.units, note)
        await setting.set_quick_stop(node, self.binding.safe_state, error)
        self.modes = await setting.optional(node, 0x6502) or 0
        if self._longest:
            await self.set_watchdog(self._longest)
        await self._start()
        self.configured, self.needs_setup = True, False
        return f"CiA 402 drive, node {self.node}, {identity}"

    async def _start(self) -> None:
        """Operational, and telling its state and motion."""
        self._nmt = None
        await self.bus.send(Frame(t.NMT, bytes([t.NMT_START, self.node])))
        await self.expect(lambda: self._nmt == t.OPERATIONAL, STEP, "it did not become operational")
        self.state.position = None
        await self.expect(
            lambda: self.state.position is not None and bool(self.state.state),
            STEP,
            "it sent no process data",
        )

    async def set_watchdog(self, longest: float) -> float | None:
        """Its consumer heartbeat, which our own heartbeats feed from now on."""
        self._longest = longest
        master: int = self.binding.option("master")
        beat = Frame(t.HEARTBEAT + master, bytes([t.OPERATIONAL]))
        self._beats.start(longest / 4.0, lambda: self.bus.post(beat))
        note, safe_state = self.wiring.note, self.binding.safe_state
        seconds = await setting.set_watchdog(self.objects, master, longest, safe_state, note)
        # The drive begins to watch with the first heartbeat that it hears from now on (CiA 301, 7.2.8.2.2).
        await self.bus.send(beat)
        return seconds

    async def poll(self) -> Mapping[str, object]:
        """The supply voltage, and the cause of a fault that was not told."""
        values: dict[str, object] = {}
        if self.state.fault and not self._error_code:
            self._error_code = await setting.optional(self.objects, 0x603F) or 0
            self._register = await setting.optional(self.objects, 0x1001) or 0
            values.update(self.on_status(self.statusword) or {})
        if self._has_voltage:
            millivolts = await setting.optional(self.objects, 0x6079)
            self._has_voltage = millivolts is not None
            if millivolts is not None:
                values["voltage"] = millivolts / 1000.0
        return values

    def quiet(self, on: bool) -> None:
        """Our heartbeats feed its watchdog."""
        if on:
            self._beats.stop()
        elif self._longest:
            self._beats.again()

    def close(self) -> None:
        """No heartbeats, no worker."""
        self._beats.stop()
        self.objects.close()
