"""What the core of a guard asks of its shell: the effects of `GuardCore`, in their order."""

from __future__ import annotations

from dataclasses import dataclass

from lfield.guard.messages import Call, Message


@dataclass(frozen=True, slots=True)
class Execute:
    """Effect: have the driver carry out a call."""

    call: Call


@dataclass(frozen=True, slots=True)
class Interrupt:
    """Effect: stop carrying out the call of this token; what its driver makes of it interests nobody."""

    token: int


@dataclass(frozen=True, slots=True)
class MakeSafe:
    """Effect: have the driver bring a device into a safe state ('': its binding's), before anything else."""

    device: str
    state: str = ""


@dataclass(frozen=True, slots=True)
class LeaveOff:
    """Effect: the device is released; do not go on bringing it into its safe state."""

    device: str


@dataclass(frozen=True, slots=True)
class Look:
    """Effect: ask the driver what the device still does in its safe state; `looked` gets the answer."""

    device: str


@dataclass(frozen=True, slots=True)
class Quiet:
    """Effect: send nothing that feeds a device's own watchdog from now on (False: do again)."""

    on: bool


@dataclass(frozen=True, slots=True)
class Tell:
    """Effect: send a message to the host."""

    message: Message


@dataclass(frozen=True, slots=True)
class Exit:
    """Effect: close the bus and end the process with this status."""

    status: int


Effect = Execute | Interrupt | MakeSafe | LeaveOff | Look | Quiet | Tell | Exit
