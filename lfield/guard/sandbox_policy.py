"""The access rights of a guard: its device, and the files that code needs to run. The policy is derived from
the endpoint and options of the devices; `apply_sandbox` enforces it.

A driver loads third-party code that parses untrusted bytes: it must not read the keys of its host, write into
a journal, or command another guard's device.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence

from msgspec import Struct, field

from lfield.driver.binding import DeviceBinding
from lfield.driver.driver_index import DriverInfo
from lfield.guard.endpoint_lock import EndpointTarget, endpoint_targets

#: Endpoint schemes of device files: such a guard needs no network.
_TTY = ("serial", "slcan")
#: Schemes that also need no IP; that connect by TCP; that send datagrams.
_CAN, _TCP, _UDP = ("socketcan",), ("tcp", "socketcand"), ("udp", "udpin")
#: Prefixes of built-in ports. Other ports may reappear as another file after they are plugged in again.
_BUILT_IN = ("ttyS", "ttyAMA", "ttyTHS")
#: System files that code reads; in /etc only name resolution and the time zone.
_RESOLVER_FILES = (
    "hosts",
    "resolv.conf",
    "nsswitch.conf",
    "host.conf",
    "gai.conf",
    "services",
    "passwd",
    "group",
)
SYSTEM = (
    *("/usr", "/lib", "/lib64", "/bin", "/opt", "/proc", "/sys", "/etc/ld.so.cache", "/etc/localtime"),
    *(f"/etc/{name}" for name in _RESOLVER_FILES),
)
#: Pseudo devices.
PSEUDO_DEVICES = ("/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom")


class SandboxPolicy(Struct, frozen=True):
    """The paths and ports that one guard may access; a folder includes all files below it.

    `folders` may be written into. In the folder `recording`, if any, files can be created, appended to and
    removed, but not read. `ports` are the TCP ports that the guard may connect to, None for any. Without
    `has_internet` it may only open Unix and CAN sockets; without `may_execute` it may not execute programs.
    """

    readable: tuple[str, ...]
    writable: tuple[str, ...] = PSEUDO_DEVICES
    folders: tuple[str, ...] = ()
    recording: str = ""
    ports: tuple[int, ...] | None = ()
    has_internet: bool = False
    may_execute: bool = False


class _Requirements(Struct):
    """Requirements collected from the endpoints."""

    writes: list[str] = field(default_factory=lambda: list(PSEUDO_DEVICES))
    folders: list[str] = field(default_factory=list)
    ports: list[int] = field(default_factory=list)
    internet: bool = False
    unknown: bool = False

    def add_target(self, kind: str, place: EndpointTarget | None) -> None:
        """Adds one link of an endpoint; `place` is None when its target is unknown."""
        if kind in _TTY and place is not None and place.kind == "device":
            self._add_device(os.path.realpath(place.name))
        elif kind in _TCP and place is not None:
            self.internet = True
            self.ports.append(place.port)
        elif kind in _UDP:
            self.internet = True
        elif kind not in _CAN:
            self.unknown = True

    def _add_device(self, path: str) -> None:
        if os.path.basename(path).startswith(_BUILT_IN):
            self.writes.append(path)
        else:
            self.folders.append(os.path.dirname(path))


def policy_for(
    devices: Sequence[DeviceBinding],
    driver: DriverInfo,
    code: Iterable[str],
    scratch: str,
    recording: str = "",
) -> SandboxPolicy:
    """The policy for the guard of these devices; `code` are the folders that modules come from.

    `scratch` is a folder for temporary files, `recording` the folder of a recording, if there is one. An
    unknown kind of endpoint has unknown requirements: its guard keeps access to devices, network and other
    programs, but not to the files of its user.
    """
    needs = _Requirements()
    for endpoint in sorted({device.endpoint for device in devices}):
        for link in endpoint.split(","):
            found = endpoint_targets(link)
            needs.add_target(link.strip().partition(":")[0], found[0] if found else None)
    files = [path for device in devices for path in _files(device, driver)]
    own = [folder for folder in map(os.path.dirname, files) if _is_writable_by_driver(folder)]
    reads = (*SYSTEM, *_resolver_folders(), *sorted(set(code)), *files)
    if needs.unknown:
        everywhere = ("/dev", scratch, *own)
        return SandboxPolicy(
            reads, tuple(needs.writes), everywhere, recording, None, has_internet=True, may_execute=True
        )
    folders, ports = (*sorted(set(needs.folders)), *own), tuple(needs.ports)
    return SandboxPolicy(reads, tuple(needs.writes), folders, recording, ports, has_internet=needs.internet)


def _resolver_folders() -> tuple[str, ...]:
    """The folder of the file behind a link /etc/resolv.conf, which is replaced at a change of network.

    Landlock grants access to a file, not to its name, so a replaced file would be unreadable.
    """
    folder = os.path.dirname(os.path.realpath("/etc/resolv.conf"))
    return (folder,) if folder.startswith("/run/") else ()


def _is_writable_by_driver(folder: str) -> bool:
    """Whether the driver may write into the folder of a file: this user may write into it, and it contains no
    keys.
    """
    return os.access(folder, os.W_OK) and not os.path.isdir(os.path.join(folder, "keys"))


def _files(device: DeviceBinding, driver: DriverInfo) -> list[str]:
    """The files named by options of a device."""
    options = driver.manifests[device.type].options if device.type in driver.manifests else ()
    named = (device.options.get(option.name) for option in options if option.type == "path")
    return [os.path.abspath(str(path)) for path in named if path]
