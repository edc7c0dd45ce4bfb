"""The cost of events, for the figure `events`: prints the unit and samples of each case as JSON.

All costs are processor seconds or counts.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from lfield.clock import ManualClock, SystemClock
from lfield.host.events.event_log import EventLog, size_of
from lfield.host.events.event_recorder import EventRecorder
from lfield.host.events.event_subscription import MIN_INTERVAL, EventSubscription, TelemetrySample
from lfield.host.subscriptions.telemetry_snapshot import snapshot
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet
from lfield.wire import events
from lfield.wire.codec import encode
from lfield.wire.events import DeviceTelemetry, Event, StateEvent
from lfield.wire.observer_messages import Status
from lfield.wire.subscription_messages import Subscribe

#: Units of samples, as in the harness.
SECONDS, PERCENT, COUNT = "s", "%", "messages"
#: Number of vehicles, and telemetry rate of each (Hz).
VEHICLES, RATE = 50, 5.0
_PROGRAM = "resource Post { Mavlink fc; init(string[] arg) { } }\n"
#: The events of a coordinator that visits a portal, which commands a device, and departs.
VISIT: Sequence[StateEvent] = (
    events.MigrationArrived("Patrol:one", 3, 120, "alpha", 1424),
    events.PortalCallStarted(240, "Patrol:one", "copter7", "surveyField"),
    events.DeviceCallStarted(90, "copter7", "copter7.fc", "goTo"),
    events.DeviceCallEnded(90, "copter7", "copter7.fc", "goTo", 4.125731),
    events.Printed("copter7", "field 3 of 8 is surveyed"),
    events.PortalCallEnded(240, "Patrol:one", "copter7", "surveyField", 4.126102, "done"),
    events.MigrationStarted("Patrol:one", 3, 121, "charlie", "copter9", "surveyField", 1436),
    events.MigrationConfirmed("Patrol:one", 3, 121, "charlie", 0.001804),
)
STATUS = Status("alpha", "a:1", 0.5, b"", b"", [], [], [], [], [])


def telemetry(step: int) -> TelemetrySample:
    """The telemetry of all vehicles at a step, in the form of a copter driver."""
    return {
        f"device copter{n}.fc": (
            step,
            DeviceTelemetry(
                f"copter{n}.fc",
                {
                    "mode": "GUIDED",
                    "armed": True,
                    "landed": False,
                    "position": [10.0 + step, n * 1.5, -20.25],
                    "velocity": [1.25, 0.5, -0.125],
                    "heading": 1.0471 + step / 100,
                    "battery": 0.875,
                    "latitude": 47.397742 + step / 1e6,
                    "longitude": 8.545594,
                },
                0.125,
            ),
        )
        for n in range(VEHICLES)
    }


def per_call(work: Callable[[], object], count: int, rounds: int = 20) -> list[float]:
    """Processor seconds of one call, for each round."""
    durations = []
    for _ in range(rounds):
        start = time.process_time()
        for _ in range(count):
            work()
        durations.append((time.process_time() - start) / count)
    return durations


def recorded(cases: dict[str, tuple[str, list[float]]]) -> None:
    """Cost of recording an event, of sending it to one observer, and its bytes."""
    recorder = EventRecorder(SystemClock())
    visit = iter(VISIT * 10**6)
    cases["an event recorded, no observer"] = (
        SECONDS,
        per_call(lambda: recorder.emit_for_agent("Patrol:one", next(visit)), 4000),
    )
    stream = EventLog()
    for _ in range(64):
        for what in VISIT:
            stream.append(what, 1.7e9, 5.0, stream.latest)

    def batch() -> None:
        made = EventSubscription(stream, 1, Subscribe(1), 0.0).next_batch(1.7e9, 0.0, lambda: STATUS)
        assert made is not None
        encode(made)

    cases["an event sent to one observer"] = SECONDS, [s / 512 for s in per_call(batch, 20)]
    sizes = [float(size_of(Event(123_456, 1.7e9, 5000.25, 123_400, what))) for what in VISIT]
    cases["bytes of a state"] = COUNT, sizes
    measured = [float(size_of(Event(123_456, 1.7e9, 5000.25, 0, what))) for _, what in telemetry(1).values()]
    cases["bytes of a device's telemetry"] = COUNT, measured


def watched(cases: dict[str, tuple[str, list[float]]]) -> None:
    """Share of a processor for a host with 50 copters that sends telemetry to one observer at 5 Hz."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "mission.L").write_text(_PROGRAM)
        agents = "".join(f"//Post:copter{n}@alpha\n" for n in range(VEHICLES))
        (Path(folder) / "mission.dL").write_text(agents)
        fleet = Fleet(load_mission(Path(folder) / "mission.dL", simulate=True), 1)
    fleet.run(10.0)
    host = fleet.runs["alpha"].host
    observer, step = EventSubscription(EventLog(), 1, Subscribe(1, 0, RATE), 0.0), 0

    def turn() -> None:
        nonlocal step
        # Slightly late, as timers are.
        uptime = step * (1 / RATE + 1e-6)
        now = snapshot(host.core, host.guards, host.peers.monitor.latest, host.clock.monotonic())
        observer.on_sample(
            {key: ((step, version), what) for key, (version, what) in now.items()}, 1.7e9, uptime
        )
        batch = observer.next_batch(1.7e9, uptime + MIN_INTERVAL, lambda: STATUS)
        assert batch is not None
        assert len(batch.events) >= VEHICLES
        encode(batch)
        observer.on_ack(step + 1, uptime)
        step += 1

    name = f"{VEHICLES} vehicles at {RATE:g} Hz, one observer"
    cases[name] = PERCENT, [100 * seconds * RATE for seconds in per_call(turn, 50)]


def lost(cases: dict[str, tuple[str, list[float]]]) -> None:
    """Lost events, by kind, of an observer that reads one batch a second for ten minutes."""
    clock, stream = ManualClock(), EventLog()
    observer = EventSubscription(stream, 1, Subscribe(1, 0, RATE), 0.0)
    unread, count, step, missing = list[int](), 0, 0, Counter[str]()
    for tick in range(600 * 20):
        uptime = tick * MIN_INTERVAL
        if tick % 4 == 0:
            step += 1
            observer.on_sample(telemetry(step), clock.time(), uptime)
        if tick % 10 == 0:
            for what in VISIT:
                stream.append(what, clock.time(), uptime)
        if tick % 20 == 0 and unread:
            observer.on_ack(unread.pop(0), uptime)
        if batch := observer.next_batch(clock.time(), uptime, lambda: STATUS):
            unread.append(batch.batch)
            missing.update(batch.lost)
            count += sum(event.kind not in events.TELEMETRY for event in batch.events)
    cases["states lost, one batch read a second"] = COUNT, [float(missing["state"])]
    cases["telemetry lost, one batch read a second"] = COUNT, [float(missing["measured"])]
    cases["states sent to it"] = COUNT, [float(count)]


if __name__ == "__main__":
    found: dict[str, tuple[str, list[float]]] = {}
    for measure in (recorded, watched, lost):
        measure(found)
    print(json.dumps(found))
