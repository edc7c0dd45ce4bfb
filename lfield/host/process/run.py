"""Runs one host as a process: until it is done, told to stop, or loses its parent."""

from __future__ import annotations

import asyncio
import gc
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NoReturn

from lfield import exits
from lfield.authority.admission import Admission
from lfield.authority.orders.signing import Certificates, Signer
from lfield.clock import SystemClock
from lfield.driver.binding import longest_rest
from lfield.host.host import Host
from lfield.host.logbook import Logbook
from lfield.host.process.leash import Leash
from lfield.host.process.proving import Proof, admitted, insist_on_keys, insist_on_signature
from lfield.host.process.stop_words import StopWords, hear_signals
from lfield.host.process.until_done import until_done
from lfield.host.stopping.shell import OrderKeys
from lfield.host.surroundings import Options
from lfield.journal.journal import Journal
from lfield.mission.mission import Mission
from lfield.mobility.fates import Fate
from lfield.net.tcp import TcpTransport

#: After so many seconds of a stop it is told what it waits for.
PATIENCE = 1.0
#: Seconds beyond those that its devices have, for a host that has failed, to end in order.
LAST_RESORT = 10.0
WAITING = "waiting for the devices to come to rest; a second Ctrl-C or SIGTERM does not wait for them"


async def run_host(
    mission: Mission,
    name: str,
    *,
    listen: str = "",
    door: str = "",
    dump: Path | None = None,
    unreachable_after: float | None = None,
    lost_after: float | None = None,
    proof: Proof | None = None,
    leash: bool = False,
    journal: Journal | None = None,
    first_start: bool = False,
    engine: str = "",
) -> int:
    """Run a host; returns the exit status (exits.py). `lost_after` None runs until it is stopped.

    `journal` is closed when it ends; without one it starts its coordinators when it has heard all hosts.
    `door` is the address where commands of this computer find it. `engine` says what runs the program,
    if not what the bindings say. Without `proof` of who it is, it is there for those commands alone.

    Raises AddressError, DevicesError and KeysError when it cannot start.
    """
    clock, logbook = SystemClock(), Logbook()
    address, tls, admission, orders = "", None, Admission(), None
    if proof is None:
        insist_on_keys(name, mission.team.hosts)
    else:
        address = listen or mission.team.addresses[mission.team.number(name)]
        certificates = Certificates(proof.keys.authority)
        times = journal.times.values() if journal else ()
        tls, admission = admitted(proof, name, clock, times, certificates.seen)
        orders = OrderKeys(Signer(proof.keys), certificates, proof.keys.authority)
        release, doubt = insist_on_signature(mission, proof, admission, journal.pages() if journal else ())
        mission = replace(mission, release=release)
        if doubt:
            logbook.note(f"this host goes on with bundle {release.short}, though {doubt}")
    bound = unreachable_after or mission.bindings.unreachable_after
    host_options = Options(
        address,
        dump,
        bound,
        door,
        journal=journal,
        first_start=first_start,
        clock=clock,
        engine=engine or mission.bindings.engine,
        admission=admission,
        orders=orders,
    )
    # What programs compute when a message wakes them is no work of whoever has sent it.
    transport = TcpTransport(mission.max_block, tls, exempt=lambda: host.core.programs.ran)
    host = Host(mission, name, transport, logbook, host_options)
    transport.note, host.core.programs.stopwatch = host.note, time.thread_time
    host.on_failure = _end_by_force_after(mission)
    words = StopWords(host.clock)
    hear_signals(words)
    if leash:
        Leash(sys.stdin.fileno(), host.reaped, partial(words.say, again=False))
    return await live(host, words, lost_after, _settle)


async def live(
    host: Host, words: StopWords, lost_after: float | None, started: Callable[[], None] = lambda: None
) -> int:
    """Run a host until it is done, is told to stop or fails; returns the exit status.

    `started` is called when it is up.
    """
    asyncio.get_running_loop().set_exception_handler(host.unhandled)
    life = asyncio.ensure_future(_until_done(host, lost_after, started))
    stopped = asyncio.ensure_future(words.first.wait())
    failed = asyncio.ensure_future(host.failed.wait())
    try:
        await asyncio.wait([life, stopped, failed], return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (life, stopped, failed):
            task.cancel()
        await asyncio.gather(life, stopped, failed, return_exceptions=True)
        unsafe = await _stop(host, words)
    if unsafe:
        _tell_why(life, host)
        return exits.UNSAFE
    if host.failure is not None:
        return host.failure.exit_status
    if life.cancelled():
        # Without --until-done there is no other end than to be told to stop.
        return exits.DONE if lost_after is None else exits.INTERRUPTED
    return life.result()


def _end_by_force_after(mission: Mission) -> Callable[[], None]:
    """Have the kernel end this process if it cannot do so in order, as when there is no memory for it."""
    bound = longest_rest(mission.bindings.all) + LAST_RESORT

    def arm() -> None:
        signal.setitimer(signal.ITIMER_REAL, bound)

    return arm


async def _stop(host: Host, words: StopWords) -> dict[str, str]:
    """Stop the host; the devices that were not seen at rest in their safe states."""
    words.on_second = host.guards.hurry
    told = asyncio.get_running_loop().call_later(PATIENCE, host.note, WAITING)
    try:
        return await host.stop()
    finally:
        told.cancel()


def _tell_why(life: asyncio.Future[int], host: Host) -> None:
    """What else is wrong, when the exit status says that a device is not safe."""
    if not life.cancelled() and (error := life.exception()) is not None:
        host.note(str(error))


def _settle() -> None:
    """What is loaded now stays: Python's collector need not look at it again in the middle of a hop."""
    gc.collect()
    gc.freeze()


async def _until_done(host: Host, lost_after: float | None, started: Callable[[], None]) -> int:
    """Start the host, and wait until all is done; for ever if `lost_after` is None."""
    await host.start()
    started()
    if lost_after is None:
        await _for_ever()
    return exits.worst(_told(host, fate) for fate in await until_done(host, lost_after))


def _told(host: Host, fate: Fate) -> int:
    """The status that a fate ends this host with; what others could not say, its log does."""
    match fate.outcome:
        case "done":
            return exits.DONE
        case "unheard":
            host.note(f"{fate.agent} is not heard of: {fate.detail}")
            return exits.UNHEARD
        case "lost":
            host.note(f"{fate.agent} is lost: {fate.detail}")
        case "died" if host.broken.get(fate.agent):
            return exits.SOFTWARE
    return exits.FAILED


async def _for_ever() -> NoReturn:
    while True:
        await asyncio.get_running_loop().create_future()
