"""The links of one host, as a process: `python peer.py HERE KEYS HOST=ADDRESS ...`.

Prints `linked HOST` and `unlinked HOST` with the time, and the lines of the log. Ends with its input.
"""

from __future__ import annotations

import asyncio
import random
import sys
import time
from collections.abc import Collection
from pathlib import Path

from lfield.authority import keystore
from lfield.clock import SystemClock
from lfield.event_loop import run
from lfield.hybrid_clock import HybridClock
from lfield.net.link_manager import LinkManager
from lfield.net.link_owner import TeamAddresses
from lfield.net.tcp_transport import TcpTransport
from lfield.net.tls import TlsIdentity
from lfield.wire.messages import Control, Hello


def say(text: str) -> None:
    print(f"{time.monotonic():.3f} {text}", flush=True)


class Owner:
    """Keeps links with all other hosts and ignores their messages."""

    def __init__(self, name: str, others: Collection[str]) -> None:
        self._name, self._others, self._life = name, others, random.getrandbits(62) + 1
        self.hybrid_clock = HybridClock(0.0, 0.0)

    def hello(self) -> Hello:
        return Hello("host", self._name, self._life)

    def on_linked(self, hello: Hello) -> None:
        say(f"linked {hello.host}")

    def on_unlinked(self, host: str, *, quietly: bool) -> None:
        say(f"unlinked {host}")

    def desired_hosts(self) -> Collection[str]:
        return self._others

    def on_message(self, host: str, message: Control, link: object) -> None:
        pass

    def on_transfer(self, *_: object) -> None:
        pass

    on_oversize = on_transfer

    def note(self, text: str) -> None:
        say(f"note {text}")


async def main(here: str, keys: str, *places: str) -> None:
    """Keep the links until the input ends."""
    addresses = dict(place.split("=", 1) for place in places)
    names = list(addresses)
    numbers = {name: number for number, name in enumerate(names)}
    owner = Owner(here, [name for name in names if name != here])
    transport = TcpTransport(1 << 20, TlsIdentity(keystore.read_keys(Path(keys) / here, "host")))
    transport.note = owner.note
    clock, rng = SystemClock(), random.Random()
    peers = LinkManager(
        owner,
        transport,
        clock,
        rng,
        TeamAddresses(numbers, list(addresses.values()), numbers[here], set(names) - {here}),
    )
    say(f"listens {await peers.open(addresses[here])}")
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    peers.close()


if __name__ == "__main__":
    run(main(*sys.argv[1:]))
