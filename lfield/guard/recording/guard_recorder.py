"""Writes the records of a guard into its ring; a caller only appends to a queue."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path

import msgspec

from lfield import __version__
from lfield.clock import Clock
from lfield.driver.recording.wire_log import LogRing
from lfield.guard.effects import Effect
from lfield.guard.guard_device import CoreState
from lfield.guard.messages import GuardCall, Note, OpenDevices, TelemetrySnapshot
from lfield.guard.recording.guard_inputs import CallStarting, GuardInput, HostBeat, TimerExpired
from lfield.guard.recording.guard_records import (
    ControlRecord,
    InputRecord,
    NoteRecord,
    SegmentStart,
    TelemetryRecord,
    changed_values,
    decisions_of,
    framed,
    recorded_device,
)
from lfield.guard.recording.heartbeat_pulses import PulseCollector
from lfield.manifest import DeviceManifest, DeviceValue
from lfield.recording.folders import parse_folder

#: Minimum seconds between two records of the telemetry of a device: 10 Hz.
TELEMETRY_INTERVAL = 0.1
#: A timer of snapshots may be early by this many seconds.
_EARLY = 0.005
#: The maximum number of records that wait for the first segment, while the devices are opened.
MOST_EARLY = 1000


class _Telemetry:
    """The telemetry of one device: the last recorded values, and the changes that are not recorded yet.

    Both are by the position of the quantity in the manifest.
    """

    def __init__(self, manifest: DeviceManifest) -> None:
        self._positions = {quantity.name: at for at, quantity in enumerate(manifest.telemetry)}
        self.recorded: dict[int, DeviceValue] = {}
        self.pending: dict[int, DeviceValue] = {}
        self.observed_at, self.recorded_at = 0.0, -math.inf
        self.is_foreign = False

    def add(self, snapshot: TelemetrySnapshot) -> None:
        """Adds the values of a snapshot."""
        for name, observation in snapshot.values.items():
            self.pending[self._positions[name]] = observation.value
            self.observed_at = max(self.observed_at, observation.when)

    def changes(self, now: float) -> dict[int, DeviceValue]:
        """The values to record now; empty before TELEMETRY_INTERVAL is over."""
        if now < self.recorded_at + TELEMETRY_INTERVAL - _EARLY:
            return {}
        changed = changed_values(self.recorded, self.pending)
        self.pending.clear()
        if changed:
            self.recorded.update(changed)
            self.recorded_at = now
        return changed


class GuardRecorder:
    """The recorder of the devices of one message of the host."""

    def __init__(self, message: OpenDevices, clock: Clock, ring: LogRing) -> None:
        self._message, self._clock, self._ring = message, clock, ring
        #: Records before the first segment, None when the segment is started.
        self._early: list[bytes] | None = []
        self._origin = parse_folder(Path(message.recording.folder).parent)
        self._guard, self._number = f"{os.getpid()}-{clock.monotonic():.3f}", 0
        self._positions = {device.name: at for at, device in enumerate(message.devices)}
        manifests = message.driver.manifests
        self._telemetry = [_Telemetry(manifests[device.type].device) for device in message.devices]
        self._pulses = PulseCollector()

    @property
    def is_full(self) -> bool:
        """Whether a new segment should be started."""
        return self._ring.is_full

    def start(self, state: CoreState, unstarted: Sequence[GuardCall]) -> None:
        """Starts a segment with a state of the core."""
        self._flush_pulses()
        message, origin = self._message, self._origin
        start = SegmentStart(
            __version__,
            origin.host if origin else "",
            origin.incarnation if origin else "",
            message.recording.run,
            self._guard,
            self._number,
            self._clock.time(),
            self._clock.monotonic(),
            message.silence,
            [recorded_device(device, message.driver) for device in message.devices],
            state,
            list(unstarted),
            [telemetry.recorded for telemetry in self._telemetry],
        )
        self._number += 1
        early, self._early = self._early or [], None
        self._ring.start_file(b"".join([framed(start), *early]))

    def on_input(self, now: float, event: GuardInput, effects: Sequence[Effect]) -> None:
        """An input and the decisions of the core."""
        if not effects and isinstance(event, HostBeat | TimerExpired) and self._pulses.add(now, event):
            if self._pulses.is_full:
                self._flush_pulses()
            return
        self._append_input(InputRecord(now, event, decisions_of(effects)))

    def on_call_start(self, now: float, event: CallStarting, refusal: str) -> None:
        """The driver starts a call, unless there is a `refusal`."""
        self._append_input(InputRecord(now, event, msgspec.Raw(msgspec.msgpack.encode(refusal))))

    def _append_input(self, record: InputRecord) -> None:
        self._flush_pulses()
        self._append(framed(record))

    def _append(self, data: bytes) -> None:
        if self._early is None:
            self._ring.append(data)
        elif len(self._early) < MOST_EARLY:
            self._early.append(data)

    def on_snapshot(self, snapshot: TelemetrySnapshot) -> None:
        """Telemetry that is sent to the host."""
        at, now = self._positions[snapshot.device], self._clock.monotonic()
        telemetry = self._telemetry[at]
        telemetry.add(snapshot)
        if changed := telemetry.changes(now):
            self._append(framed(TelemetryRecord(telemetry.observed_at, at, changed)))
        if snapshot.is_foreign_controlled != telemetry.is_foreign:
            telemetry.is_foreign = snapshot.is_foreign_controlled
            self._append(framed(ControlRecord(now, at, telemetry.is_foreign)))

    def on_note(self, note: Note) -> None:
        """A log line."""
        now = self._clock.monotonic()
        self._append(framed(NoteRecord(now, note.device, note.text, note.code, note.level)))

    def close(self) -> None:
        """Writes the pending records; waits for the disk at most one second."""
        self._flush_pulses()
        for at, telemetry in enumerate(self._telemetry):
            if changed := telemetry.changes(math.inf):
                self._append(framed(TelemetryRecord(telemetry.observed_at, at, changed)))
        self._ring.close(1.0)

    def _flush_pulses(self) -> None:
        if (record := self._pulses.record()) is not None:
            self._append(framed(record))
