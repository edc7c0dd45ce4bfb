"""The battery of a vehicle: it drains by what the vehicle does, and its voltage sags under load."""

from __future__ import annotations

from dataclasses import dataclass

#: Amperes drawn: switched on, motors turning, flying.
IDLE_CURRENT, ARMED_CURRENT, FLYING_CURRENT = 0.5, 2.0, 18.0
FULL_VOLTS, EMPTY_VOLTS, RESISTANCE = 16.8, 13.2, 0.02


@dataclass(slots=True)
class Battery:
    """Four cells; `charge` is from 0 to 1, `capacity` in mAh, `current` in amperes."""

    charge: float = 1.0
    capacity: float = 3300.0
    current: float = IDLE_CURRENT

    @property
    def volts(self) -> float:
        """Voltage under the present load."""
        return EMPTY_VOLTS + (FULL_VOLTS - EMPTY_VOLTS) * self.charge - RESISTANCE * self.current

    @property
    def used(self) -> float:
        """Charge drawn since it was full, in mAh."""
        return (1.0 - self.charge) * self.capacity

    def step(self, dt: float, *, armed: bool, flying: bool) -> None:
        """Let `dt` seconds pass."""
        self.current = FLYING_CURRENT if flying else ARMED_CURRENT if armed else IDLE_CURRENT
        self.charge = max(0.0, self.charge - self.current * dt / (self.capacity * 3.6))
