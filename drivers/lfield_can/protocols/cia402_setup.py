"""Set-up of a CiA 402 drive: heartbeat, process data, limits, behaviour on a loss of the master."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

from lfield.driver import DeviceBinding, DeviceError
from lfield_can import log_messages
from lfield_can.protocols import cia402_tables as t
from lfield_can.protocols.canopen_node import CanopenNode, SdoRefused
from lfield_can.protocols.cia402_tables import Units

#: Milliseconds between two heartbeats of the drive.
HEARTBEAT_EVERY = 100
#: The longest permitted period: two of them must fit the time-out.
SLOWEST_HEARTBEAT = 200
#: The low half of 0x1000 of a drive.
DRIVE_PROFILE = 402
#: Bounds beyond which a position is unbounded.
UNBOUNDED = 1e9

Note = Callable[[str], None]


async def identify(node: CanopenNode, error: Callable[[str], DeviceError]) -> str:
    """The identity of the drive. Raises DeviceError when the node is not a drive."""
    device_type = await node.read(0x1000)
    if device_type & 0xFFFF != DRIVE_PROFILE:
        raise error(f"it is not a CiA 402 drive: its device type 0x1000 is 0x{device_type:08X}")
    vendor, product = await optional(node, 0x1018, 1), await optional(node, 0x1018, 2)
    return f"vendor 0x{vendor or 0:X}, product 0x{product or 0:X}"


async def optional(node: CanopenNode, index: int, subindex: int = 0) -> int | None:
    """The value of an optional object."""
    try:
        return await node.read(index, subindex)
    except SdoRefused:
        return None


async def set_heartbeat(node: CanopenNode, error: Callable[[str], DeviceError]) -> None:
    """Sets a heartbeat of ten per second, which detects a silent drive.

    A drive that refuses keeps its own period if that is short enough. Raises DeviceError.
    """
    try:
        await node.write_raw(0x1017, 0, HEARTBEAT_EVERY.to_bytes(2, "little"))
        reason = "it accepts no other time"
    except SdoRefused as refusal:
        reason = refusal.reason
    period = await optional(node, 0x1017)
    if not period:
        raise error(
            f"it sends no heartbeat ({reason}), so its failure would not be noticed; node guarding is not "
            "supported"
        )
    if period > SLOWEST_HEARTBEAT:
        raise error(f"its heartbeat period of {period} ms is too long and cannot be changed ({reason})")


async def read_ratings(node: CanopenNode, units: Units) -> None:
    """Reads rated torque (mN m) and current (mA), unless the binding gives them."""
    torque = units.rated_torque or (await optional(node, 0x6076) or 0) / 1000.0
    current = units.rated_current or (await optional(node, 0x6075) or 0) / 1000.0
    units.set_ratings(torque, current)


async def set_limits(node: CanopenNode, binding: DeviceBinding, units: Units, note: Note) -> None:
    """Writes the limits of the binding to the drive, where it supports them."""
    for (index, subindex), value in _limits(binding, units).items():
        try:
            await node.write(index, subindex, value)
        except SdoRefused as refusal:
            note(log_messages.LIMIT_BY_DRIVER.line(reason=refusal.reason))


def _limits(binding: DeviceBinding, units: Units) -> Mapping[tuple[int, int], int]:
    limits, required = binding.limits, {}
    if "speed" in limits:
        required[0x607F, 0] = abs(units.to_velocity(limits["speed"]))
    if "acceleration" in limits:
        for index in (0x6083, 0x6084, 0x6085):
            required[index, 0] = abs(units.to_velocity(limits["acceleration"]))
    if "torque" in limits and units.rated_torque:
        required[0x6072, 0] = abs(units.to_torque(limits["torque"]))
    if "current" in limits and units.rated_current:
        required[0x6073, 0] = round(1000.0 * limits["current"] / units.rated_current)
    bounds = binding.option("lowest"), binding.option("highest")
    if max(map(abs, bounds)) < UNBOUNDED:
        required[0x607D, 1], required[0x607D, 2] = sorted(map(units.to_counts, bounds))
    return required


async def set_quick_stop(
    node: CanopenNode, safe_state: str, error: Callable[[str], DeviceError], note: Note
) -> None:
    """Configures the quick stop: with torque at the end for torque_hold; braking for brake."""
    if safe_state == "torque_off":
        return
    if safe_state == "torque_hold":
        await _set_hold(node, error)
    else:
        await _check_brakes(node, error, note)
    if await optional(node, 0x605E) == t.DISABLES:
        note(log_messages.COASTS.line())


async def _set_hold(node: CanopenNode, error: Callable[[str], DeviceError]) -> None:
    try:
        await node.write(0x605A, 0, t.STOP_AND_HOLD)
    except SdoRefused as refusal:
        raise error(
            f"it cannot hold its torque after a quick stop ({refusal.reason}); use another safe_state"
        ) from None


async def _check_brakes(node: CanopenNode, error: Callable[[str], DeviceError], note: Note) -> None:
    code = await optional(node, 0x605A)
    if code == t.DISABLES:
        raise error(
            "its quick stop coasts (0x605A is 0) instead of braking; set it to 2 by the vendor's tool, or "
            "use another safe_state"
        )
    if code is None or not 0 < code <= t.LAST_KNOWN:
        reason = "it does not report how" if code is None else f"0x605A is {code}, which is vendor-specific"
        note(log_messages.QUICK_STOP_UNKNOWN.line(reason=reason))


async def set_watchdog(
    node: CanopenNode, master: int, longest: float, safe_state: str, note: Note
) -> float | None:
    """Makes the drive stop when our heartbeat is missing for `longest` seconds; returns the actual
    time-out.
    """
    milliseconds = int(longest * 1000.0)
    reaction = t.ABORT_DISABLES if safe_state == "torque_off" else t.ABORT_QUICK_STOPS
    try:
        await node.write(0x6007, 0, reaction)
        # An entry in use may only be changed after it was set to 0.
        await node.write_raw(0x1016, 1, _u32(0))
        await node.write(0x1016, 1, master << 16 | milliseconds)
    except SdoRefused as refusal:
        note(log_messages.HEARTBEAT_IGNORED.line(reason=refusal.reason))
        return None
    return (await node.read(0x1016, 1) & 0xFFFF) / 1000.0


def _u32(value: int) -> bytes:
    return struct.pack("<I", value)
