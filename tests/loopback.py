"""Loopback addresses that no other process of a test run uses."""

from __future__ import annotations

import os


def own_address() -> str:
    """The address of this process, derived from its number.

    Locks of endpoints apply to the whole computer, and a port of 127.0.0.1 that was just found to be free
    may be given to another process before it is used.
    """
    number = os.getpid()
    return f"127.{1 + (number >> 16) % 254}.{number >> 8 & 255}.{number & 255}"
