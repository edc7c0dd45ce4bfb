"""Lasting settings: what a device keeps when it is off, of which a binding needs some to be as it says.

Opening a device writes none of them, and neither does anything else that a mission does by itself: they are
the owner's. `lfield setup` writes them, after a yes, and keeps what was there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec


class Setting(msgspec.Struct, frozen=True):
    """One lasting setting that a binding needs: what it is, what it must be, and why, in a few words.

    Values are in the device's own units, as whoever looks it up in its manual expects them.
    """

    name: str
    present: float
    wanted: float
    why: str

    @property
    def is_right(self) -> bool:
        """Whether nothing is to be written; a device that keeps 32 bits of a real is as good as exact."""
        return same(self.present, self.wanted)

    def __str__(self) -> str:
        return f"{self.name} is {self.present:.9g} and must be {self.wanted:.9g}"


def same(one: float, other: float) -> bool:
    """Whether two values of a setting are the same to a device that keeps them in 32 bits."""
    return math.isclose(one, other, rel_tol=1e-6)


def wrong(settings: Sequence[Setting]) -> list[Setting]:
    """Those that are not as they must be."""
    return [setting for setting in settings if not setting.is_right]
