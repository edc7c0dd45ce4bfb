"""Telemetry as a program reads it: a word that the host keeps up to date, and when it will be too old.

A query without parameters asks the host once. From then on the engine reads the word itself, which costs
hardly more than a variable. Whatever is not plain (too old, never reported, text, an array) still leaves the
engine. The host changes readings only between two runs of the engine: one run sees one state of the world.
"""

from __future__ import annotations

import math

from lfield.bytecode.program import BOOLEAN, INT, REAL

#: The kinds of values that are one word and need no room on a heap.
PLAIN = (BOOLEAN, INT, REAL)


class Reading:
    """One quantity of one device: `word` is valid while the host's monotonic clock is before `until`."""

    __slots__ = ("until", "word")

    def __init__(self) -> None:
        self.word, self.until = 0, -math.inf
