"""Runs the service of one host as a process, until it is stopped."""

from __future__ import annotations

import asyncio
import random
import secrets
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from msgspec import Struct

from lfield.clock import SystemClock
from lfield.errors import AddressError
from lfield.event_loop import spawn
from lfield.host.logbook import JsonLogbook, Logbook
from lfield.host.process.credentials import HostCredentials, admission_for
from lfield.host.process.shutdown_signals import ShutdownSignals, install_signal_handlers
from lfield.net.tcp_transport import TcpTransport
from lfield.net.transport import Transport
from lfield.net.zenoh.host_transport import HostTransport
from lfield.operator.fleet.service_link import open_service_link
from lfield.service import messages
from lfield.service.bundle_receiver import BundleVerifier, vehicles_of
from lfield.service.bundle_store import BundleStore
from lfield.service.host_processes import LocalProcesses
from lfield.service.mission_probe import LocalProbe
from lfield.service.mission_runner import MissionRunner
from lfield.service.server import ServiceServer
from lfield.service.service import Service
from lfield.wire.fields import short_digest
from lfield.wire.service_messages import BallotState, ServiceQuery, ServiceStatus, VoteQuery

#: The largest frame that a service accepts, in bytes, seconds for an answer of another service, and seconds
#: between two checks of the certificates of linked peers.
MAX_BLOCK, PEER_TIMEOUT, REAUTHORISE_EVERY = 1 << 16, 8.0, 1.0


class ServiceOptions(Struct, frozen=True):
    """`state` is the directory of the journals and of the service, `files` that of files which devices need.

    `listen` is the address of the service.

    `peers` are the addresses of the services of other hosts by name. `up` are further options of `lfield up`.
    """

    host: str
    state: Path
    files: Path
    listen: str
    peers: Mapping[str, str]
    up: Sequence[str]
    as_json: bool = False


async def run_service(options: ServiceOptions, credentials: HostCredentials) -> int:
    """Run until a signal; then the mission's host is stopped too. Returns the exit status.

    Raises AddressError, KeysError, DamagedFileError, InputFileError.
    """
    clock, host = SystemClock(), options.host
    logbook = JsonLogbook(host, clock) if options.as_json else Logbook()
    store = BundleStore(options.state / "service")
    record = store.load()
    tls, admission = admission_for(credentials, host, clock, ())
    transport = HostTransport(TcpTransport(MAX_BLOCK, tls))
    result = options.state / "service" / "host.result"
    processes = LocalProcesses(host, store.path, options.up, result)
    runner = MissionRunner(record.run, processes, clock, logbook.note)
    probe = LocalProbe(
        host,
        options.state,
        lambda: runner.record.pid,
        lambda: vehicles_of(store.require(runner.record.bundle), host),
        clock,
    )
    verifier = BundleVerifier(host, credentials.keys, admission, options.files)
    service = Service(host, record, store, runner, probe, verifier, clock)
    transport.log_to(service.note)
    admission.serve(lambda: runner.is_running, lambda identity: {}, service.note)
    server = ServiceServer(host, service, transport, clock, random.Random(secrets.randbits(64)), admission)
    signals = ShutdownSignals(clock)
    install_signal_handlers(signals)
    # Before a request can arrive: a vote depends on the host that runs.
    service.adopt()
    address = await server.listen(options.listen)
    active = short_digest(service.activation.active) or "none"
    service.note(messages.LISTENING.line(host=host, address=address, bundle=active))
    tasks = [
        spawn(service.resolve(partial(ask_peer, transport, options.peers))),
        spawn(_reauthorise(server)),
    ]
    await signals.first_requested.wait()
    for task in tasks:
        task.cancel()
    signals.call_on_second(runner.terminate_again)
    await runner.stop("the service was stopped")
    server.close()
    return 0


async def ask_peer(
    transport: Transport, peers: Mapping[str, str], host: str, query: VoteQuery | ServiceQuery
) -> BallotState | ServiceStatus:
    """The answer of the service of another host. Raises LfieldError."""
    if host not in peers:
        raise AddressError(host, "the inventory of this robot does not have it")
    link = await open_service_link(transport, peers[host], host, None)
    try:
        if isinstance(query, VoteQuery):
            return await link.ask(query, BallotState, PEER_TIMEOUT)
        return await link.ask(query, ServiceStatus, PEER_TIMEOUT)
    finally:
        link.close()


async def _reauthorise(server: ServiceServer) -> None:
    while True:
        await asyncio.sleep(REAUTHORISE_EVERY)
        server.reauthorise()
