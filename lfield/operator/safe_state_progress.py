"""Tracks the devices after an emergency stop until they are at rest: answers in, lines and a verdict out.

A device is done when its host has confirmed its safe state and recent telemetry shows it at rest. `is_over`
is true when all are done, or the time is up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from msgspec import Struct

from lfield.errors import LfieldError, NoListener
from lfield.operator.targets import HostRef
from lfield.operator.team_model.team_state import DeviceState, HostState
from lfield.text.value_text import telemetry_text
from lfield.wire.fields import Telemetry
from lfield.wire.observer_messages import EmergencyStopResult

#: Least seconds between two lines about the activity of one device.
REPORT_INTERVAL = 1.0
#: Telemetry older than this (seconds) does not show the present state of a device.
SILENCE_TIMEOUT = 3.0

#: Telemetry counts as newer than the last when it is newer by more than this (s).
MIN_ADVANCE = 0.5

#: A host that accepts no connection for this time (s) after the stop has confirmed it through another host.
#: Its devices cannot be observed.
UNREACHABLE_TIMEOUT = 10.0

AT_REST = "at rest"


class DeviceProgress(Struct):
    """A device after a stop: `problem` is the reason why its safe state was not confirmed, `activity` its
    present motion.

    `last` is its last known activity, or its telemetry if that is from before the stop; `last_contact` is its
    time. `last_report` is the text and time of the last line about it. `has_host_answered`: its host has
    reported since the stop.
    """

    host_ref: HostRef
    name: str
    problem: str
    activity: str = ""
    last: str = ""
    last_contact: float = -math.inf
    is_at_rest: bool = False
    has_host_ended: bool = False
    has_host_answered: bool = False
    telemetry: dict[str, Telemetry] | None = None
    last_report: tuple[str, float] | None = None

    def update(self, state: DeviceState, since: float, now: float) -> None:
        """Handles a report of the host about the device. Telemetry from before the stop, `since` s ago, is
        no proof of rest.
        """
        self.telemetry = state.telemetry
        if state.telemetry_age is not None and state.telemetry_age >= min(since, SILENCE_TIMEOUT):
            if now - state.telemetry_age > self.last_contact + MIN_ADVANCE:
                self.last, self.last_contact = telemetry_text(state.telemetry), now - state.telemetry_age
            if state.telemetry_age >= SILENCE_TIMEOUT:
                self.activity = "no longer reporting"
            return
        self.is_at_rest = state.at_rest
        self.activity = self.last = _activity(state)
        self.last_contact = now - (state.telemetry_age or 0.0)

    def on_host_answered(self) -> None:
        """Records an answer of the host, whether or not it contains this device."""
        self.has_host_answered = True

    def on_host_silent(self, error: LfieldError) -> None:
        """Records that the host did not answer."""
        self.has_host_ended = isinstance(error, NoListener)
        if not self.is_at_rest:
            self.activity = (
                "its host has ended" if self.has_host_ended else f"its host does not answer: {error}"
            )

    def is_finished(self, seconds: float) -> bool:
        """Whether the device is no longer observed, `seconds` after the stop."""
        is_unreachable = not self.has_host_answered and seconds >= UNREACHABLE_TIMEOUT
        return self.is_at_rest or self.has_host_ended or is_unreachable

    def verdict(self, seconds: float, now: float) -> str:
        """The problem `seconds` after the stop, '' for none."""
        if self.is_at_rest:
            # Also after the time is up.
            return ""
        if self.problem:
            text = f"NOT CONFIRMED: {self.problem}"
        elif self.has_host_ended:
            text = "NOT SEEN AT REST: its host has ended before"
        elif self.activity and not self.has_host_answered:
            return f"NOT SEEN AT REST: it has confirmed its safe state, but {self.activity}"
        else:
            text = f"NOT AT REST after {seconds:.0f} s"
            if self.activity != self.last:
                text += f": {self.activity}"
        if self.last_contact == -math.inf:
            return f"{text}; last seen: never"
        return f"{text}; last seen {now - self.last_contact:.0f} s ago: {self.last or 'without telemetry'}"


def _activity(found: DeviceState) -> str:
    return found.motion or (AT_REST if found.latched else "NOT in its safe state")


class SafeStateProgress:
    """The devices of the hosts that received a stop; they must come to rest `within` seconds."""

    def __init__(self, within: float, now: float) -> None:
        self._started_at, self._within, self._now = now, within, now
        self._devices: dict[tuple[HostRef, str], DeviceProgress] = {}

    @property
    def devices(self) -> Iterable[DeviceProgress]:
        """All devices, in the order of the answers."""
        return self._devices.values()

    @property
    def host_refs(self) -> set[HostRef]:
        """The hosts to query again."""
        return {device.host_ref for device in self.devices if not device.has_host_ended}

    @property
    def is_over(self) -> bool:
        """Whether all devices are finished, or the time is up."""
        seconds = self._now - self._started_at
        return seconds >= self._within or all(device.is_finished(seconds) for device in self.devices)

    def on_stopped(self, place: HostRef, answer: EmergencyStopResult) -> None:
        """Handles the report of a host that has executed the stop."""
        for name, problem in answer.devices.items():
            self._devices[place, name] = DeviceProgress(place, name, problem)

    def on_host(self, place: HostRef, host: HostState) -> None:
        """Handles the answer of a host with the state of its devices, or its error."""
        own = {device.name: device for device in self.devices if device.host_ref == place}
        for device in own.values():
            if host.error is not None:
                device.on_host_silent(host.error)
            else:
                device.on_host_answered()
        for found in host.devices.values() if host.linked else ():
            if found.name in own:
                own[found.name].update(found, self._now - self._started_at, self._now)

    def set_time(self, now: float) -> None:
        """Sets the time of the answers that follow."""
        self._now = now

    def changes(self) -> list[DeviceProgress]:
        """The devices whose report has changed, each at most once per report interval."""
        changed = [device for device in self.devices if _has_changed(device, self._now)]
        for device in changed:
            device.last_report = device.activity, self._now
        return changed

    def verdicts(self) -> list[tuple[DeviceProgress, str]]:
        """The devices with a problem, each with its last activity."""
        seconds = self._now - self._started_at
        found = [(device, device.verdict(seconds, self._now)) for device in self.devices]
        return [(device, verdict) for device, verdict in found if verdict]


def _has_changed(device: DeviceProgress, now: float) -> bool:
    if device.last_report is None:
        return bool(device.activity)
    text, when = device.last_report
    # The final state is reported at once.
    return device.activity != text and (
        now - when >= REPORT_INTERVAL or device.is_at_rest or device.has_host_ended
    )
