"""Process failures: seconds until a device is safe and at rest after its host, its guard or both are killed
or stopped.

The devices are fakes in processes of their own. Each time is measured by the device: from the signal to the
line of its log (`lfield sim ... --log`). `own` counts the trials in which the device's own watchdog acted
first: an autopilot's failsafe, a drive's consumer heartbeat, a servo's bus watchdog. After the failure of
both processes it is the only remaining protection. A device that is not safe or not at rest in time is a
failure of its case: the run prints it and ends with a status above 0.

TRIALS=3          trials of each case, quiet and busy (30)
KEEP=deaths.jsonl also write a line for each trial, with the log of its device
SIDE=1            parallel fakes of each device: 1, 2, 3 or 6 (2)
LOADS=quiet       one load only
KINDS=PX4,Rover   only devices whose names begin with these words
WAY=move          every trial is a long move, or `setpoints`
"""

from __future__ import annotations

import json
import os
import random
import signal
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from deaths.devices import DEVICES, Device
from deaths.trial import DEATHS, Outcome, Subject, Trial, Wave, run_in_parallel
from harness.checkout import Checkout
from harness.figure import Figure, Row
from harness.number_text import COUNT
from harness.processes import Processes
from harness.samples import Tick

TRIALS = int(os.environ.get("TRIALS", "30"))
SIDE = int(os.environ.get("SIDE", "2"))
QUIET, BUSY = "quiet", "busy"
#: Seconds of silence allowed to a host: the default of a binding, and a bound that a busy computer can keep.
SILENCE = {QUIET: 0.2, BUSY: 0.5}
LOADS = os.environ.get("LOADS", f"{QUIET} {BUSY}").split()
KINDS = tuple(os.environ.get("KINDS", "").split(","))
TRIED = tuple(device for device in DEVICES if device.name.startswith(KINDS))
#: One trial of this many uses the device's second way to move, unless $WAY selects one.
SECOND_WAY = 3
WAY = os.environ.get("WAY", "")


class Fleet:
    """The fakes of all devices, `side` of each."""

    def __init__(
        self,
        checkout: Checkout,
        processes: Processes,
        devices: Sequence[Device],
        side: int,
        silences: Iterable[float],
    ) -> None:
        self._subjects = {
            d.name: [Subject(checkout, processes, d, silences) for _ in range(side)] for d in devices
        }
        self._side, self._rng = side, random.Random(1)

    def round(self, number: int, silence: float) -> Iterator[list[Outcome]]:
        """Run every failure of every device once; yields the outcomes of each group of parallel trials."""
        for first in range(0, len(DEATHS), self._side):
            with Processes() as processes:
                yield self._try(number, first, Wave(processes, silence, self._rng))

    def _try(self, number: int, first: int, wave: Wave) -> list[Outcome]:
        """Run some failures of every device. All hosts start before the first failure."""
        trials = []
        for place, subjects in enumerate(self._subjects.values()):
            # Each device has a different failure, so that restarted guards do not wait for one another.
            deaths = [DEATHS[(number + first + place + n) % len(DEATHS)] for n in range(self._side)]
            ways = [way for way in subjects[0].device.ways if WAY in ("", way)] or subjects[0].device.ways
            way = ways[-1] if number % SECOND_WAY == SECOND_WAY - 1 else ways[0]
            trials += [Trial(*pair, way, wave) for pair in zip(subjects, deaths, strict=True)]
        try:
            for phase in (Trial.start, Trial.run_failure, Trial.end):
                run_in_parallel(phase(trial) for trial in trials)
        finally:
            for trial in trials:
                trial.end_host()
                trial.kill_guards()
        return [trial.outcome for trial in trials]


@contextmanager
def _load(checkout: Checkout, name: str) -> Iterator[None]:
    """Load the computer: a spinning process for each processor."""
    with Processes() as processes:
        for _ in range((os.cpu_count() or 1) if name == BUSY else 0):
            checkout.run(processes, "-c", "while True: pass")
        yield


def measured(checkout: Checkout, rounds: int, tick: Tick) -> Iterator[Row]:
    """Run all trials, quiet and busy in turns; yields the rows so far also after an interruption."""
    outcomes: dict[str, list[Outcome]] = {load: [] for load in LOADS}
    wrong: BaseException | None = None
    # SIGTERM raises KeyboardInterrupt: the stopped processes of a trial are ended.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        _measure(checkout, rounds, tick, outcomes)
    except BaseException as error:
        wrong = error
    finally:
        signal.signal(signal.SIGTERM, before)
    yield from rows(outcomes)
    if wrong is not None:
        raise wrong


def _measure(checkout: Checkout, rounds: int, tick: Tick, outcomes: dict[str, list[Outcome]]) -> None:
    keep, every = os.environ.get("KEEP"), len(LOADS) * rounds * len(TRIED) * len(DEATHS)
    with Processes() as processes:
        fleet = Fleet(checkout, processes, TRIED, SIDE, SILENCE.values())
        loads, done, failed = list(outcomes), 0, 0
        for number in range(rounds):
            for load in loads:
                with _load(checkout, load):
                    for found in fleet.round(number, SILENCE[load]):
                        outcomes[load] += found
                        done += len(found)
                        failed += sum(bool(outcome.why) for outcome in found)
                        tick(f"{load}, {done} of {every} trials, {failed} failed")
                        if keep:
                            _keep(Path(keep), load, found)
            loads.reverse()


def _keep(path: Path, load: str, outcomes: Sequence[Outcome]) -> None:
    with path.open("a", encoding="utf-8") as file:
        for outcome in outcomes:
            file.write(json.dumps({"load": load, **asdict(outcome)}) + "\n")


def rows(outcomes: dict[str, list[Outcome]]) -> Iterator[Row]:
    """Rows of each device and failure, quiet and busy: seconds to the safe state and to rest, failures."""
    for device in TRIED:
        for death in map(str, DEATHS):
            case = f"{device.name}, {death}"
            of_case = {
                load: [o for o in found if (o.device, o.death) == (device.name, death)]
                for load, found in outcomes.items()
            }
            yield from _rows_of(case, of_case)
    for load, of_load in outcomes.items():
        again = sum(outcome.starts > 1 for outcome in of_load)
        if again:
            yield Row("trials started again: the device had stopped", load, COUNT, [again])


def _rows_of(case: str, outcomes: dict[str, list[Outcome]]) -> Iterator[Row]:
    label = case
    for what in ("safe", "at rest"):
        for load, found in outcomes.items():
            samples = [seconds for o in found if (seconds := o.verdict.seconds(what)) is not None]
            own = f", own {sum(o.verdict.own for o in found)}" if what == "safe" else ""
            if samples:
                yield Row(label, f"{load}: {what} {len(samples)}/{len(found)}{own}", samples=samples)
                label = ""
    for load, found in outcomes.items():
        why = [f"{o.way}: {o.why}" for o in found if o.why]
        if why:
            reasons = "; ".join(dict.fromkeys(why))
            yield Row(case, load, error=f"{len(why)} of {len(found)} trials failed: {reasons}")


FIGURE = Figure(
    "Process failures: seconds from the signal to the safe state and to rest, by the device's own log",
    {},
    rounds=TRIALS,
    own_rows=measured,
    one_size="the cases differ by device and failure, not by a size",
    notes=(
        f"{SIDE} fakes of each device in parallel; own: the device's own watchdog acted first; silence: "
        + ", ".join(f"{load} {seconds:g} s" for load, seconds in SILENCE.items()),
        "every third trial is a long move, others are setpoints (ODrive: all, Dynamixel: none); height 1 m",
        "guards and fakes run with real-time priority where the system allows it, hosts never",
        "make bench ONLY=deaths TRIALS=3 LOADS=quiet runs fewer, KEEP=FILE records every trial",
    ),
)
