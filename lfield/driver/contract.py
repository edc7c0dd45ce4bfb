"""The contract of a driver as data: what L may call and bindings may say. `manifest_file` reads it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from lfield.driver.binding import OptionValue
from lfield.manifest import NEVER, DeviceManifest, DeviceValue, Instruction

#: What every device can do; the guard and the host answer them.
RELEASE = Instruction(
    "release",
    effect="idempotent",
    blocking=True,
    meaning="takes the device out of its latched safe state, once that state is confirmed",
    channel="release",
    cancel=NEVER,
)
AGE = Instruction(
    "age", result="real", unit="s", effect="query", meaning="seconds since the device was last heard"
)
STANDARD = (RELEASE, AGE)

#: In `Manifest.fakes`: of every resource type that is not named there.
ANY = "any"

#: The waiver that every device knows: it has no watchdog of its own, or a slower one than is wanted.
WATCHDOG = "device_watchdog"


@dataclass(frozen=True, slots=True)
class Option:
    """A key of a binding that only this driver knows; `default` None means that it must be given."""

    name: str
    type: str
    default: OptionValue | None = None
    choices: tuple[str, ...] = ()
    minimum: float = -math.inf
    maximum: float = math.inf
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Limit:
    """A limit that a binding may set; the driver refuses what would exceed it."""

    name: str
    unit: str = ""
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Manifest:
    """A manifest file: the device type for L, and what its bindings may say.

    `fakes` are the options, by resource type of L or ANY, of a device that is simulated and bound nowhere.
    `reasoned` waivers count only with a reason. `geographic` devices tell where on the Earth their own frame
    begins, once they know it.
    """

    device: DeviceManifest
    options: tuple[Option, ...] = ()
    limits: tuple[Limit, ...] = ()
    waivers: tuple[tuple[str, str], ...] = ()
    fakes: Mapping[str, Mapping[str, OptionValue]] = field(default_factory=dict)
    geographic: bool = False
    reasoned: tuple[str, ...] = ()

    @property
    def has_places(self) -> bool:
        """Whether anything that it is told or tells is about the team's frame."""
        parameters = (p for instruction in self.device.instructions for p in instruction.parameters)
        return any(q.frame for q in self.device.telemetry) or any(p.frame for p in parameters)

    def fake_options(self, resource: str) -> dict[str, OptionValue]:
        """The options of a device on a fake that nobody has bound, in a resource of this type.

        An option is not among them that only a binding can know.
        """
        defaults = {option.name: option.default for option in self.options if option.default is not None}
        return {**defaults, **self.fakes.get(ANY, {}), **self.fakes.get(resource, {})}

    def fake_words(self, resource: str) -> str:
        """What a fake that nobody has bound is in such a resource, '' where there is nothing to choose."""
        chosen = {key for options in self.fakes.values() for key in options}
        given = self.fake_options(resource)
        words = ", ".join(f"{o.name} {given[o.name]}" for o in self.options if o.name in chosen)
        if not words:
            return ""
        guessed = ANY not in self.fakes and resource not in self.fakes
        why = f"nothing tells what a {resource} is, so it is " if guessed else ""
        return f"{why}simulated with {words}"

    @property
    def default_safe_state(self) -> str:
        """The first that the manifest lists; '' for a pure sensor."""
        return next(iter(self.device.safe_states), "")


class Reports(Protocol):
    """What a driver can tell the guard."""

    def publish(self, device: str, values: Mapping[str, DeviceValue]) -> None:
        """New values of telemetry quantities, true now."""

    def heard(self, device: str) -> None:
        """The device has just shown that it is alive."""

    def note(self, device: str, text: str) -> None:
        """One sentence for the log of the host."""

    def breach(self, device: str, reason: str) -> None:
        """The device is beyond a limit of its binding and cannot be corrected: it alone goes safe."""

    def lock_out(self, device: str, reason: str) -> None:
        """The device must be inspected: it alone goes safe, until an operator ends that."""

    def crashed(self, reason: str | BaseException) -> None:
        """Something in the driver has broken, or this was raised in it: every device goes safe."""
