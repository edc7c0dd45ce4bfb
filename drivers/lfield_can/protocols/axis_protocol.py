"""The interface of axis protocols. All values are of the axis, after its gear, in SI units."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from msgspec import Struct

from lfield.driver import Clock, DeviceBinding, DeviceError
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.frames import Frame
from lfield_can.timing import ChangeNotifier, Sync


class AxisState(Struct):
    """The newest state of the device; None is unknown.

    `enabled`: it follows commands. `fault` is in words, '' for none. `referenced`: its zero position is
    known.
    """

    position: float | None = None
    velocity: float | None = None
    state: str = ""
    fault: str = ""
    enabled: bool = False
    referenced: bool = False


class ProtocolContext(Struct, frozen=True):
    """The objects that a protocol uses. `error` creates an exception, `note` writes to the log."""

    binding: DeviceBinding
    bus: Bus
    sync: Sync
    clock: Clock
    changes: ChangeNotifier
    note: Callable[[str], None]
    error: Callable[..., DeviceError]


class AxisProtocol:
    """One axis with one protocol. No method blocks; every wait is bounded and ends in a DeviceError.

    The caller has checked limits, contact, and for motions that the axis is enabled.
    """

    #: Seconds without a message after which the device is lost.
    silence = 0.5

    def __init__(self, context: ProtocolContext) -> None:
        self.context, self.binding, self.bus = context, context.binding, context.bus
        self.node: int = context.binding.option("node")
        self.state = AxisState()
        self.needs_setup = False
        #: The reason why two devices seem to have this id; '' otherwise.
        self.conflict = ""
        sign = -1.0 if context.binding.option("reversed") else 1.0
        #: Turns of the motor for one radian of the axis.
        self.turns: float = sign * context.binding.option("gear") / math.tau

    def ids(self) -> frozenset[int]:
        """The ids of all frames of the device, unique on the bus."""
        raise NotImplementedError

    def overheard(self) -> frozenset[int]:
        """The ids of other senders' frames to the device that it must observe."""
        return frozenset()

    def on_overheard(self, frame: Frame) -> None:
        """Handles a frame to the device, which does not prove contact."""

    def prepare(self) -> None:
        """Reads files before the bus is opened; may block. Raises DeviceError."""

    def call(self) -> None:
        """Requests a message from a device that sends none by itself."""

    def on_frame(self, frame: Frame) -> Mapping[str, object] | None:
        """Handles a frame of the device: returns telemetry, or None if the frame is invalid.

        Never raises.
        """
        raise NotImplementedError

    async def setup(self) -> str:
        """Finds the device and sets it up, not enabled; returns its identity. Called again after its
        restart.
        """
        raise NotImplementedError

    async def serial(self) -> str:
        """As `Device._serial`."""
        return ""

    async def set_watchdog(self, longest: float) -> float | None:
        """As `Device._set_watchdog`."""
        return None

    async def enable(self) -> None:
        """Enables the axis at rest; done when the device confirms it."""
        raise NotImplementedError

    async def disable(self) -> None:
        """Switches the torque off; done when the device confirms it."""
        raise NotImplementedError

    async def reset_fault(self) -> None:
        """Clears the faults; done when the device reports none."""
        raise NotImplementedError

    async def home(self) -> None:
        """Finds the zero position; done when the device confirms it."""
        raise NotImplementedError

    async def start_move(self, position: float, speed: float) -> None:
        """Starts a motion to a position, by the profile of the device."""
        raise NotImplementedError

    async def start_halt(self) -> None:
        """Slows down from any motion and stays enabled; no effect on a disabled axis."""
        raise NotImplementedError

    async def end_halt(self) -> None:
        """Ensures, when the axis is at rest, that no earlier goal takes effect."""

    async def set_position(self, position: float) -> None:
        """Sends a position setpoint."""
        raise NotImplementedError

    async def set_velocity(self, velocity: float) -> None:
        """Sends a velocity setpoint."""
        raise NotImplementedError

    async def set_torque(self, torque: float) -> None:
        """Sends a torque setpoint."""
        raise NotImplementedError

    async def command_safe(self, state: str) -> None:
        """Sends the command for a safe state, without waiting; repeated until `is_safe`."""
        raise NotImplementedError

    def is_safe(self, state: str, is_still: bool) -> bool:
        """Whether the device reports that safe state; `is_still`: the axis does not turn."""
        raise NotImplementedError

    async def poll(self) -> Mapping[str, object]:
        """Requests values that the device does not send by itself, once a second; not on a muted bus."""
        return {}

    def set_quiet(self, is_quiet: bool) -> None:
        """Stops (or starts) the frames that feed the device's own watchdog."""

    def on_silence(self) -> None:
        """Discards the state of a device that has not responded for too long."""
        self.state.enabled = False
        self.state.position = self.state.velocity = None

    def close(self) -> None:
        """Ends the protocol when the driver ends."""

    # -- for subclasses ---------------------------------------------------------------------------------

    async def expect(self, condition: Callable[[], bool], timeout: float, failure: str) -> None:
        """Waits until the state fulfils a condition. Raises DeviceError with the text `failure`."""
        if not await self.context.changes.wait_for(condition, timeout):
            fault = f"; fault: {self.state.fault}" if self.state.fault else ""
            raise self.context.error(
                f"{failure} within {timeout:g} s (it is {self.state.state or 'silent'}{fault})"
            )

    def limit(self, name: str) -> float | None:
        """A limit of the binding, or None."""
        return self.binding.limits.get(name)
