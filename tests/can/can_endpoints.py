"""Endpoints of the fake in the form that python-can requires."""

from __future__ import annotations

import socket

import can
from can.interfaces.socketcand import SocketCanDaemonBus


def tcp(endpoint: str) -> dict[str, object]:
    """The arguments of python-can for a socketcand endpoint."""
    host, port = endpoint.removeprefix("socketcand:").removesuffix("/can0").split(":")
    return {"interface": "socketcand", "channel": "can0", "host": host, "port": int(port), "tcp_tune": True}


def serial(endpoint: str) -> dict[str, object]:
    """The arguments of python-can for an slcan endpoint."""
    return {"interface": "slcan", "channel": endpoint.removeprefix("slcan:"), "sleep_after_open": 0}


class _ExactBus(SocketCanDaemonBus):
    """Python-can's client, which otherwise refuses an answer that arrives together with the first frame."""

    def _expect_msg(self, msg: str) -> None:
        greeting = self._SocketCanDaemonBus__socket.recv(len(msg), socket.MSG_WAITALL).decode("ascii")
        if greeting != msg:
            raise can.CanError(f"expected '{msg}', not '{greeting}'")


def opened(place: dict[str, object], **options: object) -> can.BusABC:
    """Python-can's client at `tcp(...)` or `serial(...)`."""
    settings = {**place, **options}
    if settings.pop("interface") == "socketcand":
        return _ExactBus(**settings)
    return can.Bus(**place, **options)
