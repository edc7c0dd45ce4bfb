"""Connects the flight recorder to a host: no object is wrapped if a host is not recorded."""

from __future__ import annotations

import asyncio
import hashlib
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

from lfield import __version__
from lfield.errors import LfieldError, RecordingError
from lfield.guard.messages import NO_RECORDING, GuardRecording
from lfield.host.core import HostCore
from lfield.host.effects import Environment
from lfield.host.recording.core_turns import CoreTurns
from lfield.host.recording.flight_recorder import FlightRecorder
from lfield.host.recording.host_records import Release, StartRecord
from lfield.host.recording.recorded_environment import RecordedEnvironment
from lfield.host.recording.recording_target import RecordingTarget
from lfield.mission.bundle import contents, decode, encode, with_signature
from lfield.mission.mission import Mission
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.wire.events import StateEvent


class RunIdentity:
    """The run id of one host: recordings of a team with the same id belong together.

    Each host proposes an id that begins with its time of start (`now`, in seconds since 1970). Hosts that
    meet keep the smaller one, so all hosts of a team agree on the id of the host that was started first.
    """

    def __init__(self, now: float, random_bytes: Callable[[int], bytes]) -> None:
        at = time.strftime("%Y%m%dT%H%M%S", time.gmtime(max(0.0, now)))
        #: The run id.
        self.id = f"{at}-{random_bytes(4).hex()}"

    def on_hello(self, other: str) -> bool:
        """Another host has this id, '' for none; returns whether it is now the id of this host too."""
        if not other or other >= self.id:
            return False
        self.id = other
        return True


def replayed_form(mission: Mission) -> Mission:
    """The mission as a replay reads it from the bundle: checkpoints number its objects.

    A mission that was loaded from files shares other objects than the same mission after decoding. Raises
    RecordingError for a bundle that cannot be decoded.
    """
    try:
        return replace(decode(encode(mission)), release=mission.release)
    except LfieldError as error:
        raise RecordingError(f"its bundle cannot be read again: {error}") from None


def _encoded_bundle(mission: Mission) -> bytes:
    """The bundle of the mission as it runs, with its signature if the signature is of the same bytes.

    Other bindings, such as those of simulated devices, and other addresses make another bundle.
    """
    data = encode(mission)
    release = mission.release
    is_same = release.signature and contents(data).digest == release.digest
    return with_signature(data, release.signature) if is_same else data


class RecordingSession:
    """The recording of one incarnation; without `target` there is no recording.

    `note` writes a log line.
    """

    def __init__(
        self,
        target: RecordingTarget | None,
        mission: Mission,
        run: RunIdentity,
        note: Callable[[LogLine], None],
    ) -> None:
        self._target, self._mission, self.run = target, mission, run
        self._note, self._loop = note, asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        #: The recorder, None without a recording.
        self.flight: FlightRecorder | None = None
        self._environment: RecordedEnvironment | None = None
        self._turns: CoreTurns | None = None
        self._host, self._incarnation = "", 0
        self._drawn: list[bytes] = []
        self._seed = 0

    # --- while the core is constructed ----------------------------------------------------------------

    def set_seed(self, seed: int) -> None:
        """The seed of the core's random numbers."""
        self._seed = seed

    def environment(self, inner: Environment, turns: CoreTurns) -> Environment:
        """The environment for the core."""
        if self._target is None:
            return inner
        calls = self._mission.program.core.device_calls
        self._environment = RecordedEnvironment(inner, {each: n for n, each in enumerate(calls)}, turns)
        return self._environment

    def random_bytes(self, inner: Callable[[int], bytes]) -> Callable[[int], bytes]:
        """The source of random bytes for the core."""
        if self._target is None:
            return inner

        def draw(size: int) -> bytes:
            drawn = inner(size)
            self._drawn.append(drawn)
            return drawn

        return draw

    def attach(self, core: HostCore, turns: CoreTurns, engine: str) -> None:
        """Begin to record a core, in the turn that has constructed it."""
        self._turns, self._host, self._incarnation = turns, core.name, core.incarnation
        self._open(core, turns, engine)
        turns.attach(core, self.flight)

    def _open(self, core: HostCore, clock: CoreTurns, engine: str) -> None:
        if self._target is None or self._environment is None:
            return
        bundle, wall_time = _encoded_bundle(self._mission), clock.time()
        start = self._start_record(core, clock, engine, hashlib.sha256(bundle).digest())
        self._drawn.clear()
        at = core.name, core.incarnation, wall_time
        try:
            sink = self._target.open_sink(*at, bundle, self._on_failure_elsewhere)
        except LfieldError as error:
            self._on_failure(str(error))
            return
        arguments = self._environment, start, sink, self._drawn, self._on_pending
        self.flight = FlightRecorder(core, clock, *arguments)
        core.recorder.watch_shell(self._note_event)

    def _start_record(self, core: HostCore, clock: CoreTurns, engine: str, bundle: bytes) -> StartRecord:
        context, release = core.context, self._mission.release
        signed = Release(release.digest, release.signature, release.by, release.at, release.is_from_files)
        return StartRecord(
            __version__, core.name, core.incarnation, self.run.id, self._mission.name,
            bundle, signed, self._seed, context.unreachable_after, context.journal_id, list(context.records),
            list(context.times.items()), engine, core.machine.engine.pace, False, clock.monotonic(),
            clock.time(), context.recorder.hybrid_clock.state, self._drawn.copy(),
        )  # fmt: skip

    # --- while the host runs --------------------------------------------------------------------------

    def on_hello(self, run: str) -> None:
        """Another host has this run id."""
        if self.run.on_hello(run) and self.flight is not None:
            self.flight.note_run(self.run.id)

    def _note_event(self, event: StateEvent) -> None:
        if self.flight is not None:
            self.flight.note_event(event)

    def for_guards(self) -> GuardRecording:
        """The recording of the guards of this host."""
        if self.flight is None or self._target is None:
            return NO_RECORDING
        return self._target.for_guards(self._host, self._incarnation, self.run.id)

    def write_due(self, now: float) -> None:
        """Between two turns, write the data that is due."""
        if self.flight is None:
            return
        try:
            self.flight.write_due(now)
        except Exception as error:
            self._on_fault(error)

    def close(self, now: float) -> None:
        """The host ends in order."""
        if self._timer is not None:
            self._timer.cancel()
        if self.flight is None:
            return
        try:
            self.flight.close(now)
        except Exception as error:
            self._on_fault(error)

    def _on_pending(self) -> None:
        # The next turn that calls `write_due` may be minutes away.
        interval = None if self._target is None else self._target.flush_interval
        if self._timer is None and interval is not None:
            self._timer = self._loop.call_later(interval, self._flush)

    def _flush(self) -> None:
        self._timer = None
        if self.flight is None:
            return
        try:
            self.flight.flush()
        except Exception as error:
            self._on_fault(error)

    def _on_fault(self, error: Exception) -> None:
        """A fault of the recorder, which must not end the host."""
        self._on_failure(f"{type(error).__name__}: {error}")

    def _on_failure_elsewhere(self, reason: str) -> None:
        with suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(self._on_failure, reason)

    def _on_failure(self, reason: str) -> None:
        self.flight = None
        if self._turns is not None:
            self._turns.stop_recording()
        self._note(log_messages.HOST_RECORDING_ENDED.line(host=self._host, reason=reason))
