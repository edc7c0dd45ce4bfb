"""Real processes under faults; the verdict is based on the calls that the resources have served.

    make chaos SECONDS=120            python tests/chaos/run.py --seconds 120 --seed 7
    make chaos OVER=zenoh             the same over two linked routers, which are killed too

Each round has a team of four hosts with journals and four walkers (walkers.L), two of which a majority
recovers. Hosts are killed, stopped and isolated, some long enough for a recovery, and their disks are
filled; then all faults are healed, and every walker must complete within a bound. The exit status is 1 if a
call was served twice, was served for an outdated walker, or was skipped silently, or if a mission is
incomplete; the folder with the output of all hosts is printed. A seed repeats the faults, not their timing.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from call_verdict import CallVerdict
from fault_storm import FaultStorm
from host_process import HostProcess
from networks import RouterNetwork, TcpNetwork
from small_disk import Disk

from lfield.testing.keyring import Keyring

PROGRAM = Path(__file__).with_name("walkers.L")
HOSTS, NUMBERS = 4, 150
#: Walkers that wait for their host, and recovered walkers; each starts on another host.
WALKERS, FENCED = ("w0", "w1"), ("f2", "f3")
#: A short period: an isolated walker soon calls its current host again, which it must not do without a lease.
IMPATIENT = ("--unreachable-after", "2")
#: Seconds of faults in a round, and the bound for completion after them.
STORM, BOUND = 30.0, 60.0


class Round:
    """One round: a team from its start to its end."""

    def __init__(self, bundle: Path, folder: Path, seed: int, *, over_zenoh: bool) -> None:
        self._over_zenoh = over_zenoh
        self._bundle, self._folder = folder / bundle.name, folder
        self.verdict = CallVerdict(dict.fromkeys((*WALKERS, *FENCED), NUMBERS))
        self._rng = random.Random(seed)
        keyring = Keyring(folder / "keys")
        self._keys = str(keyring.give(*(f"h{number}" for number in range(HOSTS))))
        self._bundle.write_bytes(bundle.read_bytes())
        keyring.sign(self._bundle)
        self.disks = [Disk(folder / f"disk{number}") for number in range(HOSTS)]
        self.hosts: list[HostProcess] = []
        self.faults: Counter[str] = Counter()
        #: Seconds from the last fault until all walkers were complete.
        self.healed_after = 0.0
        self.wrong: list[str] = []

    async def run(self) -> None:
        """Run the round; `wrong` has its breaches."""
        network = RouterNetwork(HOSTS, self._folder) if self._over_zenoh else TcpNetwork(HOSTS)
        await network.open()
        self.hosts = [self._host(number, network.options(number)) for number in range(HOSTS)]
        storm = FaultStorm(self._rng, self.hosts, self.disks, network, self._holder)
        try:
            for host in self.hosts:
                host.start()
            await self._inject_faults(storm)
            self._judge([host.name for host in self.hosts if not await host.end()])
        finally:
            for host in self.hosts:
                await host.kill()
            await network.close()
            for disk in self.disks:
                disk.close()

    def _host(self, number: int, where: list[str]) -> HostProcess:
        name = f"h{number}"
        state = str(self.disks[number].folder)
        arguments = ("up", str(self._bundle), "--host", name, *where, "--state", state, *IMPATIENT)
        arguments = (*arguments, "--keys", self._keys)
        hear = partial(self._on_line, name)
        return HostProcess(name, arguments, self._folder / f"{name}.log", hear)

    def _on_line(self, host: str, line: str) -> None:
        self.verdict.on_line(line, host, time.monotonic())

    def _holder(self) -> int:
        """The host of an incomplete walker that can be recovered."""
        under_way = [
            agent for agent in FENCED if agent not in self.verdict.walked and agent in self.verdict.where
        ]
        if not under_way:
            return -1
        where = self.verdict.where[self._rng.choice(under_way)]
        return next(number for number, host in enumerate(self.hosts) if host.name == where)

    async def _inject_faults(self, storm: FaultStorm) -> None:
        await self._wait_until(lambda: self.verdict.under_way, BOUND)
        raging = asyncio.ensure_future(storm.run())
        await self._wait_until(lambda: self.verdict.complete, STORM)
        raging.cancel()
        await asyncio.gather(raging, return_exceptions=True)
        started = time.monotonic()
        await storm.heal()
        await self._wait_until(lambda: self.verdict.complete, BOUND)
        self.healed_after = time.monotonic() - started
        self.faults = storm.faults

    async def _wait_until(self, is_so: Callable[[], bool], bound: float) -> None:
        """Wait until a condition holds, at most `seconds`."""
        end = time.monotonic() + bound
        while not is_so() and time.monotonic() < end:
            await asyncio.sleep(0.1)

    def _judge(self, unruly: list[str]) -> None:
        verdict = self.verdict
        missing = sorted(verdict.walkers.keys() - verdict.walked.keys())
        self.wrong += [f"{agent} {number} was served twice" for agent, number in verdict.twice]
        self.wrong += [
            f"{agent} {number} began after a later start of it" for agent, number in verdict.outdated
        ]
        self.wrong += [f"{agent} {number} was skipped without a word" for agent, number in verdict.skipped]
        self.wrong += [f"{agent} is not complete {BOUND:.0f} s after the last fault" for agent in missing]
        self.wrong += [f"{host} did not end with 0 when it was told to" for host in unruly]
        self.wrong += ["a traceback of Python"] * verdict.tracebacks


def built(folder: Path) -> Path:
    """The mission of all rounds, as one file."""
    deployment = folder / "walkers.dL"
    rows = [f"//Post:p{number}@h{number}" for number in range(HOSTS)]
    rows += [f"//Walker:{agent}@h{agent[1]}?{NUMBERS}" for agent in WALKERS]
    rows += [f"//Fenced:{agent}@h{agent[1]}?{NUMBERS}" for agent in FENCED]
    deployment.write_text("\n".join(rows) + "\n")
    (folder / "walkers.L").write_text(PROGRAM.read_text())
    command = [sys.executable, "-m", "lfield", "build", str(deployment)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return folder / "walkers.lfm"


def report(rounds: list[Round], folder: Path) -> int:
    """Print the results; returns the exit status."""
    faults = sum((each.faults for each in rounds), Counter())
    calls = sum(each.verdict.served.total() for each in rounds)
    walker_count = sum(len(each.verdict.walkers) for each in rounds)
    done = sum(len(each.verdict.walked.keys() & each.verdict.walkers.keys()) for each in rounds)
    hosts = [host for each in rounds for host in each.hosts]
    recoveries = [seconds for host in hosts for seconds in host.recoveries]
    gave_up = Counter(status for host in hosts for status in host.gave_up)
    kinds = ", ".join(f"{kind} {count}" for kind, count in sorted(faults.items()))
    print(f"faults      {faults.total()}: {kinds}")
    if not all(disk.can_be_full for each in rounds for disk in each.disks):
        print("            no disk was full: nothing may be mounted here")
    perhaps = sum(len(each.verdict.perhaps) for each in rounds)
    print(f"calls       {calls} made, {perhaps} told as perhaps made")
    repeated = sum(each.verdict.repeated for each in rounds)
    print(f"twice       {sum(len(each.verdict.twice) for each in rounds)}, {repeated} again knowingly")
    print(f"outdated    {sum(len(each.verdict.outdated) for each in rounds)}")
    print(f"skipped     {sum(len(each.verdict.skipped) for each in rounds)} without a word")
    print(f"complete    {done} of {walker_count} missions, in {len(rounds)} rounds")
    print(f"after heal  complete within {max(each.healed_after for each in rounds):.1f} s")
    say_times("recovery   ", "by its host, from the start of its process", recoveries)
    elsewhere = [seconds for each in rounds for seconds in each.verdict.recoveries]
    say_times("           ", "by a majority, from its last call", elsewhere)
    if gave_up:
        print(f"ended alone {', '.join(f'{n} with status {s}' for s, n in sorted(gave_up.items()))}")
    wrong = [f"round {number}: {what}" for number, each in enumerate(rounds) for what in each.wrong]
    print(*(f"BROKEN      {what}" for what in wrong), f"logs        {folder}", sep="\n")
    return 1 if wrong else 0


def say_times(title: str, what: str, seconds: Sequence[float]) -> None:
    """Print the number of durations, their median and their maximum."""
    if seconds:
        latency = f"median {statistics.median(seconds):.2f} s, at most {max(seconds):.2f} s"
        print(f"{title} {len(seconds)} {what}: {latency}")


async def rounds_for(seconds: float, seed: int, folder: Path, *, over_zenoh: bool) -> list[Round]:
    """Run rounds in sequence until the time is over."""
    bundle, end, rounds = built(folder), time.monotonic() + seconds, []
    while not rounds or time.monotonic() < end:
        number = len(rounds)
        place = folder / f"round{number}"
        place.mkdir()
        rounds.append(Round(bundle, place, seed + number, over_zenoh=over_zenoh))
        await rounds[number].run()
        print(f"round {number}, seed {seed + number}: {rounds[number].wrong or 'well'}", flush=True)
    return rounds


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Real processes in bad weather, judged.")
    parser.add_argument("--seconds", type=float, default=120.0, help="the last round begins before (120)")
    parser.add_argument("--seed", type=int, default=1, help="of the first round; each next has one more (1)")
    parser.add_argument("--zenoh", action="store_true", help="over two routers of Zenoh instead of TCP")
    args = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="lfield-chaos-"))
    # Separate folders: these runs and other runs on this computer do not find each other.
    os.environ |= {"LFIELD_RUNS": "here", "XDG_RUNTIME_DIR": str(folder)}
    rounds = asyncio.run(rounds_for(args.seconds, args.seed, folder, over_zenoh=args.zenoh))
    return report(rounds, folder)


if __name__ == "__main__":
    sys.exit(main())
