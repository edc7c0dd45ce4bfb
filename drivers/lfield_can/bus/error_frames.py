"""Error frames of CAN interfaces: their cause in words, and the state of the controller. Pure.

Linux (linux/can/error.h): socketcan, socketcand, gs_usb. PCAN-Basic reports the type of error in the id. An
slcan adapter has no error frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

#: States of a controller (ISO 11898-1), and none.
ACTIVE, WARNING, PASSIVE, OFF, UNKNOWN = "error active", "error warning", "error passive", "bus off", ""

#: Error classes in the id of an error frame, and their meaning.
CLASSES: Mapping[int, str] = {
    0x001: "no answer before the timeout",
    0x002: "lost arbitration",
    0x004: "controller problem",
    0x008: "protocol violation",
    0x010: "transceiver problem",
    0x020: "no acknowledgement of a frame",
    0x040: OFF,
    0x080: "bus error",
    0x100: "controller restarted",
}
CONTROLLER_CLASS, PROTOCOL_CLASS, TRANSCEIVER_CLASS, OFF_CLASS = 0x004, 0x008, 0x010, 0x040
#: Classes of events on the wire: a later bus off has this cause.
_WIRE = 0x0BA
#: The frame has counters of errors in bytes 6 (send) and 7 (receive).
_COUNTERS, _RESTARTED = 0x200, 0x100

#: Bits of byte 1: the controller, with its state.
CONTROLLER: Mapping[int, tuple[str, str]] = {
    0x01: ("receive buffer full", UNKNOWN),
    0x02: ("send buffer full", UNKNOWN),
    0x04: ("many receive errors", WARNING),
    0x08: ("many send errors", WARNING),
    0x10: ("error passive by receive errors", PASSIVE),
    0x20: ("error passive by send errors", PASSIVE),
    0x40: ("error active again", ACTIVE),
}
#: Bits of byte 2, and values of byte 3: the violation and its place.
VIOLATIONS: Mapping[int, str] = {
    0x01: "single bit",
    0x02: "form",
    0x04: "bit stuffing",
    0x08: "no dominant bit",
    0x10: "no recessive bit",
    0x20: "overload",
    0x80: "while sending",
}
PLACES: Mapping[int, str] = {
    **{0x02: "identifier", 0x06: "identifier", 0x07: "identifier", 0x0F: "identifier", 0x0E: "identifier"},
    **{0x03: "start of frame", 0x0B: "length", 0x0A: "data", 0x08: "CRC", 0x18: "CRC delimiter"},
    **{0x19: "acknowledgement", 0x1B: "acknowledgement delimiter", 0x1A: "end of frame", 0x12: "pause"},
}
#: Values of byte 4.
TRANSCEIVER: Mapping[int, str] = {
    **{0x04: "CAN-H has no wire", 0x05: "CAN-H shorted to battery", 0x06: "CAN-H shorted to supply"},
    **{0x07: "CAN-H shorted to ground", 0x40: "CAN-L has no wire", 0x50: "CAN-L shorted to battery"},
    **{0x60: "CAN-L shorted to supply", 0x70: "CAN-L shorted to ground", 0x80: "CAN-L shorted to CAN-H"},
}
#: Types of errors of PCAN-Basic, in the id.
_PCAN_TYPES: Mapping[int, str] = {1: "single bit", 2: "form", 4: "bit stuffing", 8: "another error"}

#: Advice on what to check, by a part of the text.
_ADVICE: Mapping[str, str] = {
    "acknowledgement": "check that another node is on and has the same bit rate",
    "shorted": "check the wires",
    "no wire": "check the wires",
    "buffer full": "send fewer frames, or use a higher bit rate",
    "violation": "check terminators, wires, and the bit rate of every node",
    "bus error": "check terminators, wires, and the bit rate of every node",
}


class ErrorReport(NamedTuple):
    """An error frame: its text, the new state of the controller ('' if it does not say), and whether it names
    a cause on the wire.
    """

    text: str
    state: str = UNKNOWN
    has_cause: bool = False


def linux_error(identifier: int, data: bytes) -> ErrorReport:
    """An error frame of Linux, such as `controller problem (send buffer full)`."""
    data = data.ljust(8, b"\0")
    details = {
        CONTROLLER_CLASS: [text for bit, (text, _) in CONTROLLER.items() if data[1] & bit],
        PROTOCOL_CLASS: [text for bit, text in VIOLATIONS.items() if data[2] & bit],
        TRANSCEIVER_CLASS: [TRANSCEIVER[data[4]]] if data[4] in TRANSCEIVER else [],
    }
    if data[3] in PLACES:
        details[PROTOCOL_CLASS].append(f"in the {PLACES[data[3]]}")
    parts = []
    for bit, meaning in CLASSES.items():
        if identifier & bit:
            detail = ", ".join(details.get(bit, ()))
            parts.append(f"{meaning} ({detail})" if detail else meaning)
    text = ", ".join(parts) or "an error of unknown class"
    if identifier & _COUNTERS or any(data[6:8]):
        text += f"; errors counted: {data[6]} sending, {data[7]} receiving"
    return ErrorReport(text, _state(identifier, data[1]), bool(identifier & _WIRE))


def _state(identifier: int, controller: int) -> str:
    if identifier & OFF_CLASS:
        return OFF
    if identifier & _RESTARTED:
        return ACTIVE
    states = [state for bit, (_, state) in CONTROLLER.items() if state and controller & bit]
    return states[-1] if identifier & CONTROLLER_CLASS and states else UNKNOWN


def pcan_error(identifier: int, data: bytes) -> ErrorReport:
    """An error frame of PCAN-Basic: type, direction, place, and counters of receive and send errors."""
    data = data.ljust(4, b"\0")
    kind = ", ".join(text for bit, text in _PCAN_TYPES.items() if identifier & bit) or "an unknown type"
    place = f", in the {PLACES[data[1] & 0x1F]}" if data[1] & 0x1F in PLACES else ""
    direction = "receiving" if data[0] else "sending"
    text = f"protocol violation ({kind} while {direction}{place})"
    state = PASSIVE if max(data[2], data[3]) >= 128 else WARNING if max(data[2], data[3]) >= 96 else ACTIVE
    return ErrorReport(f"{text}; errors counted: {data[3]} sending, {data[2]} receiving", state, True)


#: By the interface of python-can; others report as Linux does, or only that there was an error.
DIALECTS: Mapping[str, Callable[[int, bytes], ErrorReport]] = {"pcan": pcan_error}


def advice(text: str) -> str:
    """Advice on what to check, as the end of a sentence; '' if unknown."""
    return next((f"; {hint}" for part, hint in _ADVICE.items() if part in text), "")
