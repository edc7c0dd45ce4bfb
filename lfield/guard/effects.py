"""Effects of `GuardCore`, carried out by its shell in order."""

from __future__ import annotations

from dataclasses import dataclass

from lfield.guard.messages import GuardCall, GuardMessage


@dataclass(frozen=True, slots=True)
class Execute:
    """Effect: the driver executes a call."""

    call: GuardCall


@dataclass(frozen=True, slots=True)
class Interrupt:
    """Effect: stop executing the call of this token; the driver's result is discarded."""

    token: int


@dataclass(frozen=True, slots=True)
class MakeSafe:
    """Effect: the driver brings a device into a safe state ('': that of its binding), before anything
    else.
    """

    device: str
    state: str = ""


@dataclass(frozen=True, slots=True)
class Abandon:
    """Effect: the device is released; stop bringing it into its safe state."""

    device: str


@dataclass(frozen=True, slots=True)
class CheckRest:
    """Effect: ask the driver whether the device still moves in its safe state; answered by
    `on_motion_report`.
    """

    device: str


@dataclass(frozen=True, slots=True)
class Mute:
    """Effect: stop sending what feeds a device's own watchdog (False: start again)."""

    on: bool


@dataclass(frozen=True, slots=True)
class Notify:
    """Effect: send a message to the host."""

    message: GuardMessage


@dataclass(frozen=True, slots=True)
class Exit:
    """Effect: close the bus and end the process with this status."""

    status: int


Effect = Execute | Interrupt | MakeSafe | Abandon | CheckRest | Mute | Notify | Exit
