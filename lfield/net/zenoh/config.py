"""Zenoh configuration of this process, as the inventory states it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import msgspec
from msgspec.structs import asdict

#: The environment variable in which a service passes the section to its host: other users of the computer
#: read command lines, and the section may have a password.
SECTION_VARIABLE = "LFIELD_ZENOH_SECTION"


class ZenohConfig(msgspec.Struct, frozen=True):
    """The section `zenoh` of an inventory.

    `connect` are endpoints of routers or peers in Zenoh's syntax (tcp/10.0.0.1:7447), `listen` the endpoints
    at which this process accepts peers. With `listen`, `multicast` or `gossip` it is a peer, otherwise a
    client of a router. `settings` are further settings of Zenoh by path, with JSON values.
    """

    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    multicast: bool = False
    gossip: bool = False
    settings: tuple[tuple[str, str], ...] = ()

    @property
    def mode(self) -> str:
        """Zenoh's mode of a session."""
        return "peer" if self.listen or self.multicast or self.gossip else "client"

    def options(self) -> dict[str, str]:
        """All settings by path, as JSON values."""
        own: dict[str, Any] = {
            "mode": self.mode,
            "connect/endpoints": self.connect,
            "listen/endpoints": self.listen,
            "scouting/multicast/enabled": self.multicast,
            "scouting/gossip/enabled": self.gossip,
            # An outage of a router must end sooner than the silence that ends a link.
            "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
            # The time in microseconds for which the thread waits for space in the queue of the session. After
            # it the packet is dropped, and its stream repeats it.
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 50_000,
        }
        return {key: json.dumps(value) for key, value in own.items()} | dict(self.settings)

    def encode(self) -> str:
        """The configuration as one text, for another process of this computer."""
        return json.dumps(asdict(self))


def decode_config(text: str) -> ZenohConfig:
    """The inverse of `ZenohConfig.encode`. Raises ValueError."""
    return msgspec.json.decode(text, type=ZenohConfig)


class ZenohNetwork:
    """The configuration of this process. The command that reads the inventory sets it."""

    def __init__(self) -> None:
        self.config: ZenohConfig | None = None
        self._by_host: Mapping[str, ZenohConfig] = {}

    def configure(self, config: ZenohConfig | None, by_host: Mapping[str, ZenohConfig] = {}) -> None:
        """Use a configuration for sessions that are opened from now on; None without the section."""
        self.config, self._by_host = config, dict(by_host)

    def select(self, host: str, encoded: str = "") -> None:
        """Use the section of the host of this process, if it has one, otherwise the section that its service
        passes on.

        Raises ValueError.
        """
        self.config = decode_config(encoded) if encoded else self._by_host.get(host, self.config)


#: The network of this process, which has only one, as it has one routing table.
NETWORK = ZenohNetwork()
