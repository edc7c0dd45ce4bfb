"""Devices of the command line and of bindings, and their models."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from functools import partial
from pathlib import Path
from string import hexdigits
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from lfield.driver.binding import DeviceBinding, OptionValue
from lfield.errors import PluginError, UsageError
from lfield_sim.can.bus_world import BusDevice
from lfield_sim.can.can_bus import FaultLookup
from lfield_sim.can.can_motor import CanMotorData
from lfield_sim.can.cia402.cia402_device import Cia402Device
from lfield_sim.can.cia402.cia402_table import INCREMENTS
from lfield_sim.can.odrive.odrive_node import OdriveNode
from lfield_sim.faults import Faults

#: The last property of a DroneCAN node.
FUNCTIONS_OF_NODE = ",functions="
#: Device types of DroneCAN nodes, and the function of each.
_NODES = {"DroneCanBattery": "battery", "DroneCanEsc": "esc", "DroneCanServo": "servo"}
_MOTOR = set(CanMotorData.__struct_fields__) - {"brake"}


class DeviceSpec(Struct, frozen=True):
    """`KIND:PLACE[:NAME][,KEY=VALUE...]`: a node id or a DBC file, and the name of its binding."""

    kind: str
    place: str
    name: str
    options: Mapping[str, str]

    @property
    def id(self) -> str:
        """The name of the device in faults."""
        return Path(self.place).stem if self.kind == "dbc" else self.place


def parse(text: str) -> DeviceSpec:
    """Parses a device of the command line. Raises UsageError."""
    head, *pairs = text.split(",")
    kind, _, rest = head.partition(":")
    place, _, name = rest.partition(":")
    options = dict(pair.partition("=")[::2] for pair in pairs)
    if kind not in _KINDS or not place or not all(options.values()):
        raise UsageError(
            f"'{text}' is not a device; write cia402:NODE[:NAME], odrive:NODE[:NAME], "
            "dronecan:NODE[:NAME] or dbc:FILE[:NAME], with ,KEY=VALUE for other properties"
        )
    return DeviceSpec(kind, place, name, options)


def spec_of(binding: DeviceBinding) -> str:
    """The command-line text of a binding's device. Raises UsageError."""
    if binding.options.get("velocity_unit", "counts") != "counts":
        raise UsageError(f"{binding.name}: the simulated drive supports velocities in counts per second only")
    if binding.type == "CanSignals":
        text = f"dbc:{binding.option('dbc')}:{binding.name}"
        if commands := binding.options.get("commands"):
            text += f",commands={'+'.join(map(str, _listed(commands)))}"
        text += _supervised(binding)
    elif binding.type in _NODES:
        unique_id = binding.options.get("unique_id")
        text = f"dronecan:{binding.option('node')}:{binding.name}"
        text += f",uid={unique_id},dynamic=yes" if unique_id else ""
        text += f"{FUNCTIONS_OF_NODE}{_NODES[binding.type]}:{binding.option('index')}"
    else:
        text = f"{binding.option('protocol')}:{binding.option('node')}:{binding.name}"
        if counts := binding.options.get("counts"):
            text += f",counts={counts}"
    parse(text)
    return text


def merged(first: str, second: str) -> str:
    """The device of two texts with one id: of a DroneCAN node, with the functions of both."""
    if not first.startswith("dronecan:"):
        return first
    functions = second.partition(FUNCTIONS_OF_NODE)[2]
    return first if functions in first.partition(FUNCTIONS_OF_NODE)[2].split("+") else f"{first}+{functions}"


def _supervised(binding: DeviceBinding) -> str:
    """The counters, checksums and cycles of a binding, as properties of its simulated device."""
    texts = ""
    for option, key in (("counters", "counters"), ("checksums", "checksums"), ("cyclic", "cycles")):
        entries = []
        for entry in _listed(binding.options.get(option) or []):
            name, _, value = str(entry).partition("=")
            values = value.replace(",", " ").split()
            entries.append(":".join([name.strip(), *(["/".join(values)] if values else [])]))
        texts += f",{key}={'+'.join(entries)}" if entries else ""
    return texts


def _listed(value: OptionValue) -> Sequence[object]:
    return value if isinstance(value, list) else [str(value)]


def build(specs: Sequence[DeviceSpec], faults: Faults) -> list[BusDevice]:
    """Creates the models. Raises UsageError."""
    if len({spec.id for spec in specs}) < len(specs):
        raise UsageError("two devices have the same node id or name; give each its own")
    return [_KINDS[spec.kind](spec, partial(faults.get, device=spec.id)) for spec in specs]


def _drive(spec: DeviceSpec, flaw: FaultLookup) -> BusDevice:
    turn = round(number(spec, "counts")) if "counts" in spec.options else INCREMENTS
    motor = CanMotorData(brake=bool(_choice(spec, "brake", ("no", "yes"))))
    return Cia402Device(_node(spec, 1, 127), flaw, _motor(spec, motor, {"counts", "brake"}), turn)


def _node(spec: DeviceSpec, lowest: int, highest: int) -> int:
    if not spec.place.isdecimal() or not lowest <= int(spec.place) <= highest:
        raise UsageError(f"'{spec.place}' is not a node id of {spec.kind}; it is from {lowest} to {highest}")
    return int(spec.place)


def _motor(spec: DeviceSpec, data: CanMotorData, others: Set[str] = frozenset()) -> CanMotorData:
    """The motor with modified data, such as `load=0.5`; `others` are options that are not the motor's."""
    check_options(spec, _MOTOR | others)
    changed: dict[str, Any] = {key: number(spec, key) for key in _MOTOR & spec.options.keys()}
    return replace(data, **changed)


def check_options(spec: DeviceSpec, allowed: Set[str]) -> None:
    """Refuses an unknown option of a device. Raises UsageError."""
    for key in spec.options:
        if key not in allowed:
            raise UsageError(f"{spec.kind} has no '{key}'; it has: {', '.join(sorted(allowed))}")


def number(spec: DeviceSpec, key: str) -> float:
    """A positive number among the options (a load may be negative). Raises UsageError."""
    try:
        value = float(spec.options[key])
    except ValueError:
        value = float("nan")
    if not (1e-9 < value < 1e9 or (key == "load" and abs(value) < 1e9)):
        raise UsageError(f"{key} of {spec.kind} must be a number above 0, not '{spec.options[key]}'")
    return value


def _choice(spec: DeviceSpec, key: str, choices: Sequence[str]) -> int:
    """The index of an option's word, the first by default. Raises UsageError."""
    value = spec.options.get(key, choices[0])
    if value not in choices:
        raise UsageError(f"{key} of {spec.kind} must be one of {', '.join(choices)}, not '{value}'")
    return choices.index(value)


def _odrive(spec: DeviceSpec, flaw: FaultLookup) -> BusDevice:
    watchdog = number(spec, "watchdog") if "watchdog" in spec.options else 0.0
    data = _motor(spec, CanMotorData(), {"watchdog"})
    return OdriveNode(_node(spec, 0, 63), flaw, data, watchdog=watchdog)


def _dbc(spec: DeviceSpec, flaw: FaultLookup) -> BusDevice:
    try:
        from lfield_sim.can.dbc_device import DbcDevice, load
    except ImportError:
        raise PluginError("a device by DBC file needs cantools: pip install 'lfield[can]'") from None
    texts = ("node", "commands", "command", "status", "counters", "checksums", "cycles")
    check_options(spec, {*texts, "lag", "timeout"})
    data = load(spec.place, **{key: spec.options.get(key, "") for key in texts})
    times: dict[str, Any] = {key: number(spec, key) for key in ("lag", "timeout") if key in spec.options}
    return DbcDevice(spec.id, flaw, replace(data, **times))


def _dronecan(spec: DeviceSpec, flaw: FaultLookup) -> BusDevice:
    try:
        from lfield_sim.can.dronecan_functions import functions_of
        from lfield_sim.can.dronecan_node import DroneCanNode
    except ImportError:
        problem = "a simulated DroneCAN node needs dronecan"
        raise PluginError(f"{problem}: pip install 'lfield[dronecan]'") from None
    check_options(spec, {"functions", "uid", "dynamic"})
    uid = spec.options.get("uid", "")
    if not set(uid) <= set(hexdigits) or len(uid) not in (0, 32):
        raise UsageError("uid of dronecan has 32 hexadecimal digits")
    functions = functions_of(spec.options.get("functions", "servo:0"))
    is_dynamic = bool(_choice(spec, "dynamic", ("no", "yes")))
    return DroneCanNode(_node(spec, 1, 125), flaw, functions, bytes.fromhex(uid), is_dynamic=is_dynamic)


_KINDS: Mapping[str, Callable[[DeviceSpec, FaultLookup], BusDevice]] = {
    "cia402": _drive,
    "odrive": _odrive,
    "dbc": _dbc,
    "dronecan": _dronecan,
}
