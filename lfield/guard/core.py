"""The guard's decisions: when a device may move and when it must be safe. Events in, effects out.

A device is free or latched. It is latched, and its safe state commanded until it is confirmed, when

  - the host has been silent for longer than `silence` (this only if the host has moved the device since it
    was opened or released: what nobody commanded is left as it is), or is gone, or asks for it;
  - the time-to-live of a setpoint is over and nothing has replaced it: it counts from when the device took
    it, and a call under way that would replace it has as long;
  - its driver raised anything but a DeviceError or reports a breach, or the guard was restarted;
  - a call was cancelled, and the instruction that ends it has failed.

Somebody may ask for another of its safe states than its binding's: that counts also when it is held already.
Only `release()` frees it, and only once its safe state is confirmed. On each channel of a device one
actuation runs at a time: a newer one replaces an older one, so that `land()` need not wait for a `goTo()` of
another thread. A query that asks the device runs beside the others, also while the device is latched.

A device that goes on moving in its safe state is commanded again: it may have been led out of it.

A stop makes all devices safe and is over when they are at rest (rest.py).

While the host is silent the bus is made quiet, once every device is at rest, or one has not confirmed its
safe state within QUIET_BY: what the driver sends by itself would keep the device's own watchdog content for
an owner who is gone. A device on its way to rest is not left to it: another failsafe would take over.

Every event first looks at the clock: what is overdue happens before what has just arrived, so that a beat
that lay in the pipe while this process was stopped does not excuse the silence. And `due` looks at no clock
at all: it says when the next thing is to be done, also when that is past. Time goes on between a look at what
is due and the next question, and what falls in between must not be taken for done.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfield.clock import Clock
from lfield.driver.contract import RELEASE
from lfield.guard.device import KnownDevice
from lfield.guard.effects import Effect, Execute, Exit, Interrupt, LeaveOff, Look, MakeSafe, Quiet, Tell
from lfield.guard.messages import Call, Latched, Moving, Note, Refused, Released, Stopped, host_silent
from lfield.guard.rest import Rest
from lfield.guard.running import Running, way
from lfield.manifest import LEAVE, DeviceManifest, DeviceValue

#: How long the host may be silent, in seconds (a beat comes every 50 ms).
SILENCE = 0.2
#: How long after a failed attempt the safe state is commanded again.
RETRY = 1.0
#: How long after an attempt it is commanded again for a device that still moves.
AGAIN = 2.0
#: What an emergency stop and a lock-out end with.
LIFT = "'lfield estop --lift' must come first"
#: How long a silent host's devices have to confirm their safe states before their bus is made quiet.
QUIET_BY = 2.0


class GuardCore:
    """The state machine of one guard; `devices` are (name, manifest, ttl, rest_within)."""

    def __init__(
        self,
        devices: Sequence[tuple[str, DeviceManifest, float, float]],
        clock: Clock,
        *,
        silence: float = SILENCE,
    ) -> None:
        self._devices = {device[0]: KnownDevice(*device) for device in devices}
        self._rest = Rest({name: within for name, made, _, within in devices if made.safe_states})
        self._clock = clock
        self._silence = silence
        self._last_beat = clock.monotonic()
        self._stopping = self._ended = self._quiet = False

    # -- events ---------------------------------------------------------------------------------------

    def opened(self, latched: str) -> list[Effect]:
        """The devices are there; a reason in `latched` says that they come back from something."""
        self._last_beat = self._clock.monotonic()
        return self._latch_all(latched) if latched else []

    def beat(self, sent: float) -> list[Effect]:
        """The host was alive at `sent`."""
        effects = self.tick()
        now = self._clock.monotonic()
        self._last_beat = max(self._last_beat, min(sent, now))
        if self._quiet and now < self._silent_at:
            effects.append(self._set_quiet(False))
        return effects

    def call(self, call: Call) -> list[Effect]:
        """The program calls an instruction; that is a sign of life too."""
        effects = self.beat(call.sent)
        device = self._devices.get(call.device)
        instruction = device.manifest.instruction(call.instruction) if device else None
        if device is None or instruction is None:
            return [*effects, _refuse(call, f"there is no {call.device}.{call.instruction}()")]
        if len(call.arguments) != len(instruction.parameters):
            takes = f"{call.instruction}() takes {len(instruction.parameters)} arguments"
            return [*effects, _refuse(call, takes)]
        asks = way(instruction) == "ask"
        if device.latched and not asks:
            first = LIFT if device.barred else "call release() first"
            held = f"held in its safe state because {device.barred or device.latched}; {first}"
            return [*effects, _refuse(call, held)]
        if refusal := self._too_late(call):
            return [*effects, _refuse(call, refusal)]
        if asks:
            return effects + self._ask(device, call)
        stopped = self._abandon(device, instruction.channel, f"replaced by {call.instruction}()")
        device.acting[instruction.channel] = Running(call, follows=bool(stopped))
        device.moved = True
        return [*effects, *stopped, Execute(call)]

    def begins(self, call: Call) -> str:
        """Why the driver must not get a call that was let in, '' when it gets it now: time has passed."""
        if (running := self._running(call.token)) is not None:
            running.begun = True
        return self._too_late(call)

    def cancel(self, token: int, sent: float) -> list[Effect]:
        """The host gives up a call, which ends as its manifest says; what has been answered stays so.

        What has not begun and has replaced nothing never begins. The instruction that ends a call is the
        newest on its channel; when it fails, or takes longer than the device may to come to rest, the device
        goes safe, for nobody watches any more where it goes.
        """
        effects = self.beat(sent)
        running = self._running(token)
        if running is None:
            return effects
        device = self._devices[running.call.device]
        instruction = device.declared(running.call)
        if not instruction.may_be_cancelled:
            return effects
        device.forget(running)
        effects.append(Interrupt(token))
        if running.untouched or instruction.cancel in ("", LEAVE):
            return [*effects, Tell(running.given_up())]
        now = self._clock.monotonic()
        end = Call(-token, device.name, instruction.cancel, [], now, math.inf)
        device.acting[instruction.channel] = Running(end, running.call, until=now + device.rest_within)
        return [*effects, Execute(end)]

    def finished(self, token: int, value: DeviceValue) -> list[Effect]:
        """The driver has carried a call out."""
        effects = self.tick()
        running = self._take(token)
        if running is None:
            return effects
        call = running.call
        device = self._devices[call.device]
        instruction = device.declared(call)
        how = way(instruction)
        if how == "setpoint":
            device.setpoints[instruction.channel] = self._clock.monotonic() + device.ttl
        elif how == "act":
            device.setpoints.pop(instruction.channel, None)
        return [*effects, Tell(running.done(value))]

    def refused(self, token: int, kind: str, reason: str) -> list[Effect]:
        """The device did not do it, and said so: an exception for the program, no reason to go safe."""
        effects = self.tick()
        running = self._take(token)
        if running is None:
            return effects
        if running.cancelled is None:
            return [*effects, Tell(Refused(token, kind, reason))]
        told = running.refused(f"{running.call.instruction}() failed: {reason}")
        return [*effects, Tell(told), *self._latch(self._devices[running.call.device], told.reason)]

    def crashed(self, token: int, reason: str) -> list[Effect]:
        """The driver raised what it should not while it carried out a call."""
        effects = self.tick()
        running = self._take(token)
        if running is None:
            return effects
        effects.append(Tell(running.refused(reason)))
        return effects + self._latch(self._devices[running.call.device], reason)

    def safe(self, device: str, reason: str, *, barred: bool = False, state: str = "") -> list[Effect]:
        """Somebody asks for the safe state of a device, or of all (''); or for another `state` than usual."""
        effects = self.tick()
        for name, known in self._devices.items():
            if device in ("", name):
                known.barred = known.barred or (reason if barred else "")
                effects += self._latch(known, reason, state)
        return effects

    def allow(self) -> list[Effect]:
        """The emergency is over: what is latched may be released."""
        for device in self._devices.values():
            device.barred = ""
        return self.tick()

    def made_safe(self, name: str) -> list[Effect]:
        """The driver has seen the device in its safe state."""
        effects = self.tick()
        device, now = self._devices[name], self._clock.monotonic()
        device.making, device.made_at = False, now
        if device.confirmed:
            return effects
        device.confirmed = True
        self._rest.confirmed(name, now)
        return [*effects, Tell(Latched(name, device.latched, True, device.state)), *self.tick()]

    def looked(self, name: str, moving: str) -> list[Effect]:
        """What the device still does in its safe state, in the driver's words; '' when it is at rest."""
        device, now = self._devices[name], self._clock.monotonic()
        told = self._rest.looked(name, moving, now)
        effects: list[Effect] = [Tell(Moving(name, moving))] if told else []
        waits = device.making or self._quiet or now < device.made_at + AGAIN
        if moving and device.confirmed and not waits:
            effects.append(_make_safe(device))
        return effects + self.tick()

    def not_safe(self, name: str, reason: str) -> list[Effect]:
        """The driver could not bring the device into its safe state; it is tried again."""
        effects = self.tick()
        device, now = self._devices[name], self._clock.monotonic()
        device.making, device.made_at = False, now
        if device.confirmed:
            return effects  # What it still does is told, and it is commanded again for that.
        device.retry_at = now + RETRY
        return [*effects, Tell(Note(name, f"its safe state is not confirmed, trying again: {reason}"))]

    def stop(self, reason: str, *, at_once: bool = False) -> list[Effect]:
        """The host wants to end: make everything safe, wait until it is at rest, then exit.

        With `at_once` nothing is waited for any longer.
        """
        if at_once:
            self._rest.at_once()
        return self._stop(reason)

    def gone(self, reason: str) -> list[Effect]:
        """The host has ended: make everything safe, then exit."""
        self._rest.alone()
        return self._stop(reason)

    def _stop(self, reason: str) -> list[Effect]:
        effects = self.tick()
        if not self._stopping:
            self._stopping = True
            self._rest.stop(self._clock.monotonic())
            effects += self._latch_all(reason)
        return effects + self.tick()

    def tick(self) -> list[Effect]:
        """Time has passed: whatever is due."""
        now = self._clock.monotonic()
        effects: list[Effect] = []
        silent = now >= self._silent_at
        for device in self._devices.values():
            if silent and device.moved:
                effects += self._latch(device, host_silent(self._silence))
            until = device.expiry()
            if until is not None and now >= until:
                effects += self._latch(device, f"the setpoint's time-to-live of {device.ttl:g} s is over")
            if slow := device.too_slow(now):
                effects += self._latch(device, slow)
            if device.retry_at is not None and now >= device.retry_at:
                device.retry_at = None
                effects.append(_make_safe(device))
        effects += self._be_quiet(now)
        if self._ended:
            return effects
        effects += [Look(name) for name in self._rest.to_look_at(now)]
        return effects + self._end_if_over(now)

    def due(self) -> float | None:
        """When the next tick is needed, on the injected clock; None when nothing can become due."""
        if self._ended:
            return None
        times = [device.due() for device in self._devices.values()]
        times += [self._rest.due(), self._silence_due()]
        return min((time for time in times if time is not None), default=None)

    # -- decisions ------------------------------------------------------------------------------------

    def _too_late(self, call: Call) -> str:
        """Why a call may not begin any more; '' while it may."""
        now = self._clock.monotonic()
        if now < call.until or self._devices[call.device].declared(call).only_asks:
            return ""
        within = f"{call.instruction}() was to begin within {max(0.0, call.until - call.sent):.3g} s"
        return f"{within}, and its guard got to it after {now - call.sent:.3g} s: nothing was done"

    @property
    def _silent_at(self) -> float:
        """When the host counts as silent, if it says nothing more."""
        return self._last_beat + self._silence

    def _silence_due(self) -> float | None:
        """When there is something to be done about a silence; None when all of it has been done."""
        if any(device.moved and not device.latched for device in self._devices.values()):
            return self._silent_at
        return None if self._quiet else self._quiet_at()

    def _quiet_at(self) -> float:
        """When a silent host's bus is made quiet: at once if nothing is left to be sent for its sake."""
        if all(d.confirmed or not (d.latched or d.moved) for d in self._devices.values()):
            return max(self._silent_at, self._rest.under_way_until())
        return self._silent_at + QUIET_BY

    def _be_quiet(self, now: float) -> list[Effect]:
        if self._quiet or now < self._quiet_at():
            return []
        return [self._set_quiet(True)]

    def _set_quiet(self, on: bool) -> Quiet:
        self._quiet = on
        self._rest.quiet(on)
        return Quiet(on)

    def _ask(self, device: KnownDevice, call: Call) -> list[Effect]:
        """Let a call in that moves nothing; release() unlatches first, and tells the driver so."""
        effects: list[Effect] = []
        if call.instruction == RELEASE.name:
            if self._stopping:
                return [_refuse(call, "the host is stopping")]
            if device.barred:
                return [_refuse(call, f"{device.barred}; {LIFT}")]
            if device.latched and not device.confirmed:
                return [
                    _refuse(call, "its safe state is not confirmed yet; call release() again in a moment")
                ]
            if device.latched:
                effects += [*([LeaveOff(device.name)] if device.making else []), Tell(Released(device.name))]
                device.making = False
                device.latched, device.state, device.confirmed, device.moved = "", "", False, False
                self._rest.held(device.name)
        device.asking[call.token] = Running(call)
        return [*effects, Execute(call)]

    def _latch_all(self, reason: str) -> list[Effect]:
        return [effect for device in self._devices.values() for effect in self._latch(device, reason)]

    def _latch(self, device: KnownDevice, reason: str, state: str = "") -> list[Effect]:
        """Latch a device that has a safe state; the first reason for a state is the one that is kept."""
        if device.latched and state in ("", device.state):
            return []
        if not device.manifest.safe_states:
            said, device.told = device.told, reason
            return [Tell(Note(device.name, reason))] if reason != said and not self._stopping else []
        device.latched, device.state, device.confirmed, device.retry_at = reason, state, False, None
        self._rest.held(device.name)
        device.setpoints.clear()
        # The safe state goes out first: it is the effect that cannot wait.
        stopped = [
            effect
            for channel in list(device.acting)
            for effect in self._abandon(device, channel, f"stopped, since {reason}")
        ]
        return [
            *_only(Interrupt, stopped),
            *([LeaveOff(device.name)] if device.making else []),
            _make_safe(device),
            *_only(Tell, stopped),
            Tell(Latched(device.name, reason, False, state)),
        ]

    def _abandon(self, device: KnownDevice, channel: str, reason: str) -> list[Effect]:
        running = device.acting.pop(channel, None)
        if running is None:
            return []
        told = running.refused(f"{running.call.instruction}() was {reason}")
        return [Interrupt(running.call.token), Tell(told)]

    def _running(self, token: int) -> Running | None:
        """What runs for a token; None when it has been answered before."""
        found = (device.running(token) for device in self._devices.values())
        return next((running for running in found if running is not None), None)

    def _take(self, token: int) -> Running | None:
        """The same, no longer running."""
        running = self._running(token)
        if running is not None:
            self._devices[running.call.device].forget(running)
        return running

    def _end_if_over(self, now: float) -> list[Effect]:
        if not self._rest.is_over(now):
            return []
        self._ended = True
        unsafe = self._rest.unsafe()
        return [Tell(Stopped(unsafe)), Exit(1 if unsafe else 0)]


def _make_safe(device: KnownDevice) -> MakeSafe:
    device.making = True
    return MakeSafe(device.name, device.state)


def _refuse(call: Call, reason: str) -> Tell:
    return Tell(Refused(call.token, "DeviceException", reason))


def _only(kind: type[Effect], effects: list[Effect]) -> list[Effect]:
    return [effect for effect in effects if isinstance(effect, kind)]
