"""What the error byte of an answer and the hardware error register say, in words.

Protocol 2.0 has a number in the low seven bits and an alert in bit 7 ("look at the hardware error register");
protocol 1.0 has a bit for each error. Hardware Error Status: e-manual of the X series, address 70 (63 says
which of them switch the torque off).
"""

from __future__ import annotations

from lfield_dynamixel.bus.packets import Status

ALERT = 0x80

_REFUSALS = {
    1: "it failed to do it",
    2: "it does not know this instruction",
    3: "the packet reached it damaged",
    4: "the value is out of its range",
    5: "the value has the wrong length",
    6: "the value is beyond a limit that is set in it",
    7: "this cannot be read or written now",
}

_REFUSALS1 = {
    1: "the angle is beyond a limit that is set in it",
    3: "the value is out of its range",
    4: "the packet reached it damaged",
    6: "it does not know this instruction",
}

_FAULTS = {
    0: "input voltage out of its limits",
    2: "overheating",
    3: "motor encoder failed",
    4: "electrical shock, or too little power for the motor",
    5: "overload",
}

_FAULTS1 = {0: _FAULTS[0], 2: _FAULTS[2], 5: _FAULTS[5]}


def _named(bits: int, names: dict[int, str]) -> list[str]:
    return [name for bit, name in names.items() if bits >> bit & 1]


def refusal(protocol: int, status: Status) -> str:
    """Why a servo did not do what it was told; '' when it did."""
    if protocol == 1:
        return ", ".join(_named(status.error, _REFUSALS1))
    number = status.error & ~ALERT
    return _REFUSALS.get(number, f"error {number}") if number else ""


def faults(protocol: int, bits: int) -> str:
    """The hardware errors in a register (or, protocol 1.0, in an error byte); '' for none."""
    known = _FAULTS1 if protocol == 1 else _FAULTS
    return ", ".join(_named(bits, known))


def alerted(protocol: int, status: Status) -> bool:
    """Whether an answer says that something is wrong with the hardware."""
    return bool(faults(1, status.error)) if protocol == 1 else bool(status.error & ALERT)
