"""What a protocol of axes must do. All values are of the axis, behind its gear, in SI units."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from lfield.driver import Clock, DeviceBinding, DeviceError
from lfield_can.bus.bus import Bus
from lfield_can.bus.frames import Frame
from lfield_can.timing import News, Sync


@dataclass(slots=True)
class AxisState:
    """The newest that the device said; None is "not heard yet".

    `enabled` means that it follows commands. `fault` is in words, '' when there is none. `referenced` means
    that its zero is known.
    """

    position: float | None = None
    velocity: float | None = None
    state: str = ""
    fault: str = ""
    enabled: bool = False
    referenced: bool = False


@dataclass(frozen=True, slots=True)
class Wiring:
    """What a protocol gets to work with. `error` makes the exception to raise, `note` writes to the log."""

    binding: DeviceBinding
    bus: Bus
    sync: Sync
    clock: Clock
    news: News
    note: Callable[[str], None]
    error: Callable[..., DeviceError]


class AxisProtocol:
    """One axis that speaks one protocol. Nothing blocks; every wait is bounded and ends in a DeviceError.

    The caller has checked limits, that the axis is heard, and for motions that it is enabled.
    """

    #: Seconds without a sign of life after which the device is lost.
    silence = 0.5

    def __init__(self, wiring: Wiring) -> None:
        self.wiring, self.binding, self.bus = wiring, wiring.binding, wiring.bus
        self.node: int = wiring.binding.option("node")
        self.state = AxisState()
        self.needs_setup = False
        #: Why there are two devices with this id, in words; '' where no second one is seen.
        self.conflict = ""
        sign = -1.0 if wiring.binding.option("reversed") else 1.0
        #: Turns of the motor for one radian of the axis.
        self.turns: float = sign * wiring.binding.option("gear") / math.tau

    def ids(self) -> frozenset[int]:
        """The ids of all frames that the device sends; no two axes may share one."""
        raise NotImplementedError

    def overheard(self) -> frozenset[int]:
        """The ids of frames that others may send to the device, which it wants to hear."""
        return frozenset()

    def on_overheard(self, frame: Frame) -> None:
        """A frame to the device: no sign of life of it."""

    def prepare(self) -> None:
        """Read files, before the bus is opened; may block. Raises DeviceError."""

    def call(self) -> None:
        """Make a device speak that does not do so by itself."""

    def on_frame(self, frame: Frame) -> Mapping[str, object] | None:
        """Take a frame of the device in: the telemetry it gives, or None when it makes no sense.

        Never raises, whatever the bytes are.
        """
        raise NotImplementedError

    async def setup(self) -> str:
        """Find the device and set it up, not enabled; its identity. Called again when it has restarted."""
        raise NotImplementedError

    async def serial(self) -> str:
        """As `Device._serial`."""
        return ""

    async def set_watchdog(self, longest: float) -> float | None:
        """As `Device._set_watchdog`."""
        return None

    async def enable(self) -> None:
        """Make it follow commands, standing still; done when it says so."""
        raise NotImplementedError

    async def disable(self) -> None:
        """Switch its torque off; done when it says so."""
        raise NotImplementedError

    async def reset_fault(self) -> None:
        """Clear its faults; done when it says that there are none."""
        raise NotImplementedError

    async def home(self) -> None:
        """Find its zero; done when it says so."""
        raise NotImplementedError

    async def begin_move(self, position: float, speed: float) -> None:
        """Have it travel to a position, by its own profile."""
        raise NotImplementedError

    async def begin_halt(self) -> None:
        """Have it slow down, whatever motion is under way, and stay enabled; one that is not does nothing."""
        raise NotImplementedError

    async def end_halt(self) -> None:
        """It stands: see to it that no goal from before acts again."""

    async def set_position(self, position: float) -> None:
        """One position setpoint."""
        raise NotImplementedError

    async def set_velocity(self, velocity: float) -> None:
        """One velocity setpoint."""
        raise NotImplementedError

    async def set_torque(self, torque: float) -> None:
        """One torque setpoint."""
        raise NotImplementedError

    async def command_safe(self, state: str) -> None:
        """Send what brings it into a safe state, at once; called again until `is_safe`."""
        raise NotImplementedError

    def is_safe(self, state: str, still: bool) -> bool:
        """Whether the device reports that safe state; `still` says that it does not turn."""
        raise NotImplementedError

    async def poll(self) -> Mapping[str, object]:
        """Ask for what the device does not say by itself, about once a second; not while the bus is quiet."""
        return {}

    def quiet(self, on: bool) -> None:
        """Stop (or take up) what feeds the device's own watchdog."""

    def silent(self) -> None:
        """The device has not been heard for too long: forget what it said."""
        self.state.enabled = False
        self.state.position = self.state.velocity = None

    def close(self) -> None:
        """The driver ends."""

    # -- for subclasses ---------------------------------------------------------------------------------

    async def expect(self, condition: Callable[[], bool], bound: float, what: str) -> None:
        """Wait until the device shows it. Raises DeviceError `what` when it does not."""
        if not await self.wiring.news.seen(condition, bound):
            fault = f"; it says: {self.state.fault}" if self.state.fault else ""
            raise self.wiring.error(
                f"{what} within {bound:g} s (it is {self.state.state or 'silent'}{fault})"
            )

    def limit(self, name: str) -> float | None:
        """A limit of the binding, or None."""
        return self.binding.limits.get(name)
