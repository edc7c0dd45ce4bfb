"""Addresses of loopback on which no other process of a test run listens, calls or locks anything."""

from __future__ import annotations

import os


def own_address() -> str:
    """The address of this process, whose number is in it.

    Locks of endpoints are seen by the whole computer, and a port of 127.0.0.1 that was just found to be free
    may be given to another process before it is used.
    """
    number = os.getpid()
    return f"127.{1 + (number >> 16) % 254}.{number >> 8 & 255}.{number & 255}"
