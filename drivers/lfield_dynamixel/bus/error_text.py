"""Texts for the error byte of a status packet and the hardware error register.

Protocol 2.0 has a number in the low seven bits and an alert in bit 7 ("look at the hardware error register");
protocol 1.0 has a bit for each error. Hardware Error Status: e-manual of the X series, address 70 (63 selects
those that switch the torque off). A Feetech servo (protocol 0) has its status as the error byte of every
answer, and does not report refusals: written values must be read back.
"""

from __future__ import annotations

from lfield_dynamixel.bus.packets import Status

ALERT = 0x80
#: Status bits with which a Feetech servo reduces its torque, or switches it off: heat, current, overload.
WEAKENING = 0b101100

_REFUSALS = {
    1: "it failed",
    2: "it does not support this instruction",
    3: "it received a damaged packet",
    4: "the value is out of range",
    5: "the value has the wrong length",
    6: "the value exceeds a limit that is set in the servo",
    7: "this cannot be accessed now",
}

_REFUSALS1 = {
    1: "the angle exceeds a limit that is set in the servo",
    3: "the value is out of range",
    4: "it received a damaged packet",
    6: "it does not support this instruction",
}

_FAULTS = {
    0: "input voltage out of limits",
    2: "overheating",
    3: "motor encoder failed",
    4: "electrical shock, or insufficient power for the motor",
    5: "overload",
}

_FAULTS1 = {0: _FAULTS[0], 2: _FAULTS[2], 5: _FAULTS[5]}
_FAULTS0 = {0: _FAULTS[0], 1: _FAULTS[3], 2: _FAULTS[2], 3: "current too high", 5: _FAULTS[5]}
_FAULTS_OF = {0: _FAULTS0, 1: _FAULTS1, 2: _FAULTS}


def _named(bits: int, names: dict[int, str]) -> list[str]:
    return [name for bit, name in names.items() if bits >> bit & 1]


def refusal_text(protocol: int, status: Status) -> str:
    """The reason why a servo refused a request; '' if it did not."""
    if protocol != 2:
        return ", ".join(_named(status.error, _REFUSALS1)) if protocol == 1 else ""
    number = status.error & ~ALERT
    return _REFUSALS.get(number, f"error {number}") if number else ""


def fault_text(protocol: int, bits: int) -> str:
    """The hardware errors in a register (or, protocols 0 and 1.0, in an error byte); '' for none."""
    return ", ".join(_named(bits, _FAULTS_OF[protocol]))


def has_alert(protocol: int, status: Status) -> bool:
    """Whether a status packet reports a hardware error."""
    return bool(status.error & ALERT) if protocol == 2 else bool(fault_text(protocol, status.error))
