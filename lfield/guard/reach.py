"""What a guard may touch: the device that it owns, and what code needs to run. `confine` makes it so.

It follows from the endpoint and the options of its devices. A driver loads foreign code, which parses bytes
of others: it must not read the keys of its host, write into a journal, or command another guard's device.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from lfield.driver.binding import DeviceBinding
from lfield.driver.known import KnownDriver
from lfield.guard.endpoint_lock import Place, places

#: Endpoints that are device files, by what stands before the colon: such a guard needs no network.
_TTY = ("serial", "slcan")
#: Those that need no IP either, and those that connect by TCP, or send datagrams.
_CAN, _TCP, _UDP = ("socketcan",), ("tcp", "socketcand"), ("udp", "udpin")
#: Device files that stay: ports of the board itself. What is plugged in again comes back as another file.
_SOLDERED = ("ttyS", "ttyAMA", "ttyTHS")
#: What code reads of the system. Of /etc only how names become addresses, and the time zone.
_NAMES = ("hosts", "resolv.conf", "nsswitch.conf", "host.conf", "gai.conf", "services", "passwd", "group")
SYSTEM = (
    *("/usr", "/lib", "/lib64", "/bin", "/opt", "/proc", "/sys", "/etc/ld.so.cache", "/etc/localtime"),
    *(f"/etc/{name}" for name in _NAMES),
)
#: Devices that are none.
NOTHINGS = ("/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom")


@dataclass(frozen=True, slots=True)
class Reach:
    """What one guard may touch, in paths; a folder stands for all in it.

    `reads` and `writes` are files, `folders` may be written into too. `ports` are those that it may call by
    TCP, None for any. Without `internet` it opens no socket but Unix and CAN; without `runs` no program.
    """

    reads: tuple[str, ...]
    writes: tuple[str, ...] = NOTHINGS
    folders: tuple[str, ...] = ()
    ports: tuple[int, ...] | None = ()
    internet: bool = False
    runs: bool = False


@dataclass(slots=True)
class _Needs:
    """What is found out of the endpoints, one after the other."""

    writes: list[str] = field(default_factory=lambda: list(NOTHINGS))
    folders: list[str] = field(default_factory=list)
    ports: list[int] = field(default_factory=list)
    internet: bool = False
    unknown: bool = False

    def take(self, kind: str, place: Place | None) -> None:
        """One link of an endpoint; `place` is None for one that leads nowhere that is known."""
        if kind in _TTY and place is not None and place.kind == "device":
            self._device(os.path.realpath(place.name))
        elif kind in _TCP and place is not None:
            self.internet = True
            self.ports.append(place.port)
        elif kind in _UDP:
            self.internet = True
        elif kind not in _CAN:
            self.unknown = True

    def _device(self, path: str) -> None:
        if os.path.basename(path).startswith(_SOLDERED):
            self.writes.append(path)
        else:
            self.folders.append(os.path.dirname(path))


def reach(devices: Sequence[DeviceBinding], driver: KnownDriver, code: Iterable[str], scratch: str) -> Reach:
    """What the guard of these devices may touch; `code` are the folders that modules come from.

    `scratch` is a folder for temporary files. Of an endpoint of a kind that is not known here nobody can say
    what it needs: it keeps the devices, the network and other programs, and reads no file of its user either.
    """
    needs = _Needs()
    for endpoint in sorted({device.endpoint for device in devices}):
        for link in endpoint.split(","):
            found = places(link)
            needs.take(link.strip().partition(":")[0], found[0] if found else None)
    files = [path for device in devices for path in _files(device, driver)]
    own = [folder for folder in map(os.path.dirname, files) if _is_theirs(folder)]
    reads = (*SYSTEM, *_resolver_folders(), *sorted(set(code)), *files)
    if needs.unknown:
        return Reach(reads, tuple(needs.writes), ("/dev", scratch, *own), None, internet=True, runs=True)
    folders = (*sorted(set(needs.folders)), *own)
    return Reach(reads, tuple(needs.writes), folders, tuple(needs.ports), internet=needs.internet)


def _resolver_folders() -> tuple[str, ...]:
    """The folder that /etc/resolv.conf leads into, where it is a link: the file there is replaced.

    What is allowed is a file, not its name: after a change of the network the new one could not be read.
    """
    folder = os.path.dirname(os.path.realpath("/etc/resolv.conf"))
    return (folder,) if folder.startswith("/run/") else ()


def _is_theirs(folder: str) -> bool:
    """Whether the folder of a file is the driver's to write into: this user may, and no keys are below it."""
    return os.access(folder, os.W_OK) and not os.path.isdir(os.path.join(folder, "keys"))


def _files(device: DeviceBinding, driver: KnownDriver) -> list[str]:
    """The files that options of a device name."""
    options = driver.manifests[device.type].options if device.type in driver.manifests else ()
    named = (device.options.get(option.name) for option in options if option.type == "path")
    return [os.path.abspath(str(path)) for path in named if path]
