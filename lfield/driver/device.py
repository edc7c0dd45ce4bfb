"""What the author of a driver writes: a Driver for the bus, a Device for each thing on it.

Users of the classes call the public methods; authors override the small ones that start with an
underscore, and write one `do_...` coroutine per instruction of the manifest (`goTo` -> `do_go_to`).

Everything runs on the event loop of the guard's process. A method must never block it: the guard's own
timers live there. A vendor library that blocks belongs into `asyncio.to_thread`.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping, Sequence
from inspect import Parameter as MethodParameter
from inspect import iscoroutinefunction, signature
from typing import Any, NamedTuple

from lfield.clock import Clock
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import WATCHDOG, Manifest, Reports
from lfield.driver.frame import Frame, arguments_from_team, values_to_team
from lfield.driver.settings import Setting, wrong
from lfield.driver.values import CHECKS, Check, conform
from lfield.errors import DeviceError, NotSetUp, PluginError
from lfield.manifest import DeviceValue, Instruction, Parameter

#: The kind of the problem of a device that `lfield setup` sets up, where others have an L exception's name.
NOT_SET_UP = "NotSetUp"


class _Call(NamedTuple):
    """How an instruction is carried out: its coroutine, and what its arguments and its result must be.

    `places` are its parameters where some are about the team's frame, which this device has a place in.
    """

    method: Callable[..., Awaitable[object]]
    arguments: tuple[Check, ...]
    result: Check
    places: Sequence[Parameter] = ()


def method_name(instruction: str) -> str:
    """`goTo` -> `do_go_to`."""
    return "do_" + re.sub(r"([A-Z])", r"_\1", instruction).lower()


class Device:
    """One device on a bus.

    Authors override `_open`, `_make_safe` (but for a pure sensor), for a device that has one
    `_set_watchdog`, for one that opening only asks at first `_touched`, for one that takes its time to
    come to rest `_moving`, for one that others may take over `_taken_over` and `_guard_restarted`, for
    one whose own frame is not simply where its binding says `_frame`, for one that keeps settings which a
    binding needs `_settings`, `_write_setting`, `_in_use` and `_serial`, and write the `do_...`
    coroutines.

    A device that can do much may have `parts`: any objects, made in its constructor, whose `do_...` are
    looked up beside its own. A part takes what it needs (often the device itself, to ask and to publish),
    keeps its own state, and can be tested alone.
    """

    #: What else carries out its instructions, each of them in one place only.
    parts: Sequence[object] = ()

    def __init__(self, binding: DeviceBinding, manifest: Manifest, clock: Clock, reports: Reports) -> None:
        self.binding, self.manifest, self.clock = binding, manifest, clock
        #: The safe state that it was brought into last; until then that of its binding.
        self.safe_state = binding.safe_state
        self._reports = reports
        self._types = {quantity.name: quantity.type for quantity in manifest.device.telemetry}
        placed = binding.frame is not None
        self._in_frame = {q.name: q.frame for q in manifest.device.telemetry if q.frame and placed}
        self._calls: dict[str, _Call] = {}

    async def open(self, *, again: bool = False) -> str:
        """Find the device and set its watchdog; its identity in words. Raises DeviceError.

        What it keeps when it is off is only looked at: where that is not what its binding needs, NotSetUp.
        One that is opened `again`, after its guard died, may be in the air: then it is only told.
        """
        identity = await self.find()
        await self.check_watchdog()
        try:
            await self.check_settings()
        except DeviceError as error:
            if not again:
                raise
            self.note(error.reason)
        return identity

    async def find(self) -> str:
        """Only find it, as for those who want to look; its identity in words. Raises DeviceError."""
        return await self._open()

    def touched(self) -> bool:
        """Whether opening, as far as it has got, may have changed what it does: not while it was only asked.

        A guard that has to end meanwhile leaves it as it is, or finishes the opening and makes it safe.
        """
        return self._touched()

    async def execute(self, instruction: str, arguments: Sequence[object]) -> DeviceValue:
        """Carry an instruction out and return its result. Raises DeviceError when it did not happen."""
        call = self._calls.get(instruction) or self._call(instruction)
        values: list[object] = [c(value) for c, value in zip(call.arguments, arguments, strict=True)]
        if call.places:
            if (frame := self._frame()) is None:
                raise self.error(
                    f"{instruction} refused: it does not know yet where it is in the team's frame"
                )
            values = arguments_from_team(call.places, values, frame)
        return call.result(await call.method(*values))

    def _call(self, instruction: str) -> _Call:
        """What the manifest and the classes say of an instruction, worked out at its first call."""
        declared = self.manifest.device.instruction(instruction)
        if declared is None:
            raise self.error(f"there is no instruction '{instruction}'")
        checks = tuple(CHECKS[parameter.type] for parameter in declared.parameters)
        name = method_name(instruction)
        owner = next((part for part in self.parts if hasattr(part, name)), self)
        call = _Call(getattr(owner, name), checks, CHECKS[declared.result])
        if self.binding.frame is not None and any(each.frame for each in declared.parameters):
            call = call._replace(places=declared.parameters)
        self._calls[instruction] = call
        return call

    async def make_safe(self, state: str = "") -> None:
        """Bring it into a safe state ('': its binding's) and see that it is there. Raises DeviceError."""
        self.safe_state = state or self.binding.safe_state
        await self._make_safe(self.safe_state)

    def moving(self) -> str:
        """What it still does although it is in its safe state, in a few words; '' when it is at rest.

        `4.2 m up, sinking at 0.7 m/s`. Called a few times a second, from what is known: it asks nothing of
        the device and never waits. One that somebody else has taken over is not at rest while he moves it.
        """
        return self._moving()

    def taken_over(self) -> bool:
        """Whether somebody else moves it, such as a pilot, so that its safe state is left to them."""
        return self._taken_over()

    def guard_restarted(self, taken: bool) -> None:
        """It was opened again, after its guard died; its safe state comes next.

        What it does is what the program had it do, unless it is known to have been `taken` over before.
        """
        self._guard_restarted(taken)

    async def check_watchdog(self) -> None:
        """Set its watchdog: nothing may be commanded unless it stops by itself when this computer is gone.

        Its own time may be twice the guard's; where that cannot be, the binding must say so by name.
        A sensor does nothing that would have to be stopped. Raises DeviceError.
        """
        if self.binding.is_sensor:
            return
        longest = 2.0 * self.binding.ttl
        seconds = await self._set_watchdog(longest)
        if seconds is not None and seconds <= longest * (1.0 + 1e-9):
            return
        has = "has no watchdog of its own" if seconds is None else f"has a watchdog of {seconds:g} s"
        told = f"it {has}: nothing stops it {'' if seconds is None else 'sooner '}when this computer dies"
        if not self.binding.waives(WATCHDOG):
            least = (
                "" if seconds is None else f", and a ttl of {seconds / 2.0:g} s is the least that it keeps"
            )
            raise self.error(
                f"{told}; at most {longest:g} s (twice the ttl) is wanted{least}. "
                f"Accept it by 'waivers: [{WATCHDOG}]' in its binding"
            )
        own = "none" if seconds is None else f"{seconds:g} s"
        self.note(f"own watchdog: {own}, {longest:g} s required: accepted by waiver")

    async def settings(self) -> Sequence[Setting]:
        """The lasting settings that its binding needs, each as it is now. Raises DeviceError."""
        return await self._settings()

    async def check_settings(self) -> None:
        """Raise NotSetUp unless what it keeps is what its binding needs: each is told, nothing is written."""
        if not_right := wrong(await self._settings()):
            for setting in not_right:
                self.note(f"{setting}: {setting.why}")
            told = f"{not_right[0]}" + (f", and {len(not_right) - 1} more" if not_right[1:] else "")
            raise NotSetUp(self.binding.field, f"it is not set up for its binding: {told}")

    async def serial(self) -> str:
        """What tells it from every other of its kind, in words, such as `uid 3f21`; '' when it has nothing.

        It is its own for good: wherever it is found again, and whatever it was told. Raises DeviceError.
        """
        return await self._serial()

    async def write_setting(self, name: str, value: float) -> None:
        """Write one lasting setting, and see that it is written. Raises DeviceError, also while in use."""
        self.check_idle()
        await self._write_setting(name, value)

    def check_idle(self) -> None:
        """Raise DeviceError while nothing that it keeps may be changed, since it is in use."""
        if why := self._in_use():
            raise self.error(f"nothing was written: {why}")

    def publish(self, **values: object) -> None:
        """Tell the host the present values of telemetry quantities; what is about the team's frame, in it.

        As long as it is not known where its own frame lies, nothing is told of that.
        """
        if not self._in_frame.keys().isdisjoint(values):
            values = values_to_team(self._in_frame, values, self._frame())
        self._reports.publish(self.binding.name, {n: conform(v, self._types[n]) for n, v in values.items()})

    def heard(self) -> None:
        """The device has just shown that it is alive."""
        self._reports.heard(self.binding.name)

    def note(self, text: str) -> None:
        """One sentence for the log of the host."""
        self._reports.note(self.binding.name, text)

    def breach(self, reason: str) -> None:
        """It is beyond a limit and nothing that was tried has helped: have the guard hold it safe.

        Until then, and while it is latched already, nothing changes; the first reason is kept.
        """
        self._reports.breach(self.binding.name, reason)

    def lock_out(self, reason: str) -> None:
        """It has crashed, say: hold it safe until an operator ends that by `lfield estop --lift`."""
        self._reports.lock_out(self.binding.name, reason)

    def error(self, reason: str, *, timeout: bool = False) -> DeviceError:
        """The exception to raise when the device refused (or, with `timeout`, did not answer)."""
        kind = "DeviceTimeoutException" if timeout else "DeviceException"
        return DeviceError(self.binding.field, reason, kind=kind)

    async def do_release(self) -> None:
        """Called when the program releases the latch; most devices have nothing to do."""

    async def _open(self) -> str:
        raise NotImplementedError

    def _touched(self) -> bool:
        """See `touched`; of a driver that does not say it, nobody knows that it only asks."""
        return True

    async def _make_safe(self, state: str) -> None:
        raise NotImplementedError

    def _frame(self) -> Frame | None:
        """Where its own frame lies in the team's, None as long as that is not known; asked where it has one.

        A device that finds itself on the Earth, or whose frame moves, knows better than its binding.
        """
        return None if self.binding.frame is None else self.binding.frame.pose

    def _moving(self) -> str:
        """See `moving`; a device that is still as soon as its safe state is confirmed needs none."""
        return ""

    def _taken_over(self) -> bool:
        """See `taken_over`; most devices have one master."""
        return False

    def _guard_restarted(self, taken: bool) -> None:
        """See `guard_restarted`; for a device that tells by its commands whose doing its motion is."""

    async def _set_watchdog(self, longest: float) -> float | None:
        """Set the device's own watchdog to at most `longest` seconds, or to the least it can.

        Read it back: the seconds that it now has, None when there is none. Raises DeviceError.
        What the device would keep when it is off is not set here: it is one of its `_settings`, and the time
        is that with the settings as they must be.
        """
        return None

    async def _settings(self) -> Sequence[Setting]:
        """See `settings`; most devices keep nothing that a binding needs."""
        return ()

    async def _serial(self) -> str:
        """See `serial`; asked of a device that has `_settings`."""
        return ""

    async def _write_setting(self, name: str, value: float) -> None:
        """See `write_setting`; whoever has `_settings` needs it."""
        raise NotImplementedError

    def _in_use(self) -> str:
        """Why nothing that it keeps may be changed now, such as `its motors are on`; '' when it may."""
        return ""


class Driver:
    """One bus with its devices.

    Authors override `_open`, `_close`, `_device`, where devices share something `_set_up`, and for a bus that
    is polled or needs signs of life `_quiet` and `_resume`.
    """

    def __init__(
        self,
        bindings: Sequence[DeviceBinding],
        manifests: Mapping[str, Manifest],
        clock: Clock,
        reports: Reports,
    ) -> None:
        self.bindings, self.endpoint = tuple(bindings), bindings[0].endpoint
        self.manifests, self.clock, self.reports = manifests, clock, reports
        self._tasks: set[asyncio.Task[None]] = set()
        self._set_up()
        self.devices = {binding.name: self._device(binding) for binding in bindings}

    async def open(self) -> None:
        """Open the bus; the devices are opened after it, one by one. Raises DeviceError."""
        await self._open()

    async def close(self) -> None:
        """Give the bus back. Called once, also after a failed open."""
        for task in list(self._tasks):
            task.cancel()
        await self._close()

    def quiet(self) -> None:
        """The owner is gone: from now on nothing may be sent that feeds a device's own watchdog."""
        self._quiet()

    def resume(self) -> None:
        """The owner is back."""
        self._resume()

    def spawn(self, work: Coroutine[Any, Any, None]) -> None:
        """Run something in the background until `close`; if it fails, every device goes safe."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self.reports.crashed(error)

    def _set_up(self) -> None:
        """Make what the devices share, before they are made."""

    def _device(self, binding: DeviceBinding) -> Device:
        raise NotImplementedError

    async def _open(self) -> None:
        raise NotImplementedError

    async def _close(self) -> None:
        raise NotImplementedError

    def _quiet(self) -> None:
        """Stop polling and signs of life; listening and safe states go on."""

    def _resume(self) -> None:
        """Take them up again."""


def check_methods(device: type[Device], manifest: Manifest, parts: Iterable[object] = ()) -> None:
    """Raise PluginError unless a Device class and its parts have one coroutine for each instruction."""
    owners = (device, *map(type, parts))
    for instruction in manifest.device.instructions:
        if not instruction.is_query:
            _check_method(owners, instruction)


def _check_method(owners: Sequence[type], instruction: Instruction) -> None:
    name, wanted = method_name(instruction.name), len(instruction.parameters)
    found = [owner for owner in owners if hasattr(owner, name)]
    if len(found) > 1:
        both = " and ".join(owner.__name__ for owner in found)
        raise PluginError(f"{both} both define {name}: '{instruction.name}' must be carried out in one place")
    owner = found[0] if found else owners[0]
    method = getattr(owner, name, None)
    if method is None or not iscoroutinefunction(method):
        raise PluginError(f"{owner.__name__} needs 'async def {name}' for '{instruction.name}'")
    taken = [p for p in signature(method).parameters.values() if p.kind is not MethodParameter.KEYWORD_ONLY]
    if len(taken) != wanted + 1:
        raise PluginError(f"{owner.__name__}.{name} must take the {wanted} parameters of its manifest")
