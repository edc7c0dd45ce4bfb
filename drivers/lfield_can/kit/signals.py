"""Checks of a device by DBC file. It is sent its safe state, and nothing else."""

from __future__ import annotations

import math

from lfield.driver import DeviceError
from lfield.driver.kit import Bench, CheckFailed, Kit, NotTried, held, refused
from lfield_can.dbc import DbcFile, representable

SIGNALS = Kit()

_TYPES = ("CanSignals",)


@SIGNALS.check("what it sends can be read", moves=False, types=_TYPES)
async def reads(bench: Bench) -> str:
    """Every message that was ever heard is young enough, and its signals are numbers."""
    file, heard, silent = _file(bench), [], []
    for name in file.names:
        if name in _commands(bench):
            continue
        try:
            await bench.call("ageOf", name)
        except DeviceError:
            silent.append(name)
            continue
        heard += [
            f"{name}.{signal.name}" for signal in file.message(name).signals if not signal.multiplexer_ids
        ]
    if not heard:
        raise CheckFailed(f"none of its messages was heard: {', '.join(silent)}")
    told, absent = [], []
    for signal in heard:
        try:
            told.append(f"{signal} {await bench.call('read', signal):g}")
        except DeviceError:
            absent.append(signal)
    if not told:
        raise CheckFailed(f"none of its signals can be read: {', '.join(absent)}")
    if absent:
        told.append(f"and absent from its frames {' '.join(absent)}")
    if silent:
        told.append(f"and never heard {' '.join(silent)}")
    return ", ".join(told)


@SIGNALS.check("all its frames make sense", moves=False, types=_TYPES)
async def sound(bench: Bench) -> str:
    """It is heard, and the file explains what it says."""
    if not bench.query("online"):
        raise CheckFailed("it is not heard")
    if bench.query("malformed"):
        raise CheckFailed(f"the DBC file cannot explain {bench.query('malformed')} of its messages")
    return f"heard {bench.query('age') * 1000:.0f} ms ago"


@SIGNALS.check("what is not in the file cannot be read", moves=False, types=_TYPES)
async def unknown(bench: Bench) -> str:
    """A wrong name is an error, not a 0."""
    return await refused(bench, "read", "Nobody.Nothing")


@SIGNALS.check("what its binding does not list cannot be sent", moves=True, types=_TYPES)
async def unlisted(bench: Bench) -> str:
    """Only the messages of 'commands' are ours."""
    file = _file(bench)
    others = [name for name in file.names if name not in _commands(bench) and file.message(name).signals]
    if not others:
        raise NotTried("its binding lists every message of the file")
    message = file.message(others[0])
    values = [max(0.0, representable(signal)[0]) for signal in message.signals]
    await refused(bench, "send", message.name, values)
    return await refused(bench, "set", f"{message.name}.{message.signals[0].name}", values[0])


@SIGNALS.check("what a signal cannot carry is refused", moves=True, types=_TYPES)
async def ranges(bench: Bench) -> str:
    """Also where the file gives no range: a number that does not fit into its bits."""
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
async def ends(bench: Bench) -> str:
    """A signal of the safe state is set as it is there; its time over, the safe state is sent and seen."""
    safe = bench.binding.option("safe")
    if not safe:
        raise NotTried("its binding lists no commands")
    signal, _, value = str(safe[0]).partition("=")
    await bench.call("set", signal.strip(), float(value))
    return f"{safe[0]}, then held because {await held(bench, bench.binding.ttl + 2.0)}"


def _file(bench: Bench) -> DbcFile:
    return DbcFile(str(bench.binding.option("dbc")))


def _commands(bench: Bench) -> list[str]:
    return list(bench.binding.option("commands"))
