"""Which devices are on the bus: what the command line and bindings say, and the models they mean."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from lfield.driver.binding import DeviceBinding, OptionValue
from lfield.errors import PluginError, UsageError
from lfield_sim.can.bus import Flaw
from lfield_sim.can.cia402.device import Cia402Device
from lfield_sim.can.cia402.table import INCREMENTS
from lfield_sim.can.motor import MotorData
from lfield_sim.can.odrive.node import OdriveNode
from lfield_sim.can.world import Device
from lfield_sim.faults import Faults

_MOTOR = {field.name for field in fields(MotorData)} - {"brake"}


@dataclass(frozen=True, slots=True)
class Spec:
    """`KIND:PLACE[:NAME][,KEY=VALUE...]`: a node id or a DBC file, and the name of its binding."""

    kind: str
    place: str
    name: str
    options: Mapping[str, str]

    @property
    def id(self) -> str:
        """What faults call it."""
        return Path(self.place).stem if self.kind == "dbc" else self.place


def parse(text: str) -> Spec:
    """A device as the command line has it. Raises UsageError."""
    head, *pairs = text.split(",")
    kind, _, rest = head.partition(":")
    place, _, name = rest.partition(":")
    options = dict(pair.partition("=")[::2] for pair in pairs)
    if kind not in _KINDS or not place or not all(options.values()):
        raise UsageError(
            f"'{text}' is no device; write cia402:NODE[:NAME], odrive:NODE[:NAME] or dbc:FILE[:NAME],"
            " with ,KEY=VALUE for what differs"
        )
    return Spec(kind, place, name, options)


def spec_of(binding: DeviceBinding) -> str:
    """The device that a binding means, for the command line. Raises UsageError."""
    if binding.options.get("velocity_unit", "counts") != "counts":
        raise UsageError(f"{binding.name}: the fake drive has velocities in counts per second only")
    if binding.type == "CanSignals":
        text = f"dbc:{binding.option('dbc')}:{binding.name}"
        if commands := binding.options.get("commands"):
            text += f",commands={'+'.join(map(str, _listed(commands)))}"
    else:
        text = f"{binding.option('protocol')}:{binding.option('node')}:{binding.name}"
        if counts := binding.options.get("counts"):
            text += f",counts={counts}"
    parse(text)
    return text


def _listed(value: OptionValue) -> list[int | str]:
    return value if isinstance(value, list) else [str(value)]


def build(specs: Sequence[Spec], faults: Faults) -> list[Device]:
    """The models. Raises UsageError."""
    if len({spec.id for spec in specs}) < len(specs):
        raise UsageError("two devices have the same node id or name; give each its own")
    return [_KINDS[spec.kind](spec, partial(faults.get, device=spec.id)) for spec in specs]


def _drive(spec: Spec, flaw: Flaw) -> Device:
    turn = round(number(spec, "counts")) if "counts" in spec.options else INCREMENTS
    motor = MotorData(brake=bool(_choice(spec, "brake", ("no", "yes"))))
    return Cia402Device(_node(spec, 1, 127), flaw, _motor(spec, motor, {"counts", "brake"}), turn)


def _node(spec: Spec, lowest: int, highest: int) -> int:
    if not spec.place.isdecimal() or not lowest <= int(spec.place) <= highest:
        raise UsageError(f"'{spec.place}' is no node id of {spec.kind}; it is from {lowest} to {highest}")
    return int(spec.place)


def _motor(spec: Spec, data: MotorData, others: Set[str] = frozenset()) -> MotorData:
    """The motor with what a device specifies otherwise: `load=0.5`; `others` are not the motor's."""
    check_options(spec, _MOTOR | others)
    changed: dict[str, Any] = {key: number(spec, key) for key in _MOTOR & spec.options.keys()}
    return replace(data, **changed)


def check_options(spec: Spec, known: Set[str]) -> None:
    """Refuse an option that a kind of device does not have. Raises UsageError."""
    for key in spec.options:
        if key not in known:
            raise UsageError(f"{spec.kind} has no '{key}'; it has: {', '.join(sorted(known))}")


def number(spec: Spec, key: str) -> float:
    """A positive number among the options (a load may be negative). Raises UsageError."""
    try:
        value = float(spec.options[key])
    except ValueError:
        value = float("nan")
    if not (1e-9 < value < 1e9 or (key == "load" and abs(value) < 1e9)):
        raise UsageError(f"{key} of {spec.kind} is a number above 0, not '{spec.options[key]}'")
    return value


def _choice(spec: Spec, key: str, words: Sequence[str]) -> int:
    """Which of some words an option is, the first where it is not given. Raises UsageError."""
    word = spec.options.get(key, words[0])
    if word not in words:
        raise UsageError(f"{key} of {spec.kind} is one of {', '.join(words)}, not '{word}'")
    return words.index(word)


def _odrive(spec: Spec, flaw: Flaw) -> Device:
    watchdog = number(spec, "watchdog") if "watchdog" in spec.options else 0.0
    data = _motor(spec, MotorData(), {"watchdog"})
    return OdriveNode(_node(spec, 0, 63), flaw, data, watchdog=watchdog)


def _dbc(spec: Spec, flaw: Flaw) -> Device:
    try:
        from lfield_sim.can.dbc import DbcDevice, load
    except ImportError:
        raise PluginError("a device by DBC file needs cantools: pip install 'lfield[can]'") from None
    texts = ("node", "commands", "command", "status")
    check_options(spec, {*texts, "lag", "timeout"})
    data = load(spec.place, **{key: spec.options.get(key, "") for key in texts})
    times: dict[str, Any] = {key: number(spec, key) for key in ("lag", "timeout") if key in spec.options}
    return DbcDevice(spec.id, flaw, replace(data, **times))


_KINDS: Mapping[str, Callable[[Spec, Flaw], Device]] = {"cia402": _drive, "odrive": _odrive, "dbc": _dbc}
