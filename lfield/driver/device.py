"""Base classes for drivers: a `Driver` for the bus, a `Device` for each device on it.

Callers use the public methods. Authors override the methods with a leading underscore and write one coroutine
per instruction of the manifest (`goTo` -> `do_go_to`).

All code runs on the event loop of the guard process and must not block: the guard's timers also run there.
Call a blocking vendor library through `asyncio.to_thread`.
"""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping, Sequence
from inspect import Parameter as MethodParameter
from inspect import iscoroutinefunction, signature
from typing import Any, NamedTuple

from lfield.clock import Clock
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import WATCHDOG, Manifest, Reports
from lfield.driver.frame import Frame, arguments_from_team, values_to_team
from lfield.driver.recording import WireLog
from lfield.driver.settings import Setting, mismatched
from lfield.driver.value_types import VALUE_CHECKS, ValueCheck, conform, exceeds
from lfield.errors import DeviceError, DeviceNotSetUp, PluginError
from lfield.manifest import DeviceValue, Instruction, Parameter
from lfield.text import log_messages

#: Error kind of a device that needs `lfield setup`; other kinds are names of L exceptions.
NOT_SET_UP = "NotSetUp"


class _Call(NamedTuple):
    """The coroutine of an instruction, and the types of its arguments and result.

    `places` are its parameters if some of them refer to the team's frame.
    """

    method: Callable[..., Awaitable[object]]
    arguments: tuple[ValueCheck, ...]
    result: ValueCheck
    places: Sequence[Parameter] = ()


def method_name(instruction: str) -> str:
    """`goTo` -> `do_go_to`."""
    return "do_" + re.sub(r"([A-Z])", r"_\1", instruction).lower()


class Device:
    """One device on a bus.

    Authors override `_open` and, except for a pure sensor, `_make_safe`. Optional: `_set_watchdog` (the
    device has a watchdog), `_touched` (opening starts with queries only), `_moving` (coming to rest takes
    time), `_taken_over` and `_guard_restarted` (others may control the device), `_safe_action` (the log names
    an action other than the safe state), `_frame` (its own frame differs from its binding), `_settings`,
    `_write_setting`, `_in_use` and `_serial` (it stores settings that a binding needs).

    A device with many instructions may have `parts`: objects created in its constructor, whose `do_...`
    methods are used as well. A part receives the objects that it needs (often the device), keeps its own
    state and can be tested alone.
    """

    #: Objects that implement further instructions; each instruction is implemented once.
    parts: Sequence[object] = ()
    #: The largest magnitude of a real in an instruction; the wire cannot transmit a larger one, which is
    #: refused.
    largest = math.inf

    def __init__(self, binding: DeviceBinding, manifest: Manifest, clock: Clock, reports: Reports) -> None:
        self.binding, self.manifest, self.clock = binding, manifest, clock
        #: The last safe state commanded; initially the one of the binding.
        self.safe_state = binding.safe_state
        self._reports = reports
        self._types = {quantity.name: quantity.type for quantity in manifest.device.telemetry}
        placed = binding.frame is not None
        self._in_frame = {q.name: q.frame for q in manifest.device.telemetry if q.frame and placed}
        self._calls: dict[str, _Call] = {}

    async def open(self, *, again: bool = False) -> str:
        """Finds the device and sets its watchdog; returns its identity. Raises DeviceError.

        Stored settings are only read; DeviceNotSetUp if they do not match the binding. `again` means that the
        previous guard died: the device may be in the air, so wrong settings are only logged.
        """
        identity = await self.find()
        await self.check_watchdog()
        try:
            await self.check_settings()
        except DeviceError as error:
            if not again:
                raise
            self.note(log_messages.DEVICE_REOPENED_WRONG.line(reason=error.reason))
        return identity

    async def find(self) -> str:
        """Finds the device without changing it; returns its identity. Raises DeviceError."""
        return await self._open()

    def touched(self) -> bool:
        """Whether opening may have changed the device so far; False while the device was only queried. If the
        guard must end during the opening, it does not change an untouched device; otherwise it completes the
        opening and makes the device safe.
        """
        return self._touched()

    async def execute(self, instruction: str, arguments: Sequence[object]) -> DeviceValue:
        """Executes an instruction and returns its result. Raises DeviceError if this fails."""
        call = self._calls.get(instruction) or self._call(instruction)
        values: list[object] = [c(value) for c, value in zip(call.arguments, arguments, strict=True)]
        if exceeds(values, self.largest):
            raise self.error(f"{instruction} refused: a number is beyond {self.largest:g}")
        if call.places:
            if (frame := self._frame()) is None:
                raise self.error(f"{instruction} refused: the position in the team's frame is not known yet")
            values = arguments_from_team(call.places, values, frame)
        return call.result(await call.method(*values))

    def _call(self, instruction: str) -> _Call:
        """The implementation of an instruction, resolved at its first call."""
        declared = self.manifest.device.instruction(instruction)
        if declared is None:
            raise self.error(f"there is no instruction '{instruction}'")
        checks = tuple(VALUE_CHECKS[parameter.type] for parameter in declared.parameters)
        name = method_name(instruction)
        owner = next((part for part in self.parts if hasattr(part, name)), self)
        call = _Call(getattr(owner, name), checks, VALUE_CHECKS[declared.result])
        if self.binding.frame is not None and any(each.frame for each in declared.parameters):
            call = call._replace(places=declared.parameters)
        self._calls[instruction] = call
        return call

    def safe_actions(self) -> dict[str, str]:
        """The actions of the device in its safe states, by state, if they differ from its name."""
        actions = {state: self._safe_action(state) for state in self.manifest.device.safe_states}
        return {state: action for state, action in actions.items() if action != state}

    def _safe_action(self, state: str) -> str:
        """The action of the device in a safe state, for the log: a rover that cannot land holds."""
        return state

    async def make_safe(self, state: str = "") -> None:
        """Brings the device into a safe state ('': that of its binding) and confirms it. Raises
        DeviceError.
        """
        self.safe_state = state or self.binding.safe_state
        await self._make_safe(self.safe_state)

    def moving(self) -> str:
        """The remaining motion in the safe state, such as `4.2 m up, sinking at 0.7 m/s`; '' at rest.

        Called a few times per second: uses known data, sends no message and never waits. A device under
        foreign control is not at rest while it moves.
        """
        return self._moving()

    def taken_over(self) -> bool:
        """Whether the device is under foreign control, such as a pilot's, who is then responsible for it."""
        return self._taken_over()

    def guard_restarted(self, was_taken_over: bool) -> None:
        """Called when the device was opened again after its guard died; the safe state follows. The present
        motion counts as commanded by the program unless the device `was_taken_over` before.
        """
        self._guard_restarted(was_taken_over)

    async def check_watchdog(self) -> None:
        """Sets the watchdog of the device, which stops it when this computer fails.

        The time-out may be twice that of the guard. If this is impossible, the binding needs the waiver.
        Sensors need no watchdog. Raises DeviceError.
        """
        if self.binding.is_sensor:
            return
        longest = 2.0 * self.binding.ttl
        seconds = await self._set_watchdog(longest)
        if seconds is not None and seconds <= longest * (1.0 + 1e-9):
            return
        if not self.binding.waives(WATCHDOG):
            limit = f"limit {longest:g} s (twice the ttl)"
            if seconds is None:
                text = f"no watchdog in the device, {limit}: it moves on when this computer fails; "
            else:
                text = f"watchdog too slow: {seconds:g} s, {limit}; set 'ttl: {seconds / 2.0:g}', or "
            raise self.error(f"{text}accept it with 'waivers: [{WATCHDOG}]' in its binding")
        own = "none" if seconds is None else f"{seconds:g} s"
        self.note(log_messages.WATCHDOG_WAIVED.line(own=own, longest=longest))

    async def settings(self) -> Sequence[Setting]:
        """The stored settings that the binding needs, with their present values. Raises DeviceError."""
        return await self._settings()

    async def check_settings(self) -> None:
        """Raises DeviceNotSetUp if stored settings do not match the binding, without a write."""
        if not_right := mismatched(await self._settings()):
            for setting in not_right:
                self.note(log_messages.SETTING_MISMATCH.line(setting=setting, reason=setting.why))
            text = f"{not_right[0]}" + (f", and {len(not_right) - 1} more" if not_right[1:] else "")
            raise DeviceNotSetUp(self.binding.field, f"it is not set up for its binding: {text}")

    async def serial(self) -> str:
        """The permanent unique identifier, such as `uid 3f21`; '' for none. Raises DeviceError."""
        return await self._serial()

    async def write_setting(self, name: str, value: float) -> None:
        """Writes one stored setting and reads it back. Raises DeviceError, also during use of the device."""
        self.check_idle()
        await self._write_setting(name, value)

    def check_idle(self) -> None:
        """Raises DeviceError while the device is in use and its settings must not be changed."""
        if reason := self._in_use():
            raise self.error(f"nothing was written: {reason}")

    def publish(self, **values: object) -> None:
        """Publishes current telemetry values, converted to the team's frame.

        Values that refer to the team's frame are omitted while the pose of the device's own frame is unknown.
        """
        if not self._in_frame.keys().isdisjoint(values):
            values = values_to_team(self._in_frame, values, self._frame())
        self._reports.publish(self.binding.name, {n: conform(v, self._types[n]) for n, v in values.items()})

    def heard(self) -> None:
        """Records that the device has sent a message."""
        self._reports.heard(self.binding.name)

    def note(self, text: str) -> None:
        """Writes a line into the log of the host.

        `text` is a sentence, or a line of a `LogMessage` with its own code and level.
        """
        self._reports.note(self.binding.name, text)

    def breach(self, reason: str) -> None:
        """Reports that the device exceeds a limit and cannot be corrected: the guard holds it safe. Without
        effect while it is latched; the first reason is kept.
        """
        self._reports.breach(self.binding.name, reason)

    def lock_out(self, reason: str) -> None:
        """Holds the device safe, such as after a crash, until an operator calls `lfield estop --lift`."""
        self._reports.lock_out(self.binding.name, reason)

    def error(self, reason: str, *, timeout: bool = False) -> DeviceError:
        """The exception to raise when the device refused or, with `timeout`, did not answer."""
        kind = "DeviceTimeoutException" if timeout else "DeviceException"
        return DeviceError(self.binding.field, reason, kind=kind)

    async def do_release(self) -> None:
        """Called when the program releases the latch; most devices need no action."""

    async def _open(self) -> str:
        raise NotImplementedError

    def _touched(self) -> bool:
        """See `touched`; by default True, since opening may change the device."""
        return True

    async def _make_safe(self, state: str) -> None:
        raise NotImplementedError

    def _frame(self) -> Frame | None:
        """The pose of the device's own frame in the team's frame, None while unknown.

        Override this method for a device that locates itself on the Earth, or whose frame moves.
        """
        return None if self.binding.frame is None else self.binding.frame.pose

    def _moving(self) -> str:
        """See `moving`; not needed for a device that is still once its safe state is confirmed."""
        return ""

    def _taken_over(self) -> bool:
        """See `taken_over`; most devices have one controller."""
        return False

    def _guard_restarted(self, was_taken_over: bool) -> None:
        """See `guard_restarted`; for a device that attributes its motion to the last command."""

    async def _set_watchdog(self, longest: float) -> float | None:
        """Sets the device's own watchdog to at most `longest` seconds, or to its smallest value.

        Returns the value read back in seconds, None without a watchdog. Raises DeviceError. A watchdog in
        persistent memory is not written here: it is one of `_settings`, and its required value is returned.
        """
        return None

    async def _settings(self) -> Sequence[Setting]:
        """See `settings`; most devices store no setting that a binding needs."""
        return ()

    async def _serial(self) -> str:
        """See `serial`; called for a device that has `_settings`."""
        return ""

    async def _write_setting(self, name: str, value: float) -> None:
        """See `write_setting`; required with `_settings`."""
        raise NotImplementedError

    def _in_use(self) -> str:
        """The reason why the settings must not change now, such as `its motors are on`; '' if they may."""
        return ""


class Driver:
    """One bus with its devices.

    Authors override `_open`, `_close` and `_device`; `_set_up` if devices share something; `_quiet` and
    `_resume` for a bus that is polled or needs heartbeats.
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
        #: The log of sent and received data.
        self.wire_log = WireLog(clock)
        self._tasks: set[asyncio.Task[None]] = set()
        self._set_up()
        self.devices = {binding.name: self._device(binding) for binding in bindings}

    async def open(self) -> None:
        """Opens the bus; the devices are opened afterwards, one by one. Raises DeviceError."""
        await self._open()

    async def close(self) -> None:
        """Closes the bus. Called once, also after a failed `open`."""
        for task in list(self._tasks):
            task.cancel()
        await self._close()

    def quiet(self) -> None:
        """Stops all messages that feed a device's own watchdog, because the host does not respond."""
        self._quiet()

    def resume(self) -> None:
        """Reverses `quiet`: the host responds again."""
        self._resume()

    def spawn(self, work: Coroutine[Any, Any, None]) -> None:
        """Runs a coroutine in the background until `close`; if it fails, every device is made safe."""
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self.reports.crashed(error)

    def _set_up(self) -> None:
        """Creates objects that the devices share, before the devices are created."""

    def _device(self, binding: DeviceBinding) -> Device:
        raise NotImplementedError

    async def _open(self) -> None:
        raise NotImplementedError

    async def _close(self) -> None:
        raise NotImplementedError

    def _quiet(self) -> None:
        """Stops polling and heartbeats; receiving and safe states continue."""

    def _resume(self) -> None:
        """Starts polling and heartbeats again."""


def check_methods(device: type[Device], manifest: Manifest, parts: Iterable[object] = ()) -> None:
    """Raises PluginError unless a Device class and its parts have one coroutine for each instruction."""
    owners = (device, *map(type, parts))
    for instruction in manifest.device.instructions:
        if not instruction.is_query:
            _check_method(owners, instruction)


def _check_method(owners: Sequence[type], instruction: Instruction) -> None:
    name, count = method_name(instruction.name), len(instruction.parameters)
    found = [owner for owner in owners if hasattr(owner, name)]
    if len(found) > 1:
        both = " and ".join(owner.__name__ for owner in found)
        raise PluginError(f"{both} both define {name}: '{instruction.name}' must be implemented once")
    owner = found[0] if found else owners[0]
    method = getattr(owner, name, None)
    if method is None or not iscoroutinefunction(method):
        raise PluginError(f"{owner.__name__} needs 'async def {name}' for '{instruction.name}'")
    parameters = [
        p for p in signature(method).parameters.values() if p.kind is not MethodParameter.KEYWORD_ONLY
    ]
    if len(parameters) != count + 1:
        raise PluginError(f"{owner.__name__}.{name} must take the {count} parameters of its manifest")
