"""What becomes of every device after an emergency stop: answers in, lines and a verdict out.

A device is well when its host has confirmed its safe state and it has been seen there, heard lately and at
rest. Until then it is looked for: `over` says when that has come to an end, well or not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from lfield.errors import LfieldError, NobodyListens
from lfield.operator.addressed import Place
from lfield.text.values import telemetry_in_words
from lfield.wire.fields import Telemetry
from lfield.wire.observing import DeviceStatus, EmergencyStopped, Status

#: What a device does is told again after so many seconds at the soonest.
TOLD_EVERY = 1.0
#: What was last heard of a device longer ago (seconds) says nothing of it now.
SILENT = 3.0

#: Telemetry is newer than what was seen of a device before when it is by more than this (seconds).
LATER = 0.5

AT_REST = "at rest"


@dataclass(slots=True)
class Device:
    """A device on its way down: `problem` is why its safe state was not confirmed, `words` what it does now.

    `last` is what it was last seen doing, or its telemetry where that is from before the stop, and `heard_at`
    when that was measured. `told` is the text of the last line about it and when that was printed.
    """

    place: Place
    name: str
    problem: str
    words: str = ""
    last: str = ""
    heard_at: float = -math.inf
    rested: bool = False
    gone: bool = False
    telemetry: dict[str, Telemetry] | None = None
    told: tuple[str, float] | None = None

    def look(self, found: DeviceStatus, since: float, now: float) -> None:
        """Its host has reported its state. Telemetry from before the stop, `since` s ago, proves nothing."""
        self.telemetry = found.telemetry
        if found.silent is not None and found.silent >= min(since, SILENT):
            if now - found.silent > self.heard_at + LATER:
                self.last, self.heard_at = telemetry_in_words(found.telemetry), now - found.silent
            if found.silent >= SILENT:
                self.words = "not heard any more"
            return
        self.rested = bool(found.latched) and not found.moving
        self.words = self.last = _doing(found)
        self.heard_at = now - (found.silent or 0.0)

    def host_silent(self, error: LfieldError) -> None:
        """Its host did not tell; when it has ended, that it will not."""
        self.gone = isinstance(error, NobodyListens)
        if not self.rested:
            self.words = "its host has ended" if self.gone else f"its host does not answer: {error}"

    def verdict(self, seconds: float, now: float) -> str:
        """What is wrong with it `seconds` after the stop, '' when all is well."""
        if self.rested:
            # However late: it has been seen.
            return ""
        if self.problem:
            wrong = f"NOT CONFIRMED: {self.problem}"
        elif self.gone:
            wrong = "NOT SEEN AT REST: its host has ended before"
        else:
            wrong = f"NOT AT REST after {seconds:.0f} s"
            if self.words != self.last:
                wrong += f": {self.words}"
        if self.heard_at == -math.inf:
            return f"{wrong}; last seen: never"
        return f"{wrong}; last seen {now - self.heard_at:.0f} s ago: {self.last or 'without telemetry'}"


def _doing(found: DeviceStatus) -> str:
    if not found.latched:
        return found.moving or "NOT in its safe state"
    return found.moving or AT_REST


class Descent:
    """The devices of the hosts that a stop has reached: within so many seconds from now they come to rest."""

    def __init__(self, within: float, now: float) -> None:
        self._began, self._within, self._now = now, within, now
        self._devices: dict[tuple[Place, str], Device] = {}

    @property
    def devices(self) -> Iterable[Device]:
        """All of them, in the order of the answers."""
        return self._devices.values()

    @property
    def places(self) -> set[Place]:
        """The hosts that there is something to ask of."""
        return {device.place for device in self.devices if not device.gone}

    @property
    def over(self) -> bool:
        """Whether nothing more will come, or the time is up."""
        return self._now - self._began >= self._within or all(d.rested or d.gone for d in self.devices)

    def stopped(self, place: Place, answer: EmergencyStopped) -> None:
        """A host has carried the stop out."""
        for name, problem in answer.devices.items():
            self._devices[place, name] = Device(place, name, problem)

    def told(self, place: Place, answer: Status | LfieldError) -> None:
        """A host has told how its devices are, or has not."""
        own = {device.name: device for device in self.devices if device.place == place}
        if isinstance(answer, LfieldError):
            for device in own.values():
                device.host_silent(answer)
            return
        for found in answer.devices:
            if found.name in own:
                own[found.name].look(found, self._now - self._began, self._now)

    def at(self, now: float) -> None:
        """What follows was asked at this time."""
        self._now = now

    def news(self) -> list[Device]:
        """The devices whose words have changed since they were here, each once in TOLD_EVERY at most."""
        changed = [device for device in self.devices if _is_news(device, self._now)]
        for device in changed:
            device.told = device.words, self._now
        return changed

    def verdicts(self) -> list[tuple[Device, str]]:
        """The devices that are not well, each with what is wrong and what it was last seen doing."""
        seconds = self._now - self._began
        found = [(device, device.verdict(seconds, self._now)) for device in self.devices]
        return [(device, wrong) for device, wrong in found if wrong]


def _is_news(device: Device, now: float) -> bool:
    if device.told is None:
        return bool(device.words)
    words, when = device.told
    # What it came to is told at once.
    return device.words != words and (now - when >= TOLD_EVERY or device.rested or device.gone)
