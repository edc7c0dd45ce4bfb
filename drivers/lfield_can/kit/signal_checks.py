"""Checks of a device by DBC file. Only its safe state is sent."""

from __future__ import annotations

import math

from lfield.driver import DeviceError
from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried, held, refused
from lfield_can.dbc import DbcFile, representable

SIGNALS = Kit()

_TYPES = ("CanSignals",)


@SIGNALS.check("its messages can be read", moves=False, types=_TYPES)
async def reads(bench: Bench) -> str:
    """Every received message is fresh, and its signals are numbers."""
    file, received, silent = _file(bench), [], []
    for name in file.names:
        if name in _commands(bench):
            continue
        try:
            await bench.call("ageOf", name)
        except DeviceError:
            silent.append(name)
            continue
        received += [
            f"{name}.{signal.name}" for signal in file.message(name).signals if not signal.multiplexer_ids
        ]
    if not received:
        raise CheckFailed(f"none of its messages was received: {', '.join(silent)}")
    readings, missing = [], []
    for signal in received:
        try:
            readings.append(f"{signal} {await bench.call('read', signal):g}")
        except DeviceError:
            missing.append(signal)
    if not readings:
        raise CheckFailed(f"none of its signals can be read: {', '.join(missing)}")
    if missing:
        readings.append(f"and absent from its frames {' '.join(missing)}")
    if silent:
        readings.append(f"and never received {' '.join(silent)}")
    return ", ".join(readings)


@SIGNALS.check("all its frames are valid", moves=False, types=_TYPES)
async def healthy(bench: Bench) -> str:
    """The device responds, and the file describes its messages."""
    if not bench.query("online"):
        raise CheckFailed("it does not respond")
    if bench.query("malformed"):
        raise CheckFailed(f"{bench.query('malformed')} of its messages do not match the DBC file")
    return f"last message {bench.query('age') * 1000:.0f} ms ago"


@SIGNALS.check("unknown signals are refused", moves=False, types=_TYPES)
async def unknown(bench: Bench) -> str:
    """A wrong name is an error, not a 0."""
    return await refused(bench, "read", "Unknown.Signal")


@SIGNALS.check("messages that its binding does not list are refused", moves=True, types=_TYPES)
async def unlisted(bench: Bench) -> str:
    """Only the messages in 'commands' may be sent."""
    file = _file(bench)
    others = [name for name in file.names if name not in _commands(bench) and file.message(name).signals]
    if not others:
        raise NotTried("its binding lists every message of the file")
    message = file.message(others[0])
    values = [max(0.0, representable(signal)[0]) for signal in message.signals]
    await refused(bench, "send", message.name, values)
    return await refused(bench, "set", f"{message.name}.{message.signals[0].name}", values[0])


@SIGNALS.check("values that a signal cannot represent are refused", moves=True, types=_TYPES)
async def ranges(bench: Bench) -> str:
    """A number that does not fit the bits of its signal is refused, also without a range in the file."""
    signals = [
        (name, signal)
        for name in _commands(bench)
        for signal in _file(bench).message(name).signals
        if math.isfinite(representable(signal)[1])
    ]
    if not signals:
        raise NotTried("its binding lists no commands")
    for name, signal in signals:
        lowest, highest = representable(signal)
        too_much = highest + (highest - lowest)
        reason = await refused(bench, "set", f"{name}.{signal.name}", too_much)
    return f"{len(signals)} signals, the last: {reason}"


@SIGNALS.check("a setpoint that is not renewed ends", moves=True, types=_TYPES)
async def ends_safely(bench: Bench) -> str:
    """A signal of the safe state is set; after its time-to-live the safe state is sent and confirmed."""
    safe = bench.binding.option("safe")
    if not safe:
        raise NotTried("its binding lists no commands")
    signal, _, value = str(safe[0]).partition("=")
    await bench.call("set", signal.strip(), float(value))
    return f"{safe[0]}, then held: {await held(bench, bench.binding.ttl + 2.0)}"


def _file(bench: Bench) -> DbcFile:
    return DbcFile(str(bench.binding.option("dbc")))


def _commands(bench: Bench) -> list[str]:
    return list(bench.binding.option("commands"))
