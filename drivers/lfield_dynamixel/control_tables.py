"""Control tables: addresses and units by model.

The data are in `tables/*.toml`, one file per family; every model names its page of the manual.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

#: The direction bit of a sign-magnitude value (protocol 1.0).
_DIRECTION = 1 << 10


@dataclass(frozen=True, slots=True)
class Item:
    """One value of a control table; `sign` is '', 'signed' or 'direction'."""

    address: int
    size: int
    sign: str = ""

    def encode(self, counts: int) -> bytes:
        """The bytes of a value. Raises ValueError when it does not fit."""
        try:
            return counts.to_bytes(self.size, "little", signed=self.sign == "signed")
        except OverflowError:
            raise ValueError(f"{counts} does not fit into {self.size} bytes") from None

    def decode(self, data: bytes, start: int = 0) -> int:
        """The value in a range of the table that starts at the address `start`."""
        raw = data[self.address - start : self.address - start + self.size]
        value = int.from_bytes(raw, "little", signed=self.sign == "signed")
        if self.sign == "direction" and value & _DIRECTION:
            return -(value & (_DIRECTION - 1))
        return value


@dataclass(frozen=True, slots=True)
class Model:
    """A model with its control table. Units per count: rad, rad/s, rad/s2, A, V, s.

    `centre` is the position at 0 rad, `fastest` the greatest velocity of a profile, both in counts. `current`
    is 0.0 for a model without current measurement, `watchdog` for one without a watchdog; `torque` is
    approximately N m per A, or None if the manual has no figures.
    """

    name: str
    number: int
    manual: str
    protocol: int
    ram: int
    state: tuple[int, int]
    present: tuple[int, int]
    items: dict[str, Item]
    position: float
    centre: int
    velocity: float
    fastest: int
    acceleration: float
    voltage: float
    watchdog: float
    current: float
    torque: float | None

    def has(self, name: str) -> bool:
        """Whether the model has an item."""
        return name in self.items

    def to_counts(self, angle: float) -> int:
        """The position in counts of an angle in radians; 0 rad is the middle of the range."""
        return round(angle / self.position) + self.centre

    def to_angle(self, counts: int) -> float:
        """The angle in radians of a position in counts."""
        return (counts - self.centre) * self.position


@cache
def models() -> dict[tuple[int, int], Model]:
    """Every model in the tables, by protocol and model number."""
    found: dict[tuple[int, int], Model] = {}
    for file in sorted((files("lfield_dynamixel") / "tables").iterdir(), key=lambda file: file.name):
        table = tomllib.loads(file.read_text(encoding="utf-8"))
        for name, facts in table["models"].items():
            model = _model(name, facts, table)
            found[model.protocol, model.number] = model
    return found


def _model(name: str, facts: dict[str, Any], table: dict[str, Any]) -> Model:
    units, current = table["units"], facts.get("current", 0.0)
    items = {key: Item(*value) for key, value in table["items"].items()}
    if not current:
        items = {key: item for key, item in items.items() if "current" not in key}
    stall = facts.get("stall")
    return Model(
        name=name,
        number=facts["number"],
        manual=facts["manual"],
        protocol=table["protocol"],
        ram=table["ram"],
        state=tuple(table["state"]),
        present=tuple(table["present"]),
        items=items,
        position=units["position"],
        centre=units["centre"],
        velocity=units["velocity"],
        fastest=units["fastest"],
        acceleration=units.get("acceleration", 0.0),
        voltage=units["voltage"],
        watchdog=units.get("watchdog", 0.0),
        current=current,
        torque=stall[0] / stall[1] if stall else None,
    )
