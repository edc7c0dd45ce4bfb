"""Devices that are functions of a DroneCAN node: their base class, and the sensors."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping

from lfield.driver import Clock, Device, DeviceBinding, DeviceError, Manifest, Reports
from lfield_can import log_messages
from lfield_can.bus.frames import Frame
from lfield_can.drone_can.messages import (
    BATTERY_FAULTS,
    BATTERY_FLAGS,
    BATTERY_INFO,
    ESC_STATUS,
    HEALTH,
    KELVIN,
    NODE_STATUS,
    OPERATIONAL,
    DataType,
    NodeInfo,
    Values,
    decode,
)
from lfield_can.drone_can.network import DroneCanNetwork
from lfield_can.timing import ChangeNotifier

#: Seconds between two checks of a silent node, and between two requests for its identity.
WATCH_INTERVAL, ASK_INTERVAL = 0.1, 0.3
#: Bytes of a unique id.
UNIQUE_ID = 16
#: Restarts or repeated transfers within this many seconds that are two nodes with one id: their uptimes
#: alternate, or they count their transfers alike because they were switched on together.
CONFLICT_TIME, CONFLICT_COUNT = 5.0, 3


class DroneCanDevice(Device):
    """One function of a node. A subclass has `reported`, the message with its measured values."""

    reported: DataType

    def __init__(
        self,
        binding: DeviceBinding,
        manifest: Manifest,
        clock: Clock,
        reports: Reports,
        network: DroneCanNetwork,
    ) -> None:
        super().__init__(binding, manifest, clock, reports)
        self.network, self.changes = network, ChangeNotifier(clock)
        self.node: int = binding.option("node")
        self.master: int = binding.option("master")
        self.unique_id = b""
        #: The last message of measured values.
        self.values: Values = {}
        self._last_contact = -math.inf
        self._info: NodeInfo | None = None
        self._uptime, self._status_number = -1.0, -1
        self._restarts: list[float] = []
        self._lost = self._opened = False

    def prepare(self) -> None:
        """Checks the options of the device. Raises DeviceError."""
        text: str = self.binding.option("unique_id")
        try:
            self.unique_id = bytes.fromhex(text)
        except ValueError:
            self.unique_id = b"?"
        if len(self.unique_id) not in (0, UNIQUE_ID):
            raise self.error(f"'unique_id' has 32 hexadecimal digits, not '{text}'")
        self.network.join(self)

    def listens(self) -> frozenset[int]:
        """No keys: the network dispatches the frames of the node."""
        return frozenset()

    def commands(self) -> frozenset[int]:
        """No keys: frames of nodes have the id of their sender."""
        return frozenset()

    def on_frame(self, frame: Frame) -> None:
        """Never called: the network dispatches the frames of the node."""

    def set_quiet(self, is_quiet: bool) -> None:
        """Has no effect: a sensor is sent no frames."""

    def close(self) -> None:
        """The driver ends."""

    # -- messages of the node -------------------------------------------------------------------------

    def on_transfer(self, data_type: int, number: int, data: bytes) -> None:
        """Handles a message of the node: its status, or measured values of this function."""
        if data_type == NODE_STATUS.id and (decoded := decode(NODE_STATUS, data)):
            self._on_status(decoded[0], number)
            return
        if data_type != self.reported.id or (decoded := decode(self.reported, data)) is None:
            return
        values = {name: value for name, value in decoded[0].items() if math.isfinite(value)}
        if values.get("index") != self.binding.option("index"):
            return
        self.values, self._last_contact = values, self.clock.monotonic()
        self.heard()
        self.publish(**self.measured(values))
        self.changes.notify()

    def on_node_info(self, info: NodeInfo) -> None:
        """Handles the answer of the node about its identity."""
        self._info = info
        self.changes.notify()

    def measured(self, values: Values) -> Mapping[str, object]:
        """The telemetry of the function; unknown values (NaN) are absent."""
        raise NotImplementedError

    def _on_status(self, values: Values, number: int) -> None:
        now, uptime = self.clock.monotonic(), values["uptime"]
        if uptime < self._uptime or number == self._status_number:
            self._restarts = [at for at in self._restarts if now - at <= CONFLICT_TIME] + [now]
            if self.has_conflict:
                self.breach(f"two nodes have id {self.node}: both send their status; give each its own")
            elif uptime < self._uptime:
                self.note(log_messages.NODE_RESTARTED.line(node=self.node))
        self._uptime, self._status_number = uptime, number
        mode = "" if values["mode"] == OPERATIONAL else f", mode {values['mode']:.0f}"
        self.publish(health=f"{HEALTH[int(values['health'])]}{mode}")

    @property
    def has_conflict(self) -> bool:
        """Whether two nodes seem to have the id of this node."""
        if len(self._restarts) < CONFLICT_COUNT:
            return False
        return self.clock.monotonic() - self._restarts[-1] <= CONFLICT_TIME

    async def watch(self) -> None:
        """Logs loss and recovery of the device."""
        while True:
            await asyncio.sleep(WATCH_INTERVAL)
            if not self._opened:
                continue
            is_silent = self.silence > self.max_silence
            self.publish(online=not is_silent)
            if is_silent:
                self._on_loss()
            elif self._lost:
                self._lost = False
                self.note(log_messages.RESPONDING.line())
                await self.on_recovery()

    def _on_loss(self) -> None:
        if not self._lost:
            self._lost = True
            self.note(log_messages.SILENT.line())

    async def on_recovery(self) -> None:
        """Called when messages of the node arrive again after a loss."""

    # -- opening --------------------------------------------------------------------------------------

    @property
    def max_silence(self) -> float:
        """Seconds without a message of the function after which it is lost."""
        max_age: float = self.binding.option("max_age")
        return max_age

    @property
    def silence(self) -> float:
        """Seconds since the last message of the function."""
        return self.clock.monotonic() - self._last_contact

    def contact_error(self) -> DeviceError:
        """The error for missing messages. The loss is recorded, so that the device is made safe when messages
        arrive again, even soon.
        """
        self._on_loss()
        cause = self.network.problem_text
        cause_text = f" ({cause})" if cause else ""
        return self.error(f"no message for {self.silence:.1f} s{cause_text}", timeout=True)

    async def _open(self) -> str:
        timeout: float = self.binding.option("connect")
        end = self.clock.monotonic() + timeout
        if not await self.changes.wait_for(lambda: bool(self.values), timeout):
            raise self.error(self._absence(timeout), timeout=True)
        while self._info is None and self.clock.monotonic() < end:
            self.network.ask_node_info(self.node)
            await self.changes.wait_for(lambda: self._info is not None, ASK_INTERVAL)
        if self._info is None:
            raise self.error(f"node {self.node} does not answer requests for its identity", timeout=True)
        if self.unique_id and self._info.unique_id != self.unique_id:
            raise self.error(
                f"node {self.node} has the unique id {self._info.unique_id.hex()}, not that of its binding; "
                "correct 'unique_id', or find the node with that id"
            )
        self._opened = True
        self.publish(online=True)
        name = self._info.name or "without a name"
        return f"DroneCAN node {self.node} {name}, software {self._info.software}"

    def _absence(self, timeout: float) -> str:
        index = self.binding.option("index")
        kind = type(self).__name__
        if self._uptime >= 0.0:
            return f"node {self.node} sends no {kind} messages with index {index}; check 'index'"
        within = f"within {timeout:g} s"
        if self.unique_id:
            return f"no node with this unique id asked for its id, or is node {self.node}, {within}"
        return (
            f"no message of node {self.node} at {self.binding.endpoint} {within}; check its power, wires and "
            "terminators, the bit rate, and 'node' (a node without a fixed id needs 'unique_id')"
        )

    def _touched(self) -> bool:
        """Always False: opening only requests the identity of the node."""
        return False

    async def _serial(self) -> str:
        return f"uid {self._info.unique_id.hex()}" if self._info is not None else ""


def supply(values: Values) -> dict[str, object]:
    """Voltage, current and temperature in degrees Celsius, as far as they are known."""
    telemetry: dict[str, object] = {name: values[name] for name in ("voltage", "current") if name in values}
    if "temperature" in values:
        telemetry["temperature"] = values["temperature"] - KELVIN
    return telemetry


class DroneCanBattery(DroneCanDevice):
    """A battery: uavcan.equipment.power.BatteryInfo."""

    reported = BATTERY_INFO

    def measured(self, values: Values) -> Mapping[str, object]:
        """The telemetry of a battery; its charge is 0 to 1."""
        flags = int(values["flags"])
        texts = [text for bit, text in BATTERY_FLAGS.items() if flags & bit]
        faults = [text for bit, text in BATTERY_FLAGS.items() if flags & bit & BATTERY_FAULTS]
        telemetry = supply(values)
        telemetry["charge"] = values["charge"] / 100.0
        return {**telemetry, "state": ", ".join(texts), "fault": ", ".join(faults)}


class DroneCanEsc(DroneCanDevice):
    """The status of a motor controller: uavcan.equipment.esc.Status. It is not commanded."""

    reported = ESC_STATUS

    def measured(self, values: Values) -> Mapping[str, object]:
        """The telemetry of a motor controller; its power is a share of the greatest."""
        telemetry = supply(values)
        telemetry["speed"] = values["rpm"] * math.tau / 60.0
        return {**telemetry, "power": values["power"] / 100.0, "errors": int(values["error_count"])}
