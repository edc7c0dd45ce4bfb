"""The contract of a driver as data: the instructions for L, and the contents of bindings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from lfield.driver.binding import OptionValue
from lfield.manifest import NEVER, DeviceManifest, DeviceValue, Instruction

#: Instructions of every device, implemented by the guard and the host.
RELEASE = Instruction(
    "release",
    effect="idempotent",
    blocking=True,
    meaning="takes the device out of its latched safe state, once that state is confirmed",
    channel="release",
    cancel=NEVER,
)
AGE = Instruction(
    "age", result="real", unit="s", effect="query", meaning="seconds since the last message from the device"
)
STANDARD_INSTRUCTIONS = (RELEASE, AGE)

#: Key in `Manifest.fakes` for all resource types that are not listed.
ANY = "any"

#: Words in the names of resource types and agents that are synonyms of a key of `Manifest.fakes`.
NAME_WORDS = {
    "Copter": ("drone", "uav", "multirotor", "quadrotor"),
    "Rover": ("truck", "ugv", "husky", "buggy", "tractor"),
}

#: The waiver that every device may have: it has no watchdog of its own, or one slower than required.
WATCHDOG = "device_watchdog"


@dataclass(frozen=True, slots=True)
class Option:
    """A key of a binding that is specific to this driver; `default` None means that it is required."""

    name: str
    type: str
    default: OptionValue | None = None
    choices: tuple[str, ...] = ()
    minimum: float = -math.inf
    maximum: float = math.inf
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Limit:
    """A limit that a binding may set; the driver refuses commands that exceed it."""

    name: str
    unit: str = ""
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Manifest:
    """A manifest file: the device type for L, and the permitted contents of its bindings.

    `fakes` are the options of a simulated device without a binding, by resource type of L or ANY. Waivers in
    `reasoned` require a reason. `geographic` devices report the position on the Earth of the origin of their
    own frame, as soon as it is known.
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
        """Whether any parameter or quantity refers to the team's frame."""
        parameters = (p for instruction in self.device.instructions for p in instruction.parameters)
        return any(q.frame for q in self.device.telemetry) or any(p.frame for p in parameters)

    def fake_options(self, resource: str, agent: str = "") -> dict[str, OptionValue]:
        """The default options of a simulated device without a binding, in a resource of this type.

        Options without a default are absent.
        """
        defaults = {option.name: option.default for option in self.options if option.default is not None}
        return {**defaults, **self.fakes.get(ANY, {}), **self.named_options(resource, agent)}

    def resource_options(self, resource: str) -> Mapping[str, OptionValue]:
        """The options that follow from the type of a resource: of `Rover` or `SurveyRover`, kind rover."""
        if resource in self.fakes:
            return self.fakes[resource]
        like = [key for key in self.fakes if key != ANY and key.lower() in resource.lower()]
        return self.fakes[like[0]] if len(like) == 1 else {}

    def named_options(self, resource: str, agent: str) -> Mapping[str, OptionValue]:
        """The options that the names of a resource type or of its agent suggest; the type has priority.

        A suggestion has a lower priority than `resource_options`: a binding may contradict it.
        """
        return self.resource_options(resource) or self._suggested(resource) or self._suggested(agent)

    def _suggested(self, name: str) -> Mapping[str, OptionValue]:
        lower = name.lower()
        like = [
            key
            for key in self.fakes
            if key != ANY and any(part in lower for part in (key.lower(), *NAME_WORDS.get(key, ())))
        ]
        return self.fakes[like[0]] if len(like) == 1 else {}

    def undecided_options(self, resource: str, agent: str) -> list[Option]:
        """The options that the resource type should determine, if neither the type nor the agent's id
        determines them.
        """
        if ANY in self.fakes or self.named_options(resource, agent):
            return []
        chosen = {key for options in self.fakes.values() for key in options}
        return [option for option in self.options if option.name in chosen]

    def fake_label(self, resource: str, agent: str = "") -> str:
        """Describes the simulated device of a resource without a binding; '' when there is only one kind."""
        chosen = {key for options in self.fakes.values() for key in options}
        values = self.fake_options(resource, agent)
        kinds = ", ".join(f"{o.name} {values[o.name]}" for o in self.options if o.name in chosen)
        if not kinds:
            return ""
        guessed = self.undecided_options(resource, agent)
        prefix = f"the kind of a {resource} is not known, so it is " if guessed else ""
        return f"{prefix}simulated with {kinds}"

    @property
    def default_safe_state(self) -> str:
        """The first safe state of the manifest; '' for a pure sensor."""
        return next(iter(self.device.safe_states), "")


class Reports(Protocol):
    """Callbacks from a driver to the guard."""

    def publish(self, device: str, values: Mapping[str, DeviceValue]) -> None:
        """Publishes current values of telemetry quantities."""

    def heard(self, device: str) -> None:
        """Records that the device has sent a message."""

    def note(self, device: str, text: str) -> None:
        """Writes one sentence into the log of the host."""

    def breach(self, device: str, reason: str) -> None:
        """Reports that the device exceeds a limit and cannot be corrected: this device is made safe."""

    def lock_out(self, device: str, reason: str) -> None:
        """Reports that the device must be inspected: it is made safe until an operator clears the
        lock-out.
        """

    def crashed(self, reason: str | BaseException) -> None:
        """Reports a failure of the driver itself: every device is made safe."""
