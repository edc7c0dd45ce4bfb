"""What a guard knows of one device, and how it treats its instructions: asking, acting, setpoints."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from lfield.driver.contract import RELEASE
from lfield.guard.messages import Call
from lfield.manifest import DeviceManifest, Instruction

Way = Literal["ask", "act", "setpoint"]


def way(instruction: Instruction) -> Way:
    """How the guard treats an instruction: asking moves nothing; a setpoint acts on after it returned."""
    if instruction.only_asks or instruction.name == RELEASE.name:
        return "ask"
    return "setpoint" if instruction.effect == "actuate" and not instruction.blocking else "act"


@dataclass(slots=True)
class KnownDevice:
    """What the guard knows of one device. `latched` is the reason, or '' when it is free.

    `barred` is why the program may not release it: somebody pressed the emergency stop.
    `told` is the last reason to be safe that a sensor has been given: it has nothing to do for it.
    `state` is the safe state that it is held in; '' for that of its binding.
    `making` says that its safe state is being commanded, `made_at` when that ended last.
    `acting` is what runs on each channel, `setpoints` are the times when the ones in effect are over.
    """

    name: str
    manifest: DeviceManifest
    ttl: float
    latched: str = ""
    state: str = ""
    barred: str = ""
    told: str = ""
    confirmed: bool = False
    moved: bool = False
    making: bool = False
    made_at: float = 0.0
    retry_at: float | None = None
    setpoints: dict[str, float] = field(default_factory=dict)
    acting: dict[str, Call] = field(default_factory=dict)
    asking: dict[int, Call] = field(default_factory=dict)

    def declared(self, call: Call) -> Instruction:
        """The instruction of a call that was let in."""
        instruction = self.manifest.instruction(call.instruction)
        assert instruction is not None, "an unknown instruction is refused before it gets here"
        return instruction

    def expiry(self) -> float | None:
        """When the first setpoint in effect is over. An actuation that runs replaces it, unless it fails."""
        if self.latched:
            return None
        times = [until for channel, until in self.setpoints.items() if channel not in self.acting]
        times += [
            call.sent + self.ttl for call in self.acting.values() if way(self.declared(call)) == "setpoint"
        ]
        return min(times, default=None)
