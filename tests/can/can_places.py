"""Endpoints of the fake as python-can wants them."""

from __future__ import annotations


def tcp(endpoint: str) -> dict[str, object]:
    """What python-can wants to know of a socketcand endpoint."""
    host, port = endpoint.removeprefix("socketcand:").removesuffix("/can0").split(":")
    return {"interface": "socketcand", "channel": "can0", "host": host, "port": int(port), "tcp_tune": True}


def serial(endpoint: str) -> dict[str, object]:
    """What python-can wants to know of an slcan endpoint."""
    return {"interface": "slcan", "channel": endpoint.removeprefix("slcan:"), "sleep_after_open": 0}
