"""The dead man's switch: how soon hardware is told to be safe when the host above it stops.

Copters fly on velocity setpoints, each behind a guard of its own, while busy processes take the computer's
time. Then

    expire    no setpoint is renewed      from the moment the last one was sent
    stop      SIGSTOP to the host         from the signal
    kill      SIGKILL to it               from the signal

to the first frame of the safe state on the wire, which must be there within the time-to-live + 50 ms. Every
setpoint on the wire is also compared with its own time: none may be later than 10 ms after it.
"""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path

from guards.copters import bindings, fake_copters
from harness.checkout import Checkout, Mission
from harness.figure import Figure, Opener
from harness.number_text import number_text
from harness.paced import Round
from harness.processes import Child, ChildError, Processes
from harness.samples import Contender

TTL, SILENCE, GRACE, LATE = 0.5, 0.2, 0.050, 0.010
VEHICLES, BUSY = 8, 4
TRIALS = int(os.environ.get("TRIALS", "12"))
SAFE, SETPOINT = "event to the first safe frame", "a setpoint after its time"

_HERE = Path(__file__).parent
#: A copter that is soon high up, and lands so slowly that it is never down when the next trial begins.
_BRISK = [
    "--climb",
    "40",
    "--acceleration",
    "40",
    "--land",
    "0.02",
    "--descend",
    "0.02",
    "--capacity",
    "900000",
]


class Flights:
    """Copters behind a cable, the host that flies them, and what was seen of both."""

    def __init__(self, checkout: Checkout, processes: Processes, way: str) -> None:
        self._checkout, self._processes = checkout, processes
        fakes = [fake_copters(checkout, processes, (1,), *_BRISK) for _ in range(VEHICLES)]
        self._cable = checkout.run(processes, str(_HERE / "deadman_wire.py"), *fakes)
        devices = bindings([(port, 1) for port in self._cable.line().split()[1:]], SILENCE, TTL)
        agents = [f"//Pilot:v{n}@here?{n}&{way}" for n in range(VEHICLES)]
        program = (_HERE / "deadman.L").read_text(encoding="utf-8")
        self._mission = Mission(processes.folder(), program, agents, devices)
        self._host: Child
        self.start_host()
        #: Seconds from an event to safety, and of each setpoint on the wire after its time-to-live.
        self.delays: list[float] = []
        self.late: list[float] = []
        self._sent: dict[tuple[str, str], float] = {}
        self.last_sent: dict[str, float] = {}
        #: When each vehicle was last flown, and first told to be safe after that.
        self.flown: dict[str, float] = {}
        self.safe: dict[str, float] = {}

    def start_host(self) -> None:
        """Start it, the first time or again."""
        (self._host,) = self._mission.up(self._checkout, self._processes)

    def tell_host(self, number: signal.Signals) -> None:
        """Send it a signal."""
        os.kill(self._host.pid, number)

    def look(self) -> list[tuple[str, float]]:
        """Take in what has happened; the safe frames that are the first after a setpoint."""
        for line in self._host.lines():
            _, vehicle, at, number = line.split()
            self._sent[vehicle, number] = self.last_sent[vehicle] = float(at)
        firsts = []
        for line in self._cable.lines():
            kind, vehicle, at, *number = line.split()
            if kind == "set":
                self._flown(vehicle, float(at), self._sent.get((vehicle, number[0])))
            elif kind == "safe" and vehicle not in self.safe and vehicle in self.flown:
                self.safe[vehicle] = float(at)
                firsts.append((vehicle, float(at)))
        return firsts

    def _flown(self, vehicle: str, at: float, sent: float | None) -> None:
        self.safe.pop(vehicle, None)
        self.flown[vehicle] = at
        if sent is not None:
            self.late.append(at - sent - TTL)


def expire(flights: Flights, rng: random.Random) -> None:
    """Setpoints that are not renewed: the delays since the last look."""
    time.sleep(0.05)
    flights.delays += [at - flights.last_sent[vehicle] for vehicle, at in flights.look()]


def stop(flights: Flights, rng: random.Random) -> None:
    """A host that hangs, and goes on later."""
    _let_fly(flights, rng)
    _signal(flights, signal.SIGSTOP)
    flights.tell_host(signal.SIGCONT)


def kill(flights: Flights, rng: random.Random) -> None:
    """A host that is gone, and started anew."""
    _let_fly(flights, rng)
    _signal(flights, signal.SIGKILL)
    flights.start_host()


def _let_fly(flights: Flights, rng: random.Random) -> None:
    """Until every vehicle has had a setpoint of this trial, and for a random moment more."""
    flights.look()
    begun = time.time()
    while sum(at > begun for at in flights.flown.values()) < VEHICLES:
        if time.time() > begun + 60.0:
            raise ChildError("a copter was not flown again within 60 s")
        time.sleep(0.02)
        flights.look()
    time.sleep(rng.uniform(0.0, 0.3))


def _signal(flights: Flights, number: signal.Signals) -> None:
    """Send it; a trial for each vehicle, until all have been told to be safe."""
    flights.look()
    event = time.time()
    flights.tell_host(number)
    told: dict[str, float] = {}
    while len(told) < VEHICLES:
        if time.time() > event + 10.0:
            raise ChildError(f"only {len(told)} of {VEHICLES} copters were made safe within 10 s")
        time.sleep(0.01)
        flights.look()
        told = {vehicle: at for vehicle, at in flights.safe.items() if at > event}
    flights.delays += [at - event for at in told.values()]


def trials(way: Callable[[Flights, random.Random], None]) -> Opener:
    """All trials of one way are one round."""

    def opener(checkout: Checkout, _: Processes) -> Contender:
        def measure() -> Round:
            with Processes() as processes:
                flights, dice = Flights(checkout, processes, way.__name__), random.Random(1)
                for _ in range(BUSY):
                    checkout.run(processes, "-c", "while True: pass")
                while len(flights.delays) < TRIALS:
                    way(flights, dice)
                return {SAFE: flights.delays, SETPOINT: flights.late}

        return measure

    return opener


FIGURE = Figure(
    "The dead man's switch",
    {way.__name__: trials(way) for way in (expire, stop, kill)},
    rounds=1,
    one_size="one busy computer with the same copters all the time",
    targets={SAFE: number_text(TTL + GRACE, "s"), SETPOINT: number_text(LATE, "s")},
    notes=(
        f"{TRIALS} trials of each; {BUSY} busy processes; {VEHICLES} copters; time-to-live {TTL * 1000:g} ms",
        "the targets are for MAX; make bench ONLY=deadman TRIALS=1000 makes more",
    ),
)
