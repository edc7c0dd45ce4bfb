"""Draws faults from a seed and lets them happen to a team: each heals after a while, and all at the end."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Mapping, Sequence

from disks import Disk
from hosts import HostProcess
from links import Link

#: Seconds between two faults, and for how long each lasts.
BETWEEN, LASTS = (0.3, 2.5), (0.1, 4.0)
#: How often each kind is drawn.
KINDS = {"kill": 6, "kill all": 1, "stop": 3, "cut": 4, "silent": 2, "full disk": 2}


class Storm:
    """Faults on these hosts, their disks, and the links of each pair."""

    def __init__(
        self,
        dice: random.Random,
        hosts: Sequence[HostProcess],
        disks: Sequence[Disk],
        links: Mapping[tuple[int, int], Link],
    ) -> None:
        self._dice, self._hosts, self._disks, self._links = dice, hosts, disks, links
        self.faults: Counter[str] = Counter()
        self._tasks: set[asyncio.Task[None]] = set()

    async def rage(self) -> None:
        """One fault after the other, until this is cancelled."""
        while True:
            await asyncio.sleep(self._dice.uniform(*BETWEEN))
            kind = self._dice.choices(list(KINDS), list(KINDS.values()))[0]
            first, second = self._dice.sample(range(len(self._hosts)), 2)
            fault = self._happen(kind, first, second, self._dice.uniform(*LASTS))
            task = asyncio.ensure_future(fault)
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def heal(self) -> None:
        """Everything works again."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for link in self._links.values():
            link.heal()
        for disk in self._disks:
            disk.free()
        for host in self._hosts:
            host.go_on()
            host.start()

    async def _happen(self, kind: str, first: int, second: int, seconds: float) -> None:
        match kind:
            case "kill":
                await self._kill([self._hosts[first]], seconds / 2)
            case "kill all":
                await self._kill(self._hosts, seconds / 2)
            case "stop":
                await self._stop(self._hosts[first], seconds)
            case "full disk":
                await self._fill(self._disks[first], seconds)
            case "cut" | "silent":
                both = [self._links[first, second], self._links[second, first]]
                await self._sever(both, kind, seconds)

    async def _kill(self, hosts: Sequence[HostProcess], seconds: float) -> None:
        killed = [host for host in hosts if host.runs]
        self.faults["SIGKILL"] += len(killed)
        await asyncio.gather(*(host.kill() for host in killed))
        await asyncio.sleep(seconds)
        for host in killed:
            host.start()

    async def _stop(self, host: HostProcess, seconds: float) -> None:
        if host.runs:
            self.faults["SIGSTOP"] += 1
            host.stop()
            await asyncio.sleep(seconds)
            host.go_on()

    async def _fill(self, disk: Disk, seconds: float) -> None:
        if disk.can_be_full:
            self.faults["full disk"] += 1
            disk.fill()
            await asyncio.sleep(seconds)
            disk.free()

    async def _sever(self, links: Sequence[Link], kind: str, seconds: float) -> None:
        self.faults["link cut" if kind == "cut" else "link silent"] += 1
        for link in links:
            if kind == "cut":
                link.cut()
            else:
                link.silence()
        await asyncio.sleep(seconds)
        for link in links:
            link.heal()
