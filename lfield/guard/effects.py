"""Effects of `GuardCore`, carried out by its shell in order."""

from __future__ import annotations

from msgspec import Struct

from lfield.guard.messages import GuardCall, GuardMessage


class Execute(Struct, frozen=True):
    """Effect: the driver executes a call."""

    call: GuardCall


class Interrupt(Struct, frozen=True):
    """Effect: stop executing the call of this token; the driver's result is discarded."""

    token: int


class MakeSafe(Struct, frozen=True):
    """Effect: the driver brings a device into a safe state ('': that of its binding), before all other
    effects.
    """

    device: str
    state: str = ""


class Abandon(Struct, frozen=True):
    """Effect: the device is released; stop the command of its safe state."""

    device: str


class CheckRest(Struct, frozen=True):
    """Effect: ask the driver whether the device still moves in its safe state; answered by
    `on_motion_report`.
    """

    device: str


class Mute(Struct, frozen=True):
    """Effect: stop sending the messages that feed a device's own watchdog (False: start again)."""

    on: bool


class Notify(Struct, frozen=True):
    """Effect: send a message to the host."""

    message: GuardMessage


class Exit(Struct, frozen=True):
    """Effect: close the bus and end the process with this status."""

    status: int


Effect = Execute | Interrupt | MakeSafe | Abandon | CheckRest | Mute | Notify | Exit
