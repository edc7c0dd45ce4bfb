"""Control tables: addresses and units by model.

The data are in `tables/*.toml`, one file per family; every model names its page of the manual.
"""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

from msgspec import Struct


class Item(Struct, frozen=True):
    """One value of a control table.

    `sign` is '', 'signed' (two's complement), or the bit that is the sign of a magnitude: 'bit 10'.
    """

    address: int
    size: int
    sign: str = ""

    @property
    def _sign_bit(self) -> int:
        """The value of the sign bit; 0 for none, or two's complement."""
        return 1 << int(self.sign.removeprefix("bit ")) if self.sign.startswith("bit ") else 0

    def encode(self, counts: int) -> bytes:
        """The bytes of a value. Raises ValueError when it does not fit."""
        bit = self._sign_bit
        try:
            if bit and abs(counts) >= bit:
                raise OverflowError
            raw = -counts | bit if bit and counts < 0 else counts
            return raw.to_bytes(self.size, "little", signed=self.sign == "signed")
        except OverflowError:
            raise ValueError(f"{counts} does not fit into {self.size} bytes") from None

    def decode(self, data: bytes, start: int = 0) -> int:
        """The value in a range of the table that starts at the address `start`."""
        raw = data[self.address - start : self.address - start + self.size]
        value = int.from_bytes(raw, "little", signed=self.sign == "signed")
        bit = self._sign_bit
        return -(value & (bit - 1)) if value & bit else value


class Model(Struct, frozen=True):
    """A model with its control table. Units per count: rad, rad/s, rad/s2, A, V, s.

    `centre` is the position at 0 rad, `fastest` and `hardest` are the greatest velocity and acceleration of a
    profile, all in counts. `homing` is the sign with which the homing offset is added to the position,
    `answers` the status return level at which a servo answers everything, `modes` the values of the operating
    mode. `current` is 0.0 for a model without current measurement, `watchdog` for one without a watchdog.
    `stall` is the stall current in A and `torque` approximately N m per A, None if the manual has no figures.
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
    hardest: int
    voltage: float
    homing: int
    answers: int
    modes: dict[str, int]
    watchdog: float
    current: float
    stall: float | None
    torque: float | None

    @property
    def last(self) -> int:
        """The last position of a turn, in counts; the first is 0."""
        return 2 * self.centre - 1

    def homing_within(self, offset: int) -> int:
        """A homing offset within half a turn, for models with no more: an offset of a full turn is none."""
        if self.homing > 0:
            return offset
        half = self.centre
        return max((offset + half) % (2 * half) - half, 1 - half)

    def has_homing(self, offset: int) -> bool:
        """Whether a servo can have this homing offset."""
        if not self.has("homing_offset"):
            return offset == 0
        return self.homing > 0 or abs(offset) < self.centre

    def has(self, name: str) -> bool:
        """Whether the model has an item."""
        return name in self.items

    def to_counts(self, angle: float) -> int:
        """The position in counts of an angle in radians; 0 rad is the middle of the range."""
        return round(angle / self.position) + self.centre

    def to_angle(self, counts: int) -> float:
        """The angle in radians of a position in counts."""
        return (counts - self.centre) * self.position


def model_number_address(protocol: int) -> int:
    """The address of the model number, which all models of a protocol share."""
    return next(m.items["model_number"].address for m in models().values() if m.protocol == protocol)


@cache
def models() -> dict[tuple[int, int], Model]:
    """Every model in the tables, by protocol and model number."""
    models_by_number: dict[tuple[int, int], Model] = {}
    for file in sorted((files("lfield_dynamixel") / "tables").iterdir(), key=lambda file: file.name):
        table = tomllib.loads(file.read_text(encoding="utf-8"))
        for name, facts in table["models"].items():
            model = _model(name, facts, table)
            models_by_number[model.protocol, model.number] = model
    return models_by_number


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
        hardest=units.get("hardest", units["fastest"]),
        voltage=units["voltage"],
        homing=units.get("homing", 1),
        answers=units.get("answers", 2),
        modes=table.get("modes", {}),
        watchdog=units.get("watchdog", 0.0),
        current=current,
        stall=stall[1] if stall else None,
        torque=stall[0] / stall[1] if stall else None,
    )
