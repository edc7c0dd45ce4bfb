"""Faults of a vehicle and of its link: packets lost, broken, late, out of order."""

from __future__ import annotations

import math
import random

from lfield_sim.autopilot.equipment.camera import CARD
from lfield_sim.faults import Fault, Faults, share

#: The faults of the simulated device; each can be set for one vehicle by its system id.
LINK_FAULTS = (
    share("loss", "packets lost, both ways"),
    share("corrupt", "packets with a broken byte"),
    share("duplicate", "packets sent twice"),
    share("reorder", "packets sent after the next ones"),
    Fault("delay", 0.0, "seconds until a packet arrives", 0.0, 60.0),
    Fault("silence", False, "neither sends nor receives"),
    Fault("slow_acks", 0.0, "seconds of IN_PROGRESS before a command is acknowledged", 0.0, 600.0),
    Fault("refuse_arming", "", "a reason to refuse every arming"),
    Fault("gps_loss", False, "no GPS; in flight the position drifts, then it lands"),
    Fault("gps_glitch", 0.0, "error of its GPS in m, northwards", -1e4, 1e4),
    Fault("compass_failure", False, "no compass"),
    Fault("motor_failure", False, "a motor is dead"),
    Fault("motor_power", 1.0, "share of the power of one motor", 0.0, 1.0),
    Fault("sticks", False, "a pilot moves the sticks of a transmitter"),
    Fault("battery", 1.0, "charge, set once; it drains from there", 0.0, 1.0),
    Fault("card", CARD, "MiB on the card of the camera", 0.0, 1e6),
    Fault("camera_failure", False, "the camera stores no picture"),
    Fault("gimbal_secret", False, "the gimbal manager does not report which station controls it"),
    Fault("wind", 0.0, "m/s of steady wind", 0.0, 40.0),
    Fault("wind_from", 0.0, "direction that it comes from, rad clockwise from north", -math.tau, math.tau),
    Fault("gusts", 0.0, "m/s that gusts add at most", 0.0, 40.0),
    Fault("ground", 1.0, "share of its speed that the ground permits a rover", 0.1, 1.0),
    Fault("north", 0.0, "its position in m north of the common starting point", -1e4, 1e4),
    Fault("east", 0.0, "m east of it", -1e4, 1e4),
    Fault("warm_up", 0.0, "seconds after a start until it is healthy", 0.0, 600.0),
)
#: Delay of a reordered packet in seconds.
DELAY = 0.06
#: Delayed packets at most; then the oldest arrive.
UNDER_WAY = 10_000


def make_faults(*texts: str, systems: tuple[int, ...] = (1,)) -> Faults:
    """The faults of vehicles with these ids, some set from the start. Raises ValueError."""
    faults = Faults(LINK_FAULTS, [str(system) for system in systems])
    faults.apply(texts)
    return faults


class RadioLink:
    """The radio link of one vehicle. It has its own random numbers: the same in every run."""

    def __init__(self, faults: Faults, system: int) -> None:
        self._faults, self._system = faults, system
        self._random = random.Random(system)
        self._late: list[tuple[float, bytes]] = []

    @property
    def silent(self) -> bool:
        """Whether no packet is transmitted."""
        return bool(self._faults.get("silence", self._system))

    def receives(self) -> bool:
        """Whether a packet is received; a broken one is not."""
        return not (self.silent or self._happens("loss") or self._happens("corrupt"))

    def send(self, packets: list[bytes], now: float) -> list[bytes]:
        """Transmits packets; returns those that arrive at once; `arrived` returns the rest later."""
        if self.silent:
            return []
        passed = [self._broken(packet) for packet in packets if not self._happens("loss")]
        passed = [copy for packet in passed for copy in [packet] * (1 + self._happens("duplicate"))]
        delay = self._faults.get("delay", self._system)
        at_once = []
        for packet in passed:
            late = delay + (DELAY if self._happens("reorder") else 0.0)
            if late:
                self._late.append((now + late, packet))
            else:
                at_once.append(packet)
        return at_once

    def arrived(self, now: float) -> list[bytes]:
        """The delayed packets that arrive now."""
        if not self._late:
            return []
        surplus = len(self._late) - UNDER_WAY
        due = [p for n, (at, p) in enumerate(self._late) if at <= now or n < surplus]
        self._late = [entry for n, entry in enumerate(self._late) if entry[0] > now and n >= surplus]
        return [] if self.silent else due

    def _happens(self, fault: str) -> bool:
        chance: float = self._faults.get(fault, self._system)
        return chance > 0.0 and self._random.random() < chance

    def _broken(self, packet: bytes) -> bytes:
        if not self._happens("corrupt"):
            return packet
        position = self._random.randrange(len(packet))
        return (
            packet[:position]
            + bytes((packet[position] ^ 1 << self._random.randrange(8),))
            + packet[position + 1 :]
        )
