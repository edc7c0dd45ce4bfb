"""Fake copters, and device bindings of the agents that use them through a guard."""

from __future__ import annotations

from collections.abc import Iterable

from harness.checkout import Checkout
from harness.processes import Processes

#: Parameters that 'lfield setup' writes for these bindings, in a form that older fakes also accept.
SET_UP = ("FS_GCS_ENABLE=5", "FS_GCS_TIMEOUT=2", "GUID_TIMEOUT=1", "FS_OPTIONS=24")
_DEVICE = """\
  v%d:
    devices:
      fc:
        {driver: mavlink, endpoint: "udp:127.0.0.1:%s", system: %d, ttl: %g, safe_state: land,
         waivers: [device_watchdog]}
"""


def fake_copters(
    checkout: Checkout, processes: Processes, systems: Iterable[int] = (1,), *arguments: str
) -> str:
    """Start vehicles on one link; returns their port."""
    vehicles = [argument for system in systems for argument in ("--vehicle", str(system))]
    vehicles += [argument for setting in SET_UP for argument in ("--param", setting)]
    endpoint = checkout.fake(processes, "mavlink", "--listen", "udp:127.0.0.1:0", *vehicles, *arguments)
    return endpoint.rpartition(":")[2]


def bindings(copters: Iterable[tuple[str, int]], silence: float = 10.0, ttl: float = 0.5) -> str:
    """A devices file of agents v0, v1, ... for (port, system) pairs. The default silence permits pauses."""
    devices = [_DEVICE % (n, port, system, ttl) for n, (port, system) in enumerate(copters)]
    return f"silence: {silence}\nagents:\n" + "".join(devices)
