"""Files of a vehicle over MAVLink FTP: its file tree, and differences of the autopilots."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.services.file_tree import FileTree, GeneratedFile
from lfield_sim.mavlink.services.ftp import ARDUPILOT, PX4, FtpServer
from lfield_sim.mavlink.services.parameters import ParameterType, parameter_table
from lfield_sim.mavlink.services.service import VehicleService

#: Placeholder contents: no zeros, whose checksum would be 0 as well.
FILLING = bytes(range(256)) * 64
ARDUPILOT_FILES: Mapping[str, bytes] = {
    "/APM/LOGS/00000001.BIN": FILLING[:10240],
    "/APM/LOGS/LASTLOG.TXT": b"1\n",
    "/APM/scripts/README.txt": b"Scripts in this folder are run at start.\n",
    "/APM/terrain/.keep": b"",
    "/eeprom.bin": FILLING,
    "/terrain/.keep": b"",
}
PX4_FILES: Mapping[str, bytes] = {
    "/etc/extras/parameters.json": b'{"version": 1, "parameters": []}',
    "/fs/microsd/dataman": FILLING[:8192],
    "/fs/microsd/log/2026-11-20/10_00_00.ulg": b"ULog\x01\x12\x35\x01" + FILLING[:10240],
    "/fs/microsd/etc/.keep": b"",
    "/etc/extras/component_general.json.xz": FILLING[:364],
    "/etc/init.d/rc.vehicle_setup": b"#!/bin/sh\n",
    "/etc/init.d-posix/rcS": b"#!/bin/sh\n",
    "/log/2026-11-20/10_00_00.ulg": b"ULog\x01\x12\x35\x01",
    "/parameters.bson": FILLING[:348],
}
#: ArduPilot's entries of virtual folders, and the reported size of a generated file.
SYSTEM_SIZE, MISSION_SIZE = 100_000, 1 << 20
LISTINGS: Mapping[str, tuple[str, ...]] = {
    "@ROMFS": ("Flocations.txt\t4727", "Dmodels"),
    "@SYS": tuple(
        f"F{name}.txt\t{SYSTEM_SIZE}" for name in ("threads", "tasks", "dma", "memory", "uarts", "timers")
    ),
}
#: The head of @MISSION/*.dat: magic number, type, options, first item, count.
_MISSION_HEAD = struct.Struct("<HHHHH")
_MISSION_MAGIC = 0x763D
#: ArduPilot's file of all parameters (https://ardupilot.org/dev/docs/common-mavftp.html).
PACKED_PARAMETERS = "@PARAM/param.pck"
_PACK_MAGIC, _DEFAULTS_MAGIC, _HAS_DEFAULT, _LONGEST_RUN = 0x671B, 0x671C, 0x10, 15
#: A packed parameter: type number, and encoding of its value.
_PACKED = {
    ParameterType.INT8: (1, "<b"),
    ParameterType.INT16: (2, "<h"),
    ParameterType.INT32: (3, "<i"),
    ParameterType.REAL32: (4, "<f"),
}


class FileService(VehicleService):
    """The file server of one vehicle."""

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        super().__init__(autopilot, place)
        if autopilot.flavour.name == "px4":
            self._server = FtpServer(FileTree(PX4_FILES, dots=("S", "S")), PX4)
        else:
            tree = FileTree(ARDUPILOT_FILES, self._generated_files(), LISTINGS, dots=("D.", "D.."))
            self._server = FtpServer(tree, ARDUPILOT, autopilot.say)
        self.handles = {dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: self._on_request}

    def advance(self, now: float) -> list[Any]:
        """The next packets of bursts."""
        return [_message(peer, payload) for peer, payload in self._server.advance()]

    def reboot(self) -> None:
        """Closes all files; their contents stay."""
        self._server.forget()

    def _on_request(self, message: Any) -> list[Any]:
        peer = message.get_srcSystem(), message.get_srcComponent()
        return [_message(peer, payload) for payload in self._server.receive(peer, bytes(message.payload))]

    def _generated_files(self) -> dict[str, GeneratedFile]:
        """Files that ArduPilot generates when they are read; those of missions and tasks keep their
        checksum.
        """

        def size() -> int:
            return 12 * len(self.autopilot.parameters)

        def system() -> int:
            return SYSTEM_SIZE

        def mission() -> int:
            return MISSION_SIZE

        generated = {
            PACKED_PARAMETERS: GeneratedFile(self._packed_parameters, size, checks=False),
            f"{PACKED_PARAMETERS}?withdefaults=1": GeneratedFile(self._with_defaults, size, checks=False),
            "@SYS/tasks.txt": GeneratedFile(lambda: b"TasksV2\n", system),
            "@SYS/uarts.txt": GeneratedFile(lambda: b"UARTV1\n", system, checks=False),
        }
        for kind, name in enumerate(("mission", "fence", "rally")):
            generated[f"@MISSION/{name}.dat"] = GeneratedFile(partial(_empty_plan, kind), mission)
        return generated

    def _with_defaults(self) -> bytes:
        return packed_parameters(self._rows(), self._defaults())

    def _packed_parameters(self) -> bytes:
        return packed_parameters(self._rows())

    def _defaults(self) -> Mapping[str, float]:
        table = parameter_table(self.autopilot.flavour.name, self.autopilot.kind.name)
        return {name: row.value for name, row in table.items()} | dict(self.autopilot.kind.parameters)

    def _rows(self) -> Mapping[str, tuple[ParameterType, float]]:
        table = parameter_table(self.autopilot.flavour.name, self.autopilot.kind.name)
        return {
            name: (table[name].type if name in table else ParameterType.REAL32, value)
            for name, value in self.autopilot.parameters.items()
        }


def _empty_plan(kind: int) -> bytes:
    """A plan without items: uploaded items are not modelled here."""
    return _MISSION_HEAD.pack(_MISSION_MAGIC, kind, 0, 0, 0)


def packed_parameters(
    rows: Mapping[str, tuple[ParameterType, float]], defaults: Mapping[str, float] | None = None
) -> bytes:
    """ArduPilot's param.pck: sorted names, prefix-compressed, with values.

    With `defaults` the default follows a different value.
    """
    magic = _PACK_MAGIC if defaults is None else _DEFAULTS_MAGIC
    data = struct.pack("<HHH", magic, len(rows), len(rows))
    previous = ""
    for name in sorted(rows):
        kind, value = rows[name]
        number, form = _PACKED[kind]
        common = min(_common(previous, name), _LONGEST_RUN, len(name) - 1)
        suffix = name[common:]
        values = [value]
        if defaults is not None and defaults.get(name, value) != value:
            values, number = [value, defaults[name]], number | _HAS_DEFAULT
        data += bytes((number, (len(suffix) - 1) << 4 | common)) + suffix.encode()
        for each in values:
            data += struct.pack(form, each if kind is ParameterType.REAL32 else int(each))
        previous = name
    return data


def _common(a: str, b: str) -> int:
    """Length of the common prefix of two names."""
    return next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


def _message(peer: tuple[int, int], payload: bytes) -> Any:
    return dialect.MAVLink_file_transfer_protocol_message(0, *peer, payload)
