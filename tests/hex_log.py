"""Reads the lines of a wire log in hexadecimal text."""

from __future__ import annotations


def parse_hex_line(line: str) -> tuple[float, bool, bytes]:
    """The time in seconds, whether the bytes were sent, and the bytes of a line."""
    time, direction, data = line.removesuffix("\n").split(" ", 2)
    assert direction in "<>"
    return float(time), direction == ">", bytes.fromhex(data)
