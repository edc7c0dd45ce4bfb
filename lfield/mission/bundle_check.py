"""Cross-checks of the parts of a bundle when it is loaded, so that a host cannot fail on them later."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from lfield.driver.binding import MIN_ORPHAN_TIMEOUT, DeviceBinding
from lfield.driver.driver_index import DriverIndex
from lfield.driver.frame import Pose
from lfield.errors import BundleError
from lfield.manifest import LEAVE, NEVER, DeviceManifest, Instruction
from lfield.mission.bindings import (
    MAX_ALTITUDE,
    MAX_DISTANCE,
    MAX_HEAP,
    MAX_LEASE,
    MAX_MEMBERS,
    MIN_ALTITUDE,
    MIN_HEAP,
    MIN_LEASE,
    Bindings,
    MissionStart,
    NeededDevices,
    RecoverySettings,
    needed_devices_of,
)
from lfield.mission.team import STARTABLE, TeamRow
from lfield.vm.engine_interface import MAX_TIDY_SECONDS, AgentLimits
from lfield.vm.wasm.engine_selection import CHOICES
from lfield.wire.fields import MAX_NAME

#: Reports of hosts count agents in 16 bits.
MAX_AGENTS = 1 << 16


def check_rows(rows: Sequence[TeamRow], kinds: Mapping[str, str]) -> None:
    """Check the rows of a team: agents are resources and coordinators of the program with unique names, then
    come witnesses, hosts that have no other row.

    Raises BundleError.
    """
    agents = [row for row in rows if row[0]]
    homes, witnesses = {row[2] for row in agents}, [row for row in rows if not row[0]]
    if not (agents and len(rows) < MAX_AGENTS):
        raise BundleError(f"the team has {len(agents)} agents and {len(witnesses)} witnesses")
    if len({id for _, id, _, _ in agents}) < len(agents):
        raise BundleError("two agents of the team have the same name")
    alone = {host for _, id, host, arguments in witnesses if not (id or arguments or host in homes)}
    if list(rows) != [*agents, *witnesses] or len(alone) < len(witnesses):
        raise BundleError("a witness of the team has agents, or is listed twice")
    if not all(0 < len(host) <= MAX_NAME for host in alone):
        raise BundleError("a name in the team is too long, or empty")
    for type, id, host, _ in agents:
        name = type.removeprefix(STARTABLE)
        if kinds.get(name) not in ("resource", "coordinator"):
            raise BundleError(f"agent '{id}' has the type '{name}', which the program does not define")
        if name != type and kinds[name] != "coordinator":
            raise BundleError(f"agent '{id}' is startable, and no coordinator")
        if not (0 < len(id) <= MAX_NAME and 0 < len(host) <= MAX_NAME):
            raise BundleError("a name in the team is too long, or empty")


def check_bindings(
    bindings: Bindings, needed: NeededDevices, drivers: DriverIndex, hosts: Collection[str]
) -> None:
    """Check that exactly the needed devices are bound, each to a driver that makes it. Raises BundleError."""
    problems = (
        *_devices(bindings, needed, drivers),
        *_limits(bindings),
        *_recovery(bindings.recovery, hosts),
        *_start(bindings.start, hosts),
        *_frames(bindings),
    )
    for problem in problems:
        raise BundleError(problem)


def _recovery(recovery: RecoverySettings, hosts: Collection[str]) -> Iterator[str]:
    if not MIN_LEASE <= recovery.lease <= MAX_LEASE:
        yield "the lease of 'recovery' is out of range"
    members = set(recovery.members)
    if not (members <= set(hosts) and len(members) == len(recovery.members) <= MAX_MEMBERS):
        yield "the members of 'recovery' are not hosts of the team, or too many"


def _start(start: MissionStart, hosts: Collection[str]) -> Iterator[str]:
    if not (set(start.without) <= set(hosts) and len(set(start.without)) == len(start.without)):
        yield "'start: without' has hosts that are not in the team"


def _frames(bindings: Bindings) -> Iterator[str]:
    frames = bindings.frames
    poses = (*frames.hosts.values(), *frames.agents.values())
    if not all(map(_is_pose, poses)):
        yield "the pose of a host or agent is out of range"
    at = frames.origin
    if at and not (
        abs(at.latitude) <= 90.0
        and abs(at.longitude) <= 180.0
        and MIN_ALTITUDE <= at.altitude <= MAX_ALTITUDE
    ):
        yield "the origin of the frame is not a valid position on the Earth"
    if any(device.frame != frames.placement(device.agent) for device in bindings.all):
        yield "a device and its agent have different positions in the team's frame"


def _is_pose(pose: Pose) -> bool:
    is_near = abs(pose.north) <= MAX_DISTANCE and abs(pose.east) <= MAX_DISTANCE
    return is_near and abs(pose.down) <= MAX_ALTITUDE and abs(pose.heading) <= math.tau


def _devices(bindings: Bindings, needed: NeededDevices, drivers: DriverIndex) -> Iterator[str]:
    for agent, name, device_type in needed_devices_of(needed):
        if name not in bindings.devices.get(agent, {}):
            yield f"{agent}.{name} ({device_type}) is not bound"
    for agent, fields in bindings.devices.items():
        for name, device in fields.items():
            required = needed.get(agent, {}).get(name)
            if (device.agent, device.field, device.type) != (agent, name, required):
                yield f"{agent}.{name} is bound, but the program does not use it"
            yield from _device(device, drivers)


def _device(device: DeviceBinding, drivers: DriverIndex) -> Iterator[str]:
    driver = drivers.by_driver.get(device.driver)
    if driver is None or driver.name != device.driver:
        yield f"{device.name} is bound to the driver '{device.driver}', which is not in the bundle"
        return
    manifest = driver.manifests.get(device.type)
    if manifest is None or manifest.device.type != device.type or device.type not in driver.files:
        yield f"{device.name} is a {device.type}, which its driver does not provide"
        return
    if device.safe_state not in (manifest.device.safe_states or ("",)):
        yield f"{device.name} has no safe state '{device.safe_state}'"
    if uncancellable := [
        i.name for i in manifest.device.instructions if not _can_be_ended(i, manifest.device)
    ]:
        yield f"{device.type} has no instruction for the cancel of {', '.join(uncancellable)}"
    policy = device.without_policy
    if policy and not (
        policy.do in manifest.device.safe_states and MIN_ORPHAN_TIMEOUT <= policy.after <= 86400.0
    ):
        yield f"'without_policy' of {device.name} is invalid"
    times = 0.0 < device.ttl <= 60.0 and 1.0 <= device.rest_within <= 3600.0
    if not (times and _finite(device.limits.values())):
        yield f"the ttl, the rest_within or a limit of {device.name} is out of range"
    if missing := [option.name for option in manifest.options if option.name not in device.options]:
        yield f"{device.name} lacks the options {', '.join(missing)}"


def _can_be_ended(instruction: Instruction, device: DeviceManifest) -> bool:
    """Whether the cancel of an instruction is a keyword, or another instruction of the device without
    arguments.
    """
    end = device.instruction(instruction.cancel)
    return instruction.cancel in ("", NEVER, LEAVE) or (end is not None and not end.parameters)


def _limits(bindings: Bindings) -> Iterator[str]:
    if not (_finite([bindings.unreachable_after]) and 0.0 < bindings.silence <= 10.0):
        yield "a time in the bindings is out of range"
    if bindings.engine not in CHOICES:
        yield "the bindings name an unknown engine"
    if not all(map(_are_valid, (bindings.defaults, *bindings.agents.values()))):
        yield "the limits of an agent are out of range"


def _are_valid(limits: AgentLimits) -> bool:
    counts = (limits.call_depth, limits.array_length, limits.string_length, limits.threads)
    sized = MIN_HEAP <= limits.heap <= MAX_HEAP and 0.0 <= limits.tidy <= MAX_TIDY_SECONDS
    return sized and all(0 < count <= 1 << 31 for count in counts)


def _finite(numbers: Iterable[float]) -> bool:
    return all(math.isfinite(number) and number >= 0.0 for number in numbers)
