"""Common server of simulated devices: readiness, fault injection at runtime, shutdown.

The fault-injection socket is a Unix socket in `lfield.driver.sims.control_folder()`. A request is one line of
JSON, `{"set": ["loss=0.1"]}` (an empty list only queries); the answer is one line, `{"faults": {...}}` or
`{"error": "..."}`, and includes kind, endpoint and devices.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import Callable, Mapping

from lfield.driver.sims import control_folder
from lfield.event_loop import ServedFake, SimulatedLoop, raise_timer_priority, read_until_end
from lfield_sim.faults import Faults
from lfield_sim.state_log import Facts

#: Longer requests are invalid.
MAX_REQUEST = 1 << 16


async def serve_until_stopped(
    kind: str,
    endpoint: str,
    summary: str,
    faults: Faults,
    *,
    devices: Mapping[str, str],
    until_stdin_closes: bool,
    facts: Mapping[str, Callable[[], Facts]] | None = None,
    places: Mapping[str, Callable[[], tuple[float, float, float]]] | None = None,
) -> None:
    """Prints `ready ENDPOINT WORDS` and waits for SIGTERM, SIGINT or, if requested, the end of stdin.

    `devices` are ids with the names of their bindings ('' without one). `facts` and `places` have the
    same ids: true values, and positions in metres north, east and up of a common point of all simulated
    devices. On a simulated computer nothing is printed, and the simulation stops the device.
    """
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    if isinstance(loop, SimulatedLoop):
        await loop.serve(ServedFake(kind, endpoint, faults, devices, facts or {}, places or {}))
        return
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    if until_stdin_closes:
        _stop_at_end_of_stdin(stop)
    identity = {"kind": kind, "endpoint": endpoint, "devices": dict(devices)}
    path = control_folder() / f"{kind}-{os.getpid()}.sock"
    path.unlink(missing_ok=True)
    server = await loop.create_unix_server(lambda: _FaultConnection(faults, identity), path)
    # Hardware responds in time on a busy computer too; guards have the higher priority.
    raise_timer_priority()
    print(f"ready {endpoint} {summary}".rstrip(), flush=True)
    try:
        await stop.wait()
    finally:
        server.close()
        path.unlink(missing_ok=True)


class _FaultConnection(asyncio.Protocol):
    """A fault-injection client."""

    def __init__(self, faults: Faults, identity: Mapping[str, object]) -> None:
        self._faults, self._identity = faults, identity
        self._request = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._request += data
        if b"\n" in self._request or len(self._request) > MAX_REQUEST:
            answer = self._answer(self._request.partition(b"\n")[0])
            self._transport.write(json.dumps({**self._identity, **answer}).encode() + b"\n")
            self._transport.close()

    def _answer(self, line: bytes) -> dict[str, object]:
        try:
            settings = json.loads(line)["set"]
            if not isinstance(settings, list) or not all(isinstance(text, str) for text in settings):
                raise TypeError
        except (ValueError, KeyError, TypeError, RecursionError):
            return {"error": 'a request is one line: {"set": ["NAME=VALUE"]}'}
        try:
            self._faults.apply(settings)
        except ValueError as error:
            return {"error": str(error)}
        return {"faults": self._faults.described()}


def _stop_at_end_of_stdin(stop: asyncio.Event) -> None:
    def on_data(data: bytes) -> None:
        if not data:
            stop.set()

    if sys.stdin is None:
        stop.set()
    else:
        read_until_end(sys.stdin.fileno(), on_data)
