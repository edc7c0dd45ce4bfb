"""A CiA 402 drive as a node of CANopen: what it says, how it is set up, our heartbeat to it."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping

from lfield_can.bus.frames import Frame
from lfield_can.protocols import cia402_setup as setting
from lfield_can.protocols import cia402_tables as t
from lfield_can.protocols import pdo_setup
from lfield_can.protocols.axis_protocol import AxisProtocol, Wiring
from lfield_can.protocols.canopen_node import CanopenNode
from lfield_can.protocols.cia402_tables import Units
from lfield_can.protocols.pdo_setup import Agreed
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
        #: Its process data, none before they are agreed on.
        self.agreed = Agreed()
        self._sync_id = t.SYNC
        self._longest = 0.0
        #: Our heartbeat, which the drive watches.
        self._beat = Frame(t.HEARTBEAT + self.binding.option("master"), bytes([t.OPERATIONAL]))
        self._nmt: int | None = None
        self.statusword = self._error_code = self._register = 0
        #: When position and velocity were told last.
        self._told_at = dict.fromkeys((t.POSITION, t.VELOCITY), -OLD)
        #: How often process data have told each.
        self._tellings = Counter[int]()
        #: Bits of the modes that it has, 0 when it does not tell.
        self.modes = 0
        self.configured = False
        self._has_voltage = True

    # -- what the drive says ----------------------------------------------------------------------------

    def ids(self) -> frozenset[int]:
        """Everything that a node of this id sends."""
        codes = (t.EMERGENCY, *t.TRANSMITTED, t.SDO_ANSWER, t.HEARTBEAT)
        return frozenset(code + self.node for code in codes)

    def overheard(self) -> frozenset[int]:
        """Requests of other clients, such as a vendor's tool."""
        return frozenset((t.SDO_REQUEST + self.node,))

    def on_overheard(self, frame: Frame) -> None:
        """A request, of another client or of this one."""
        self.objects.on_heard_request(frame.data)

    def on_frame(self, frame: Frame) -> Mapping[str, object] | None:
        """One frame of the node."""
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
        if not self.agreed.data.tells(frame.id):
            return {}  # it is not ours, or not yet: laid out as somebody else has set it up
        values = self.agreed.data.read(frame.id, frame.data)
        if values is None:
            return None
        self._tellings.update(values.keys())
        return self.on_values(values)

    def on_values(self, values: Mapping[int, int]) -> dict[str, object] | None:
        """What objects have told, by PDO or asked for; None for a status word that no drive has."""
        told: dict[str, object] = {}
        if t.STATUS in values:
            status = self.on_status(values[t.STATUS])
            if status is None:
                return None
            told.update(status)
        now = self.wiring.clock.monotonic()
        self._told_at.update({entry: now for entry in self._told_at if entry in values})
        if t.POSITION in values:
            told["position"] = self.state.position = self.units.position(values[t.POSITION])
        if t.VELOCITY in values:
            told["velocity"] = self.state.velocity = self.units.velocity(values[t.VELOCITY])
        if t.TORQUE in values and self.units.rated_torque:
            told["torque"] = self.units.torque(values[t.TORQUE])
        if t.CURRENT in values and self.units.rated_current:
            told["current"] = values[t.CURRENT] / 1000.0 * self.units.rated_current
        return told

    def _on_heartbeat(self, value: int) -> dict[str, object]:
        self._nmt = value & 0x7F
        if self._nmt == t.BOOTED:
            self.state.referenced = False
        if self.configured and self._nmt != t.OPERATIONAL:
            self.configured, self.needs_setup = False, True
            self.forget("not operational")
            return self._told()
        if self.agreed.by_changes:
            return self._held()
        if self.wiring.clock.monotonic() - min(self._told_at.values()) > OLD:
            self.state.position = self.state.velocity = None
        return {}

    def _held(self) -> dict[str, object]:
        """What comes only when it changes is still so, as long as the node is heard."""
        state = self.state
        if not self.configured or state.position is None or state.velocity is None:
            return {}
        return {**self._told(), "position": state.position, "velocity": state.velocity}

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
            self.objects.load(path, self.wiring.note)

    def call(self) -> None:
        """Ask for the device type: a node need not have heartbeats before it is set up."""
        self.objects.ping()

    async def setup(self) -> str:
        """Identify it, set everything up, and start its process data."""
        node, note, error = self.objects, self.wiring.note, self.wiring.error
        self.configured = False
        identity = await setting.identify(node, error)
        self.conflict = ""
        if await node.is_doubled():
            self.conflict = f"two devices answer to this node id ({self.node}); give each its own"
            raise error(self.conflict)
        # Some drives change their process data only before they are operational (CiA 301, 7.3.2.2).
        await self.bus.send(Frame(t.NMT, bytes([t.NMT_PREPARE, self.node])))
        await setting.set_heartbeat(node, error)
        self.agreed = Agreed()
        self.agreed = await pdo_setup.agree(node, self.node, error, note)
        node.on_written = self.agreed.data.written
        await setting.read_ratings(node, self.units)
        await setting.set_limits(node, self.binding, self.units, note)
        policy = self.binding.without_policy
        if policy and policy.do == "torque_hold" != self.binding.safe_state:
            raise error("its quick stop ends in one way: 'do: torque_hold' needs 'safe_state: torque_hold'")
        await setting.set_quick_stop(node, self.binding.safe_state, error, note)
        self.modes = await setting.optional(node, 0x6502) or 0
        if self._longest:
            await self.set_watchdog(self._longest)
        await self._start()
        self.configured, self.needs_setup = True, False
        return f"CiA 402 drive, node {self.node}, {identity}"

    async def serial(self) -> str:
        """`serial number 1001`, object 0x1018 of CiA 301, by which drives of one vendor differ; or ''."""
        number = await setting.optional(self.objects, 0x1018, 4)
        return f"serial number {number}" if number else ""

    async def _start(self) -> None:
        """Operational, and telling its state and motion."""
        self._nmt = None
        if self.agreed.by_sync:
            self._sync_id = (await setting.optional(self.objects, 0x1005) or t.SYNC) & 0x7FF
            self.wiring.sync.want(self.node, self._sync_id)
        await self.bus.send(Frame(t.NMT, bytes([t.NMT_START, self.node])))
        await self.expect(lambda: self._nmt == t.OPERATIONAL, STEP, "it did not become operational")
        self.state.position = self.state.velocity = None
        if self.agreed.by_changes:
            await self.ask()
        await self.expect(
            lambda: None not in (self.state.position, self.state.velocity) and bool(self.state.state),
            STEP,
            "it sent no process data",
        )

    async def set_watchdog(self, longest: float) -> float | None:
        """Its consumer heartbeat, which our own heartbeats feed from now on."""
        self._longest = longest
        master: int = self.binding.option("master")
        self._beats.start(longest / 4.0, lambda: self.bus.post(self._beat))
        note, safe_state = self.wiring.note, self.binding.safe_state
        seconds = await setting.set_watchdog(self.objects, master, longest, safe_state, note)
        # The drive begins to watch with the first heartbeat that it hears from now on (CiA 301, 7.2.8.2.2).
        await self.bus.send(self._beat)
        return seconds

    async def ask(self) -> None:
        """Read by SDO what process data tell. Raises DeviceError.

        An answer may be older than process data that come beside it, and these come no more where nothing
        changes: what they have told since it was asked for stands.
        """
        for entry in (t.POSITION, t.VELOCITY, t.STATUS):
            tellings = self._tellings[entry]
            value = await self.objects.read(entry >> 16)
            if self._tellings[entry] == tellings:
                self.on_values({entry: value})

    async def poll(self) -> Mapping[str, object]:
        """The supply voltage, the cause of a fault that was not told, and what comes only when it changes.

        A second node may have been plugged in with its power on, without a boot-up message: then the set-up
        comes next, which names it.
        """
        if await self.objects.is_doubled(briefly=True):
            self.configured, self.needs_setup = False, True
            self.forget("not set up")
            return self._told()
        if self.agreed.by_changes:
            await self.ask()
        volts = await self._supply()
        cause = await self._cause()
        return {**(self._held() if self.agreed.by_changes else cause), **volts}

    async def _cause(self) -> dict[str, object]:
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

    def quiet(self, on: bool) -> None:
        """Our heartbeats feed its watchdog."""
        if on:
            self._beats.stop()
            self.wiring.sync.leave(self.node)
            return
        if self._longest:
            # At once: its watchdog may be about to run out, with nobody left to blame.
            self.bus.post(self._beat)
            self._beats.again()
        if self.agreed.by_sync:
            self.wiring.sync.want(self.node, self._sync_id)

    def close(self) -> None:
        """No heartbeats, no transfers."""
        self._beats.stop()
        self.wiring.sync.leave(self.node)
        self.objects.close()
