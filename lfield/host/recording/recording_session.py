"""Connects the flight recorder to a host: nothing is wrapped where a host is not recorded."""

from __future__ import annotations

from collections.abc import Callable, Collection

from lfield import __version__
from lfield.host.core import HostCore
from lfield.host.effects import Environment
from lfield.host.inputs import LinksPlanned
from lfield.host.recording.flight_recorder import FlightRecorder
from lfield.host.recording.host_records import VERSION, StartRecord
from lfield.host.recording.record_sink import RecordSink
from lfield.host.recording.recorded_environment import RecordedEnvironment
from lfield.host.turn_clock import TurnClock
from lfield.mission.mission import Mission


class RecordingSession:
    """The recording of one incarnation; without `open_sink` nothing is recorded."""

    def __init__(self, open_sink: Callable[[int], RecordSink] | None, mission: Mission) -> None:
        self._open_sink, self._mission = open_sink, mission
        #: The recorder, None without a recording.
        self.flight: FlightRecorder | None = None
        self._environment: RecordedEnvironment | None = None
        self._drawn: list[bytes] = []
        self._seed = 0

    # --- while the core is constructed ----------------------------------------------------------------

    def set_seed(self, seed: int) -> None:
        """The seed of the core's random numbers."""
        self._seed = seed

    def environment(self, inner: Environment) -> Environment:
        """The environment for the core."""
        if self._open_sink is None:
            return inner
        calls = self._mission.program.core.device_calls
        self._environment = RecordedEnvironment(inner, {each: n for n, each in enumerate(calls)})
        return self._environment

    def random_bytes(self, inner: Callable[[int], bytes]) -> Callable[[int], bytes]:
        """The source of random bytes for the core."""
        if self._open_sink is None:
            return inner

        def draw(size: int) -> bytes:
            drawn = inner(size)
            self._drawn.append(drawn)
            return drawn

        return draw

    def attach(self, core: HostCore, clock: TurnClock, engine: str) -> None:
        """The core is constructed, at the latched time of `clock`."""
        if self._open_sink is None or self._environment is None:
            return
        context = core.context
        start = StartRecord(
            VERSION, __version__, core.name, core.incarnation, "", self._mission.name,
            self._mission.release.digest, self._seed, context.unreachable_after, context.journal_id,
            list(context.records), list(context.times.items()), engine, core.machine.engine.pace, False,
            clock.monotonic(), clock.time(), context.recorder.hybrid_clock.state, self._drawn.copy(),
        )  # fmt: skip
        self._drawn.clear()
        sink = self._open_sink(core.incarnation)
        self.flight = FlightRecorder(core, clock, self._environment, start, sink, self._drawn)

    # --- while the host runs --------------------------------------------------------------------------

    def write_due(self, now: float) -> None:
        """Between two turns: write what is due."""
        if self.flight is not None:
            self.flight.write_due(now)

    def needed_hosts(self, core: HostCore, clock: TurnClock) -> Collection[str]:
        """See `HostCore.needed_hosts`, which changes the state of the core."""
        flight = self.flight
        if flight is None or clock.in_turn:
            return core.needed_hosts()
        at = clock.begin_turn()
        flight.begin_turn(at, LinksPlanned(), runs=False)
        found = core.needed_hosts()
        flight.end_turn([])
        clock.end_turn()
        return found

    def close(self, now: float) -> None:
        """The host ends in order."""
        if self.flight is not None:
            self.flight.close(now)


def open_recording(open_sink: Callable[[int], RecordSink] | None, mission: Mission) -> RecordingSession:
    """The recording of a host that starts now."""
    return RecordingSession(open_sink, mission)
