"""Decisions of the guard: whether a device may move, and when it must stop. Events in, effects out.

A device is free or latched. A device is latched, and its safe state is commanded until it is confirmed, when

  - the host has sent no heartbeat for `silence` seconds (only if the host has moved the device since it was
    opened or released), or has ended, or requests it;
  - a setpoint has expired without a replacement: its time-to-live starts when the device accepts it, and a
    running call that would replace it has the same time;
  - its driver raised an exception other than a DeviceError, reports a breach, or the guard was restarted;
  - a call was cancelled, and the instruction that ends it has failed.

A latched device may be commanded to a safe state other than that of its binding. Only `release()` frees it,
once its safe state is confirmed. On each channel one actuation runs at a time: a newer one replaces an older
one, so `land()` need not wait for a `goTo()` of another thread. A query to the device runs concurrently, also
while it is latched.

A device that still moves in its safe state is commanded again, in case it was moved out of this state. A stop
makes all devices safe and is over when they are at rest (standstill.py).

While the host is silent the bus is muted, once every device is at rest, or a device has not confirmed its
safe state within MUTE_AFTER: the messages of the driver would feed the device's own watchdog for a host that
does not respond. A device on its way to rest is not affected, since another failsafe would interfere.

Every event first handles overdue deadlines, so that a heartbeat that waited in the pipe while this process
was stopped does not end the silence. `due` does not read the clock: it returns the next deadline even if it
has passed, so no deadline is lost between two checks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfield.clock import Clock
from lfield.driver.contract import RELEASE
from lfield.guard.effects import Abandon, CheckRest, Effect, Execute, Exit, Interrupt, MakeSafe, Mute, Notify
from lfield.guard.guard_device import CoreState, GuardDevice
from lfield.guard.messages import GuardCall, Latched, Moving, Note, Refused, Released, Stopped, host_silent
from lfield.guard.running_call import RunningCall, call_kind
from lfield.guard.standstill import Standstill
from lfield.manifest import LEAVE, DeviceManifest, DeviceValue
from lfield.text import log_messages
from lfield.text.log_messages import report_fields

#: Default host time-out in seconds (a heartbeat comes every 50 ms).
HOST_TIMEOUT = 0.2
#: Seconds after a failed attempt until the safe state is commanded again.
RETRY = 1.0
#: Seconds after an attempt until the safe state is commanded again for a device that still moves.
REPEAT = 2.0
#: The requirement after an emergency stop or a lock-out.
LIFT_FIRST = "'lfield estop --lift' must come first"
#: Seconds for the devices of a silent host to confirm their safe states before their bus is muted.
MUTE_AFTER = 2.0


class GuardCore:
    """The state machine of one guard; `devices` are (name, manifest, ttl, rest_within)."""

    def __init__(
        self,
        devices: Sequence[tuple[str, DeviceManifest, float, float]],
        clock: Clock,
        *,
        silence: float = HOST_TIMEOUT,
    ) -> None:
        self._devices = {device[0]: GuardDevice(*device) for device in devices}
        self._standstill = Standstill(
            {name: within for name, manifest, _, within in devices if manifest.safe_states}
        )
        self._clock = clock
        self._silence = silence
        self._last_beat = clock.monotonic()
        self._stopping = self._ended = self._muted = False

    @property
    def state(self) -> CoreState:
        """The present state, which the next event changes."""
        devices, standstill = list(self._devices.values()), self._standstill.state
        return CoreState(devices, standstill, self._last_beat, self._stopping, self._ended, self._muted)

    def restore(self, state: CoreState) -> None:
        """Continues from the state of another core with the same devices."""
        self._devices = {device.name: device for device in state.devices}
        self._standstill.restore(state.rest)
        self._last_beat = state.last_beat
        self._stopping, self._ended, self._muted = state.stopping, state.ended, state.muted

    # -- events ---------------------------------------------------------------------------------------

    def on_opened(self, latched: str) -> list[Effect]:
        """The devices are open; with a reason in `latched` they start latched."""
        self._last_beat = self._clock.monotonic()
        return self._latch_all(latched) if latched else []

    def on_beat(self, sent: float) -> list[Effect]:
        """A heartbeat of the host, sent at `sent`."""
        effects = self.tick()
        now = self._clock.monotonic()
        self._last_beat = max(self._last_beat, min(sent, now))
        if self._muted and now < self._silent_at:
            effects.append(self._set_muted(False))
        return effects

    def on_call(self, call: GuardCall) -> list[Effect]:
        """A call of the program, which also counts as a heartbeat."""
        effects = self.on_beat(call.sent)
        device = self._devices.get(call.device)
        instruction = device.manifest.instruction(call.instruction) if device else None
        if device is None or instruction is None:
            return [*effects, Notify(call.refusal(f"there is no {call.device}.{call.instruction}()"))]
        if len(call.arguments) != len(instruction.parameters):
            count = len(instruction.parameters)
            return [*effects, Notify(call.refusal(f"{call.instruction}() takes {count} arguments"))]
        kind = call_kind(instruction)
        if device.latched and kind != "ask":
            first = LIFT_FIRST if device.lock_reason else "call release() first"
            held = f"held in its safe state: {device.lock_reason or device.latched}; {first}"
            return [*effects, Notify(call.refusal(held))]
        if late := self._expiry_reason(call):
            return [*effects, Notify(call.refusal(late))]
        if kind == "ask":
            return effects + self._start_query(device, call)
        stopped = self._abandon(device, instruction.channel, f"replaced by {call.instruction}()")
        device.start(instruction.channel, RunningCall(call, kind, replaces_call=bool(stopped)))
        return [*effects, *stopped, Execute(call)]

    def mark_started(self, call: GuardCall) -> str:
        """The reason why the driver must not start an accepted call any more; '' when the call starts now."""
        if (running := self._devices[call.device].running(call.token)) is not None:
            running.mark_started()
        return self._expiry_reason(call)

    def on_cancel(self, token: int, sent: float) -> list[Effect]:
        """The host cancels a call, which ends as its manifest defines; an answered call is not affected.

        A call that has not started and has replaced none never starts. The instruction that ends a call is
        the newest on its channel; if it fails, or takes longer than `rest_within`, the device is made safe.
        """
        effects = self.on_beat(sent)
        running = self._running(token)
        if running is None:
            return effects
        device = self._devices[running.call.device]
        instruction = device.instruction_of(running.call)
        if not instruction.may_be_cancelled:
            return effects
        device.remove(running)
        effects.append(Interrupt(token))
        if running.has_changed_nothing or instruction.cancel in ("", LEAVE):
            return [*effects, Notify(running.cancelled_answer())]
        now = self._clock.monotonic()
        end = GuardCall(-token, device.name, instruction.cancel, [], now, math.inf)
        kind, deadline = call_kind(device.instruction_of(end)), now + device.rest_within
        device.active[instruction.channel] = RunningCall(end, kind, running.call, deadline=deadline)
        return [*effects, Execute(end)]

    def on_finished(self, token: int, value: DeviceValue) -> list[Effect]:
        """The driver has executed a call."""
        effects = self.tick()
        running = self._finish_running(token)
        if running is None:
            return effects
        call = running.call
        device = self._devices[call.device]
        instruction = device.instruction_of(call)
        if running.kind == "setpoint":
            device.setpoints[instruction.channel] = self._clock.monotonic() + device.ttl
        elif running.kind == "act":
            device.setpoints.pop(instruction.channel, None)
        return [*effects, Notify(running.done_answer(value))]

    def on_refused(self, token: int, kind: str, reason: str) -> list[Effect]:
        """The device refused a call: an exception for the program, no reason to make it safe."""
        effects = self.tick()
        running = self._finish_running(token)
        if running is None:
            return effects
        if running.cancelled is None:
            return [*effects, Notify(Refused(token, kind, reason))]
        answer = running.failed_answer(f"{running.call.instruction}() failed: {reason}")
        return [*effects, Notify(answer), *self._latch(self._devices[running.call.device], answer.reason)]

    def on_crashed(self, token: int, reason: str) -> list[Effect]:
        """The driver raised an unexpected exception while it executed a call."""
        effects = self.tick()
        running = self._finish_running(token)
        if running is None:
            return effects
        effects.append(Notify(running.failed_answer(reason)))
        return effects + self._latch(self._devices[running.call.device], reason)

    def latch(self, device: str, reason: str, *, lock: bool = False, state: str = "") -> list[Effect]:
        """A request for the safe state of a device, or of all (''), or for an unusual `state`."""
        effects = self.tick()
        for name, known in self._devices.items():
            if device in ("", name):
                known.lock(reason if lock else "")
                effects += self._latch(known, reason, state)
        return effects

    def clear_stop(self) -> list[Effect]:
        """The emergency is over: latched devices may be released."""
        for device in self._devices.values():
            device.unlock()
        return self.tick()

    def on_safe(self, name: str) -> list[Effect]:
        """The driver has confirmed the safe state."""
        effects = self.tick()
        device, now = self._devices[name], self._clock.monotonic()
        device.end_safe_state(now)
        if device.confirmed:
            return effects
        device.confirm()
        self._standstill.on_confirmed(name, now)
        return [*effects, Notify(Latched(name, device.latched, True, device.state)), *self.tick()]

    def on_motion_report(self, name: str, moving: str) -> list[Effect]:
        """The driver reports how the device still moves in its safe state, '' when it is at rest."""
        device, now = self._devices[name], self._clock.monotonic()
        is_reported = self._standstill.on_motion_report(name, moving, now)
        effects: list[Effect] = [Notify(Moving(name, moving))] if is_reported else []
        waits = device.making or self._muted or now < device.made_at + REPEAT
        if moving and device.confirmed and not waits:
            effects.append(_make_safe(device))
        return effects + self.tick()

    def on_safe_failed(self, name: str, reason: str) -> list[Effect]:
        """The driver could not bring the device into its safe state; the command is repeated."""
        effects = self.tick()
        device, now = self._devices[name], self._clock.monotonic()
        device.end_safe_state(now)
        if device.confirmed:
            return effects  # A motion report follows, after which the state is commanded again.
        device.set_retry(now + RETRY)
        line = log_messages.SAFE_STATE_UNCONFIRMED.line(reason=reason)
        return [*effects, Notify(Note(name, *report_fields(line)))]

    def on_stop(self, reason: str, *, at_once: bool = False) -> list[Effect]:
        """The host stops: make all devices safe, wait until they are at rest (not `at_once`), then exit."""
        if at_once:
            self._standstill.skip_wait()
        return self._stop(reason)

    def on_host_gone(self, reason: str) -> list[Effect]:
        """The host has ended: make all devices safe, then exit."""
        self._standstill.on_host_gone()
        return self._stop(reason)

    def _stop(self, reason: str) -> list[Effect]:
        effects = self.tick()
        if not self._stopping:
            self._stopping = True
            self._standstill.on_stop(self._clock.monotonic())
            effects += self._latch_all(reason)
        return effects + self.tick()

    def tick(self) -> list[Effect]:
        """Handles all deadlines that are due."""
        now = self._clock.monotonic()
        effects: list[Effect] = []
        silent = now >= self._silent_at
        for device in self._devices.values():
            if silent and device.is_actuated:
                effects += self._latch(device, host_silent(self._silence))
            until = device.expiry()
            if until is not None and now >= until:
                effects += self._latch(device, f"the setpoint has expired (time-to-live {device.ttl:g} s)")
            if slow := device.overdue_cancel(now):
                effects += self._latch(device, slow)
            if device.retry_at is not None and now >= device.retry_at:
                device.set_retry(None)
                effects.append(_make_safe(device))
        if silent and not self._muted and now >= self._mute_at():
            effects.append(self._set_muted(True))
        if self._ended:
            return effects
        effects += [CheckRest(name) for name in self._standstill.due_checks(now)]
        return effects + self._end_if_over(now)

    def due(self) -> float | None:
        """The time when the next tick is needed, on the injected clock; None without a deadline."""
        if self._ended:
            return None
        times = [device.due() for device in self._devices.values()]
        times += [self._standstill.due(), self._silence_due()]
        return min((time for time in times if time is not None), default=None)

    # -- decisions ------------------------------------------------------------------------------------

    def _expiry_reason(self, call: GuardCall) -> str:
        """The reason why a call is too late to start; '' when it is not."""
        now = self._clock.monotonic()
        if now < call.until or self._devices[call.device].instruction_of(call).only_asks:
            return ""
        within = f"{call.instruction}() had to start within {max(0.0, call.until - call.sent):.3g} s"
        return f"{within}, but reached its guard after {now - call.sent:.3g} s: nothing was done"

    @property
    def _silent_at(self) -> float:
        """The time when the host counts as silent without another heartbeat."""
        return self._last_beat + self._silence

    def _silence_due(self) -> float | None:
        """The time when the next action for a silent host is due; None when all actions are done."""
        if any(device.is_actuated and not device.latched for device in self._devices.values()):
            return self._silent_at
        return None if self._muted else self._mute_at()

    def _mute_at(self) -> float:
        """The time when a silent host's bus is muted: at once if no message remains to be sent."""
        if all(d.confirmed or not (d.latched or d.is_actuated) for d in self._devices.values()):
            return max(self._silent_at, self._standstill.under_way_until())
        return self._silent_at + MUTE_AFTER

    def _set_muted(self, muted: bool) -> Mute:
        self._muted = muted
        self._standstill.on_muted(muted)
        return Mute(muted)

    def _start_query(self, device: GuardDevice, call: GuardCall) -> list[Effect]:
        """Accepts a call that moves no device; release() unlatches first and informs the driver."""
        effects: list[Effect] = []
        if call.instruction == RELEASE.name:
            if self._stopping:
                return [Notify(call.refusal("the host is stopping"))]
            if device.lock_reason:
                return [Notify(call.refusal(f"{device.lock_reason}; {LIFT_FIRST}"))]
            if device.latched and not device.confirmed:
                wait = "its safe state is not confirmed yet; call release() again in a moment"
                return [Notify(call.refusal(wait))]
            if device.latched:
                effects += [*([Abandon(device.name)] if device.making else []), Notify(Released(device.name))]
                device.release()
                self._standstill.on_latched_or_free(device.name)
        device.queries[call.token] = RunningCall(call, "ask")
        return [*effects, Execute(call)]

    def _latch_all(self, reason: str) -> list[Effect]:
        return [effect for device in self._devices.values() for effect in self._latch(device, reason)]

    def _latch(self, device: GuardDevice, reason: str, state: str = "") -> list[Effect]:
        """Latches a device that has a safe state; keeps the first reason for a state."""
        if device.latched and state in ("", device.state):
            return []
        if not device.manifest.safe_states:
            reported = device.replace_reported(reason)
            line = log_messages.SENSOR_NOT_LATCHED.line(reason=reason)
            note = Note(device.name, *report_fields(line))
            return [Notify(note)] if reason != reported and not self._stopping else []
        device.latch(reason, state)
        self._standstill.on_latched_or_free(device.name)
        device.setpoints.clear()
        # The safe state is the first effect because it cannot wait.
        stopped = [
            effect
            for channel in list(device.active)
            for effect in self._abandon(device, channel, f"stopped, since {reason}")
        ]
        return [
            *(effect for effect in stopped if isinstance(effect, Interrupt)),
            *([Abandon(device.name)] if device.making else []),
            _make_safe(device),
            *(effect for effect in stopped if isinstance(effect, Notify)),
            Notify(Latched(device.name, reason, False, state)),
        ]

    def _abandon(self, device: GuardDevice, channel: str, reason: str) -> list[Effect]:
        running = device.active.pop(channel, None)
        if running is None:
            return []
        answer = running.failed_answer(f"{running.call.instruction}() was {reason}")
        return [Interrupt(running.call.token), Notify(answer)]

    def _running(self, token: int) -> RunningCall | None:
        """The running call of a token; None when the call was answered."""
        found = (device.running(token) for device in self._devices.values())
        return next((running for running in found if running is not None), None)

    def _finish_running(self, token: int) -> RunningCall | None:
        """As `_running`, and removes the call."""
        running = self._running(token)
        if running is not None:
            self._devices[running.call.device].remove(running)
        return running

    def _end_if_over(self, now: float) -> list[Effect]:
        if not self._standstill.is_over(now):
            return []
        self._ended = True
        unsafe = self._standstill.unsafe()
        return [Notify(Stopped(unsafe)), Exit(1 if unsafe else 0)]


def _make_safe(device: GuardDevice) -> MakeSafe:
    device.start_safe_state()
    return MakeSafe(device.name, device.state)
