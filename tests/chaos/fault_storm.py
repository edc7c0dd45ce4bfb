"""Draws faults from a seed and injects them into a team: each is healed after a delay, and all at the end."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Callable, Sequence

from host_process import HostProcess
from link_proxy import LinkProxy
from networks import RouterNetwork, RouterProcess, TcpNetwork
from small_disk import Disk

#: Seconds between two faults, and the duration of each.
BETWEEN, LASTS = (0.3, 2.5), (0.1, 4.0)
#: Duration of long faults: a majority continues without the host.
LONG = (4.0, 12.0)
#: Relative frequency of each kind.
SHORT_KINDS = {"kill": 6, "kill all": 1, "stop": 3, "cut": 4, "silent": 2, "full disk": 2}
LONG_KINDS = {"kill for good": 2, "stop the holder": 2, "cut off": 2}
KINDS = {**SHORT_KINDS, **LONG_KINDS}
#: Faults of routers.
ROUTER_KINDS = {"kill router": 3}


class FaultStorm:
    """Faults on these hosts, their disks, and the links of each pair.

    `holder` is the host with a coordinator that others may recover; -1 while unknown.
    """

    def __init__(
        self,
        rng: random.Random,
        hosts: Sequence[HostProcess],
        disks: Sequence[Disk],
        network: TcpNetwork | RouterNetwork,
        holder: Callable[[], int],
    ) -> None:
        self._rng, self._hosts, self._disks, self._network = rng, hosts, disks, network
        self._holder = holder
        self._kinds = {**KINDS, **(ROUTER_KINDS if network.routers else {})}
        self.faults: Counter[str] = Counter()
        self._tasks: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """Inject faults in sequence until cancelled."""
        while True:
            await asyncio.sleep(self._rng.uniform(*BETWEEN))
            kind = self._rng.choices(list(self._kinds), list(self._kinds.values()))[0]
            first, second = self._rng.sample(range(len(self._hosts)), 2)
            seconds = self._rng.uniform(*(LONG if kind in LONG_KINDS else LASTS))
            if kind in LONG_KINDS:
                first = max(self._holder(), 0)
            fault = self._happen(kind, first, second, seconds)
            task = asyncio.ensure_future(fault)
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def heal(self) -> None:
        """Heal all faults."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for link in self._network.links:
            link.heal()
        for router in self._network.routers:
            router.start()
        for disk in self._disks:
            disk.free()
        for host in self._hosts:
            host.resume()
            host.start()

    async def _happen(self, kind: str, first: int, second: int, seconds: float) -> None:
        match kind:
            case "kill":
                await self._kill([self._hosts[first]], seconds / 2)
            case "kill all":
                await self._kill(self._hosts, seconds / 2)
            case "stop":
                await self._stop(self._hosts[first], kind, seconds)
            case "kill for good":
                await self._kill([self._hosts[first]], seconds, kind)
            case "stop the holder":
                await self._stop(self._hosts[first], kind, seconds)
            case "cut off":
                await self._sever(self._network.links_of(first), kind, seconds)
            case "full disk":
                await self._fill(self._disks[first], seconds)
            case "cut" | "silent":
                await self._sever(self._network.links_between(first, second), f"link {kind}", seconds)
            case "kill router":
                await self._kill_router(self._network.routers[first % 2], seconds)

    async def _kill(self, hosts: Sequence[HostProcess], seconds: float, kind: str = "kill") -> None:
        killed = [host for host in hosts if host.runs]
        self.faults[kind] += len(killed)
        await asyncio.gather(*(host.kill() for host in killed))
        await asyncio.sleep(seconds)
        for host in killed:
            host.start()

    async def _stop(self, host: HostProcess, kind: str, seconds: float) -> None:
        if host.runs:
            self.faults[kind] += 1
            host.stop()
            await asyncio.sleep(seconds)
            host.resume()

    async def _kill_router(self, router: RouterProcess, seconds: float) -> None:
        self.faults["kill router"] += 1
        router.kill()
        await asyncio.sleep(seconds / 2)
        router.start()

    async def _fill(self, disk: Disk, seconds: float) -> None:
        if disk.can_be_full:
            self.faults["full disk"] += 1
            disk.fill()
            await asyncio.sleep(seconds)
            disk.free()

    async def _sever(self, links: Sequence[LinkProxy], kind: str, seconds: float) -> None:
        self.faults[kind] += 1
        for link in links:
            if kind == "link silent":
                link.silence()
            else:
                link.cut()
        await asyncio.sleep(seconds)
        for link in links:
            link.heal()
