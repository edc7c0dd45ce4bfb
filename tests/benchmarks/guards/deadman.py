"""The dead man's switch: how soon hardware is told to be safe when the machine above it stops.

`python tests/benchmarks/deadman.py --trials 1000` (run.py makes fewer). Copters fly on velocity setpoints,
each behind a guard of its own, while four busy processes take the computer's time. Then

    expire    no setpoint is renewed                 from the moment the last one was sent
    stop      SIGSTOP to the process of the machine  from the signal
    kill      SIGKILL to it                          from the signal

to the first frame of the safe state on the wire, which must be there within the time-to-live + 50 ms. Every
setpoint on the wire is also compared with its own time: none may be later than 10 ms after it.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from harness import ChildError, Children, Figure, Row, milliseconds, percentile, times
from rich.progress import Progress

TTL, GRACE, LATE = 0.5, 0.050, 0.010
VEHICLES, BUSY = 8, 4
FEW = 12

_HERE = Path(__file__).parent
#: A copter that is soon high up, and lands so slowly that it is never down when the next trial begins.
_BRISK = (
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
)


@dataclass(slots=True)
class Trials:
    """What was seen: seconds from event to safe frame, and the setpoint that was latest after its time."""

    delays: list[float] = field(default_factory=list)
    latest: float = -TTL
    setpoints: int = 0


class Wire:
    """The cable, its fakes, and what has passed since the last look."""

    def __init__(self, children: Children) -> None:
        fakes = [
            children.start(
                sys.executable, "-m", "lfield_sim", "mavlink", "--listen", "udp:127.0.0.1:0", *_BRISK
            )
            for _ in range(VEHICLES)
        ]
        ports = [fake.line().split()[1].rpartition(":")[2] for fake in fakes]
        self._cable = children.start(sys.executable, str(_HERE / "deadman_wire.py"), *ports)
        self.ports = self._cable.line().split()[1:]

    def take(self) -> list[list[str]]:
        """The words of each command that has passed since the last call."""
        return [line.split() for line in self._cable.lines()]


class Machine:
    """The process under test, and what it has sent."""

    def __init__(self, children: Children, wire: Wire, way: str) -> None:
        self._child = children.start(sys.executable, str(_HERE / "deadman_vm.py"), str(TTL), way, *wire.ports)
        while self._child.line() != "up":
            pass

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._child.pid

    def take(self) -> list[list[str]]:
        """The words of each line since the last call."""
        return [line.split() for line in self._child.lines()]

    def end(self) -> None:
        """End it."""
        self._child.end()


class Bench:
    """Trials of one way, on one wire."""

    def __init__(self, wire: Wire, progress: Callable[[], None]) -> None:
        self._wire, self._progress = wire, progress
        self.trials = Trials()
        self._sent: dict[tuple[str, str], float] = {}
        self._last: dict[str, float] = {}
        #: When each vehicle was first told to be safe after its last setpoint, or is flying: absent.
        self.safe: dict[str, float] = {}
        self.flown: dict[str, float] = {}

    def look(self, machine: Machine) -> list[tuple[str, float]]:
        """Take in what has happened; the safe frames that are the first after a setpoint."""
        for words in machine.take():
            if words[0] == "sent":
                vehicle, at, number = words[1], float(words[2]), words[3]
                self._sent[vehicle, number] = at
                self._last[vehicle] = at
        firsts = []
        for words in self._wire.take():
            vehicle, at = words[1], float(words[2])
            if words[0] == "set":
                self.safe.pop(vehicle, None)
                self.flown[vehicle] = at
                self._judge_setpoint(at, self._sent.get((vehicle, words[3])))
            elif words[0] == "safe" and vehicle not in self.safe and vehicle in self.flown:
                self.safe[vehicle] = at
                firsts.append((vehicle, at))
        return firsts

    def add(self, delay: float) -> None:
        """One trial is over."""
        self.trials.delays.append(delay)
        self._progress()

    def last_sent(self, vehicle: str) -> float:
        """When the last setpoint of a vehicle was sent."""
        return self._last[vehicle]

    def _judge_setpoint(self, at: float, sent: float | None) -> None:
        if sent is not None:
            self.trials.setpoints += 1
            self.trials.latest = max(self.trials.latest, at - sent - TTL)


def expire(children: Children, bench: Bench, wire: Wire, wanted: int) -> None:
    """Setpoints that are not renewed."""
    machine = Machine(children, wire, "expire")
    while len(bench.trials.delays) < wanted:
        time.sleep(0.05)
        for vehicle, at in bench.look(machine):
            bench.add(at - bench.last_sent(vehicle))
    machine.end()


def stop(children: Children, bench: Bench, wire: Wire, wanted: int) -> None:
    """A machine that hangs, and goes on later."""
    machine, dice = Machine(children, wire, "last"), random.Random(1)
    while len(bench.trials.delays) < wanted:
        _let_fly(bench, machine, dice)
        _signal(bench, machine, signal.SIGSTOP)
        os.kill(machine.pid, signal.SIGCONT)
    machine.end()


def kill(children: Children, bench: Bench, wire: Wire, wanted: int) -> None:
    """A machine that is gone, and started anew."""
    dice = random.Random(2)
    while len(bench.trials.delays) < wanted:
        machine = Machine(children, wire, "last")
        _let_fly(bench, machine, dice)
        _signal(bench, machine, signal.SIGKILL)
        machine.end()


def _let_fly(bench: Bench, machine: Machine, dice: random.Random) -> None:
    """Until every vehicle has had a setpoint of this trial, and for a random moment more."""
    bench.look(machine)
    begun = time.monotonic()
    while len([at for at in bench.flown.values() if at > begun]) < VEHICLES:
        if time.monotonic() > begun + 60.0:
            raise ChildError("a copter was not flown again within 60 s")
        time.sleep(0.02)
        bench.look(machine)
    time.sleep(dice.uniform(0.0, 0.3))


def _signal(bench: Bench, machine: Machine, number: signal.Signals) -> None:
    """Send it; a trial for each vehicle, until all have been told to be safe."""
    bench.look(machine)
    event = time.monotonic()
    os.kill(machine.pid, number)
    told: dict[str, float] = {}
    while len(told) < VEHICLES:
        if time.monotonic() > event + 10.0:
            raise ChildError(f"only {len(told)} of {VEHICLES} copters were made safe within 10 s")
        time.sleep(0.01)
        bench.look(machine)
        told |= {vehicle: at for vehicle, at in bench.safe.items() if at > event}
    for at in told.values():
        bench.add(at - event)


WAYS = {"expire": expire, "stop": stop, "kill": kill}


def measure(trials: int, names: Sequence[str] = tuple(WAYS)) -> dict[str, Trials]:
    """All ways, so many trials each."""
    found = {}
    with Progress(transient=True) as shown, Children() as busy:
        for _ in range(BUSY):
            busy.start(sys.executable, "-c", "while True: pass")
        for name in names:
            task = shown.add_task(name, total=trials)
            with Children() as children:
                wire = Wire(children)
                bench = Bench(wire, lambda task=task: shown.advance(task))
                WAYS[name](children, bench, wire, trials)
                found[name] = bench.trials
    return found


def figure(trials: int = FEW) -> Figure:
    """The delays against the bound."""
    bound = TTL + GRACE
    rows = []
    for name, seen in measure(trials).items():
        worst = max(seen.delays)
        rows.append(
            Row(
                f"{name}, {len(seen.delays)} trials",
                "event to first safe frame: median, p99",
                milliseconds(percentile(seen.delays, 50)),
                milliseconds(percentile(seen.delays, 99)),
            )
        )
        rows.append(
            Row("", "the worst, against its bound", milliseconds(worst), "", times(worst / bound), "1.00x")
        )
        late = f"{milliseconds(seen.latest)} after its time"
        rows.append(Row("", f"latest of {seen.setpoints} setpoints", late, "", "", milliseconds(LATE)))
    notes = (
        f"{BUSY} busy processes; {VEHICLES} copters; time-to-live {TTL * 1000:g} ms, silence 200 ms",
        "python tests/benchmarks/deadman.py --trials 1000 makes them all",
    )
    return Figure("The dead man's switch; ratio to time-to-live + 50 ms", rows, notes)


def main() -> int:
    """Measure as often as told; 1 when a bound was not kept."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("names", nargs="*", default=list(WAYS))
    args = parser.parse_args()
    kept = True
    for name, seen in measure(args.trials, args.names).items():
        worst = max(seen.delays)
        kept = kept and worst <= TTL + GRACE and seen.latest <= LATE
        print(f"{name}: {len(seen.delays)} trials, from the event to the first safe frame:")
        for percent in (50, 99, 100):
            print(f"    {percent} % within {milliseconds(percentile(seen.delays, percent))}", end="")
        print(f" (bound {milliseconds(TTL + GRACE)})")
        print(f"    the latest of {seen.setpoints} setpoints {milliseconds(seen.latest)} after its time")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
