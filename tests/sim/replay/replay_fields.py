"""Fields that clients act on: values of the fake that the recording never has.

A field is compared as the set of its values in a recording, for each mode where it depends on the mode: the
times of its changes are those of the mode or the state, which are compared by time. Message types that only
one of the two sends are reported here, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from replay_player import IDS
from replay_table import Difference
from replay_trace import Line, Trace

#: Armed is compared by time.
ARMED = 0x80
#: Of SYS_STATUS: gyro, accelerometer, compass, barometer, GPS, and the logic of fences.
SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x100000


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a message: its readable name, and its compared value."""

    message: str
    name: str
    value: Callable[[Line], object] | None = None

    def of(self, line: Line) -> object:
        """The compared value in a message."""
        return self.value(line) if self.value else line.fields.get(self.name)


def _hexadecimal(name: str) -> Callable[[Line], str]:
    return lambda line: f"{int(line.get(name)):#x}"


def _sensors(name: str) -> Callable[[Line], str]:
    return lambda line: f"{int(line.get(name)) & SENSORS:#x}"


FIELDS = (
    Field("HEARTBEAT", "type"),
    Field("HEARTBEAT", "autopilot"),
    Field("HEARTBEAT", "mavlink_version"),
    Field("AUTOPILOT_VERSION", "capabilities", _hexadecimal("capabilities")),
    Field("AUTOPILOT_VERSION", "flight_sw_version", _hexadecimal("flight_sw_version")),
    Field("COMMAND_ACK", "target_system"),
    Field("COMMAND_ACK", "target_component"),
    Field("COMMAND_ACK", "progress"),
    Field("EXTENDED_SYS_STATE", "vtol_state"),
    Field("BATTERY_STATUS", "id"),
    Field("BATTERY_STATUS", "battery_function"),
    Field("BATTERY_STATUS", "type"),
    Field("BATTERY_STATUS", "charge_state"),
    Field("BATTERY_STATUS", "fault_bitmask"),
    Field("FENCE_STATUS", "breach_type"),
    Field("FENCE_STATUS", "breach_mitigation"),
    Field("MISSION_CURRENT", "mission_mode"),
    Field("SYS_STATUS", "sensors present", _sensors("onboard_control_sensors_present")),
    Field("SYS_STATUS", "sensors enabled", _sensors("onboard_control_sensors_enabled")),
    Field("SYS_STATUS", "sensors healthy", _sensors("onboard_control_sensors_health")),
)
#: Fields that depend on the mode, with the field of the mode.
OF_MODES = (
    (Field("HEARTBEAT", "base_mode", lambda line: int(line.get("base_mode")) & ~ARMED), "custom_mode"),
    (Field("CURRENT_MODE", "standard_mode"), "custom_mode"),
)
#: Messages that are compared elsewhere, or that only answer an input.
ELSEWHERE = frozenset({"COMMAND_ACK", "STATUSTEXT", "FILE_TRANSFER_PROTOCOL", "LOG_ENTRY", "AVAILABLE_MODES"})


def fields(real: Trace, fake: Trace, mode_name: Callable[[object], str]) -> Iterator[Difference]:
    """All differences of one recording, in no order."""
    for each in FIELDS:
        yield from _compare(
            f"{each.message}.{each.name}", real.out(each.message), fake.out(each.message), each
        )
    for each, mode in OF_MODES:
        real_values, simulated_values = real.out(each.message), fake.out(each.message)
        for number in sorted({line.fields[mode] for line in [*real_values, *simulated_values]}):
            a, b = (
                [line for line in lines if line.fields[mode] == number]
                for lines in (real_values, simulated_values)
            )
            yield from _compare(f"{each.message}.{each.name} in {mode_name(number)}", a, b, each)


def _compare(what: str, real: list[Line], fake: list[Line], field: Field) -> Iterator[Difference]:
    real_values, simulated_values = ({field.of(line) for line in lines} for lines in (real, fake))
    if real_values and simulated_values - real_values:
        yield Difference(f"{what}: {_list(real_values)} / {_list(simulated_values)}")


def _list(values: set[object]) -> str:
    return ", ".join(sorted(map(str, values)))


def messages(real: Trace, counts: dict[str, list[float]]) -> Iterator[Difference]:
    """The message types that are sent at all; the recorder counted each type."""
    if "seen" not in real.header:
        return
    kinds = {kind for kind, count in real.header["seen"].items() if count}
    sent = {kind for kind, times in counts.items() if times}
    known = set(IDS.values())
    for kind in sorted((kinds & known) - sent - ELSEWHERE):
        yield Difference(f"message missing: {kind}")
    for kind in sorted(sent - kinds - ELSEWHERE):
        yield Difference(f"message too many: {kind}")
