"""What must hold between the parts of a bundle, so that no host stumbles over it later."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

from lfield.driver.binding import LEAST_AFTER, DeviceBinding
from lfield.driver.frame import Pose
from lfield.driver.known import KnownDrivers
from lfield.errors import BundleError
from lfield.manifest import LEAVE, NEVER, DeviceManifest, Instruction
from lfield.mission.bindings import (
    FARTHEST,
    HIGHEST,
    LONGEST_LEASE,
    LOWEST,
    MAX_HEAP,
    MIN_HEAP,
    MOST_MEMBERS,
    SHORTEST_LEASE,
    Bindings,
    MissionStart,
    Needed,
    Recovery,
    each_needed,
)
from lfield.mission.team import Row
from lfield.vm.contract import MAX_TIDY, Limits
from lfield.vm.wasm.choice import CHOICES
from lfield.wire.fields import MAX_NAME

#: Agents are counted in 16 bits in the reports of hosts.
MOST_AGENTS = 1 << 16


def check_rows(rows: Sequence[Row], kinds: Mapping[str, str]) -> None:
    """The agents of a team are resources and coordinators of the program, each with a name of its own; then
    come witnesses, each a host that has no other row.

    Raises BundleError.
    """
    agents = [row for row in rows if row[0]]
    homes, witnesses = {row[2] for row in agents}, [row for row in rows if not row[0]]
    if not (agents and len(rows) < MOST_AGENTS):
        raise BundleError(f"its team has {len(agents)} agents and {len(witnesses)} witnesses")
    if len({id for _, id, _, _ in agents}) < len(agents):
        raise BundleError("two agents of its team have one name")
    alone = {host for _, id, host, arguments in witnesses if not (id or arguments or host in homes)}
    if list(rows) != [*agents, *witnesses] or len(alone) < len(witnesses):
        raise BundleError("a witness of its team is none")
    if not all(0 < len(host) <= MAX_NAME for host in alone):
        raise BundleError("a name of its team is too long, or empty")
    for type, id, host, _ in agents:
        if kinds.get(type) not in ("resource", "coordinator"):
            raise BundleError(f"'{id}' of its team is a '{type}', which its program does not have")
        if not (0 < len(id) <= MAX_NAME and 0 < len(host) <= MAX_NAME):
            raise BundleError("a name of its team is too long, or empty")


def check_bindings(bindings: Bindings, needed: Needed, drivers: KnownDrivers, hosts: Collection[str]) -> None:
    """Every device that is needed is bound, nothing else is, and all can be made. Raises BundleError."""
    problems = (
        *_devices(bindings, needed, drivers),
        *_limits(bindings),
        *_recovery(bindings.recovery, hosts),
        *_start(bindings.start, hosts),
        *_frames(bindings),
    )
    for problem in problems:
        raise BundleError(problem)


def _recovery(recovery: Recovery, hosts: Collection[str]) -> Iterator[str]:
    if not SHORTEST_LEASE <= recovery.lease <= LONGEST_LEASE:
        yield "the lease of its recovery makes no sense"
    members = set(recovery.members)
    if not (members <= set(hosts) and len(members) == len(recovery.members) <= MOST_MEMBERS):
        yield "the members of its recovery are no hosts of its team, or too many"


def _start(start: MissionStart, hosts: Collection[str]) -> Iterator[str]:
    if not (set(start.without) <= set(hosts) and len(set(start.without)) == len(start.without)):
        yield "the hosts that its start does not wait for are no hosts of its team"


def _frames(bindings: Bindings) -> Iterator[str]:
    frames = bindings.frames
    poses = (*frames.hosts.values(), *frames.agents.values())
    if not all(map(_is_pose, poses)):
        yield "the pose of a host or agent makes no sense"
    at = frames.origin
    if at and not (
        abs(at.latitude) <= 90.0 and abs(at.longitude) <= 180.0 and LOWEST <= at.altitude <= HIGHEST
    ):
        yield "the origin of its frame is no place on the Earth"
    if any(device.frame != frames.of(device.agent) for device in bindings.all):
        yield "a device is elsewhere in the team's frame than its agent"


def _is_pose(pose: Pose) -> bool:
    near = abs(pose.north) <= FARTHEST and abs(pose.east) <= FARTHEST
    return near and abs(pose.down) <= HIGHEST and abs(pose.heading) <= math.tau


def _devices(bindings: Bindings, needed: Needed, drivers: KnownDrivers) -> Iterator[str]:
    for agent, name, device_type in each_needed(needed):
        if name not in bindings.devices.get(agent, {}):
            yield f"{agent}.{name} ({device_type}) is not bound"
    for agent, fields in bindings.devices.items():
        for name, device in fields.items():
            wanted = needed.get(agent, {}).get(name)
            if (device.agent, device.field, device.type) != (agent, name, wanted):
                yield f"{agent}.{name} is bound and not needed"
            yield from _device(device, drivers)


def _device(device: DeviceBinding, drivers: KnownDrivers) -> Iterator[str]:
    driver = drivers.by_driver.get(device.driver)
    if driver is None or driver.name != device.driver:
        yield f"{device.name} is bound to the driver '{device.driver}', which it does not know"
        return
    manifest = driver.manifests.get(device.type)
    if manifest is None or manifest.device.type != device.type or device.type not in driver.files:
        yield f"{device.name} is a {device.type}, which its driver does not make"
        return
    if device.safe_state not in (manifest.device.safe_states or ("",)):
        yield f"{device.name} has no safe state '{device.safe_state}'"
    if lost := [i.name for i in manifest.device.instructions if not _can_be_ended(i, manifest.device)]:
        yield f"nothing in {device.type} does what a cancel of {', '.join(lost)} says"
    policy = device.without_policy
    if policy and not (policy.do in manifest.device.safe_states and LEAST_AFTER <= policy.after <= 86400.0):
        yield f"what {device.name} does without a policy makes no sense"
    times = 0.0 < device.ttl <= 60.0 and 1.0 <= device.rest_within <= 3600.0
    if not (times and _finite(device.limits.values())):
        yield f"the ttl, the rest_within or a limit of {device.name} makes no sense"
    if missing := [option.name for option in manifest.options if option.name not in device.options]:
        yield f"{device.name} lacks {', '.join(missing)}"


def _can_be_ended(instruction: Instruction, device: DeviceManifest) -> bool:
    """Whether a cancel of it is a word, or another instruction that there is and that needs no arguments."""
    end = device.instruction(instruction.cancel)
    return instruction.cancel in ("", NEVER, LEAVE) or (end is not None and not end.parameters)


def _limits(bindings: Bindings) -> Iterator[str]:
    if not (_finite([bindings.unreachable_after]) and 0.0 < bindings.silence <= 10.0):
        yield "the times of its bindings make no sense"
    if bindings.engine not in CHOICES:
        yield "its bindings name no engine"
    if not all(map(_sound, (bindings.defaults, *bindings.agents.values()))):
        yield "the limits of an agent make no sense"


def _sound(limits: Limits) -> bool:
    counts = (limits.call_depth, limits.array_length, limits.string_length, limits.threads)
    sized = MIN_HEAP <= limits.heap <= MAX_HEAP and 0.0 <= limits.tidy <= MAX_TIDY
    return sized and all(0 < count <= 1 << 31 for count in counts)


def _finite(numbers: Iterable[float]) -> bool:
    return all(math.isfinite(number) and number >= 0.0 for number in numbers)
