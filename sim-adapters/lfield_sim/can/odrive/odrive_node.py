"""An ODrive axis on the bus (CANSimple). Pure; stepped by time. Without a brake: in IDLE the load moves
the axis.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Mapping
from typing import Any

from lfield_sim.can.can_bus import CanFrame, FaultLookup
from lfield_sim.can.can_motor import CanMotor, CanMotorData
from lfield_sim.can.odrive import cansimple_table
from lfield_sim.can.odrive.odrive_axis import OdriveAxis
from lfield_sim.state_log import Facts

VERSION = (2, 4, 4, 58, 0, 6, 9, 0)


class OdriveNode:
    """The axis with a node id from 0 to 63 (see `bus_world.BusDevice`)."""

    def __init__(self, node: int, flaw: FaultLookup, data: CanMotorData, *, watchdog: float = 0.0) -> None:
        self._node, self._flaw = node, flaw
        self.motor = CanMotor(data)
        self.axis = OdriveAxis(self.motor)
        self._watchdog = watchdog
        self._random = random.Random(node)
        self._reset()

    @property
    def id(self) -> str:
        """The node id."""
        return str(self._node)

    def power_up(self) -> list[CanFrame]:
        """Restarts, idle; sends no frame at once."""
        self._reset()
        return []

    def power_down(self) -> None:
        """Disarms the axis: the motor coasts."""
        self.axis.disarm()

    def on_frame(self, frame: CanFrame) -> list[CanFrame]:
        """Receives a frame; returns the answers."""
        if frame.error or frame.fd or frame.extended or frame.identifier >> 5 != self._node:
            return []
        command = frame.identifier & 0x1F
        if command in cansimple_table.GETTERS and (frame.remote or not frame.data):
            return [self._answer(command)]
        if command == cansimple_table.RX_SDO and not frame.remote:
            return self._sdo(frame.data)
        layout = cansimple_table.SETTERS.get(command)
        if layout is None or frame.remote or len(frame.data) < struct.calcsize(layout):
            return []
        values = struct.unpack_from(layout, frame.data)
        if any(isinstance(value, float) and not math.isfinite(value) for value in values):
            return []
        return self._setters[command](self, *values) or []

    def step(self, dt: float) -> list[CanFrame]:
        """Advances time; returns the frames that the node sends."""
        self.motor.stuck = bool(self._flaw("stuck"))
        self.motor.overheated = bool(self._flaw("overheat"))
        if self._flaw("overcurrent"):
            self.axis.fail(cansimple_table.AxisError.CURRENT_LIMIT_VIOLATION)
        if self._flaw("follow_error"):
            self.axis.fail(cansimple_table.AxisError.SPINOUT_DETECTED)
        self.axis.step(dt)
        return [self._message(command) for command in self._due(dt)]

    def facts(self) -> Facts:
        """Log entries of its axis."""
        return self.axis.facts()

    def _reset(self) -> None:
        self.axis.reset()
        self.axis.watchdog = self._watchdog
        self.axis.watching = self._watchdog > 0.0
        self._periods = dict(cansimple_table.CYCLIC)
        self._since = dict.fromkeys(self._periods, 0.0)

    def _due(self, dt: float) -> list[int]:
        due = []
        for command, period in self._periods.items():
            self._since[command] += dt
            if not period or self._since[command] < period - 1e-9:
                continue
            self._since[command] = 0.0
            if not self._flaw("lost_heartbeat" if command == cansimple_table.HEARTBEAT else "lost_tpdo"):
                due.append(command)
        return due

    def _answer(self, command: int) -> CanFrame:
        if self._random.random() < self._flaw("nonsense"):
            return self._frame(command, self._random.randbytes(8))
        return self._message(command)

    def _message(self, command: int) -> CanFrame:
        return self._frame(
            command, struct.pack(cansimple_table.GETTERS[command], *self._getters[command](self))
        )

    def _frame(self, command: int, data: bytes) -> CanFrame:
        return CanFrame(self._node << 5 | command, data)

    def _estop(self) -> None:
        self.axis.fail(cansimple_table.AxisError.ESTOP_REQUESTED)

    def _sdo(self, data: bytes) -> list[CanFrame]:
        """A parameter: a read uses the first four bytes, a write has its value after them."""
        if len(data) < struct.calcsize(cansimple_table.SDO_HEAD):
            return []
        operation, endpoint, _ = struct.unpack_from(cansimple_table.SDO_HEAD, data)
        if endpoint not in cansimple_table.ENDPOINTS:
            return []
        name, layout = cansimple_table.ENDPOINTS[endpoint]
        if operation == cansimple_table.WRITE:
            value = data[struct.calcsize(cansimple_table.SDO_HEAD) :]
            if len(value) == struct.calcsize(layout):
                self._set(name, struct.unpack(layout, value)[0])
            return []
        data = struct.pack("<BHB", 0, endpoint, 0) + struct.pack(layout, self._get(name))
        return [self._frame(cansimple_table.TX_SDO, data)]

    def _get(self, name: str) -> Any:
        return {
            "axis0.config.enable_watchdog": self.axis.watching,
            "axis0.config.watchdog_timeout": self.axis.watchdog,
            "axis0.controller.config.vel_ramp_rate": self.axis.ramp_rate,
            "axis0.config.can.heartbeat_msg_rate_ms": round(1000 * self._periods[cansimple_table.HEARTBEAT]),
            "axis0.config.can.encoder_msg_rate_ms": round(1000 * self._periods[0x09]),
        }[name]

    def _set(self, name: str, value: Any) -> None:
        if not math.isfinite(value) or value < 0:
            return
        match name:
            case "axis0.config.enable_watchdog":
                self.axis.watching = value
                self.axis.feed()
            case "axis0.config.watchdog_timeout":
                self.axis.watchdog = value
            case "axis0.controller.config.vel_ramp_rate":
                self.axis.ramp_rate = value
            case "axis0.config.can.heartbeat_msg_rate_ms":
                self._periods[cansimple_table.HEARTBEAT] = value / 1000.0
            case "axis0.config.can.encoder_msg_rate_ms":
                self._periods[0x09] = value / 1000.0

    def _reboot(self, action: int) -> None:
        if action == 0:
            self._reset()

    _setters: Mapping[int, Callable[..., list[CanFrame] | None]] = {
        cansimple_table.ESTOP: _estop,
        0x07: lambda self, state: self.axis.request(state),
        0x0B: lambda self, control, mode: self.axis.set_mode(control, mode),
        0x0C: lambda self, p, v, t: self.axis.set_position(p, 0.001 * v, 0.001 * t),
        0x0D: lambda self, velocity, torque: self.axis.set_velocity(velocity, torque),
        0x0E: lambda self, torque: self.axis.set_torque(torque),
        0x0F: lambda self, velocity, current: self.axis.set_limits(velocity, current),
        0x11: lambda self, velocity: self.axis.set_trajectory_speed(velocity),
        0x12: lambda self, acceleration, deceleration: self.axis.set_trajectory_ramps(
            acceleration, deceleration
        ),
        cansimple_table.REBOOT: _reboot,
        cansimple_table.CLEAR_ERRORS: lambda self, _: self.axis.clear(),
        0x19: lambda self, position: self.axis.set_place(position),
    }

    _getters: Mapping[int, Callable[[OdriveNode], tuple[float, ...]]] = {
        cansimple_table.GET_VERSION: lambda self: VERSION,
        cansimple_table.HEARTBEAT: lambda self: self.axis.heartbeat,
        0x03: lambda self: (self.axis.active, self.axis.reason),
        0x09: lambda self: (self.axis.position, self.axis.velocity),
        0x14: lambda self: (self.motor.current, self.motor.current),
        0x15: lambda self: (self.motor.temperature - 5.0, self.motor.temperature),
        0x17: lambda self: (self.motor.voltage, self.motor.supply_current),
        0x1C: lambda self: (self.motor.torque, self.motor.torque),
        0x1D: lambda self: (
            self.motor.voltage * self.motor.supply_current,
            self.motor.torque * self.motor.speed,
        ),
    }
