"""Files of the vehicle over MAVLink FTP: what is in its tree, and how the two autopilots differ."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.mavlink.geo import Place
from lfield_sim.mavlink.services.ftp import FtpServer
from lfield_sim.mavlink.services.parameters import ParameterType, parameter_table
from lfield_sim.mavlink.services.service import Service
from lfield_sim.mavlink.services.tree import FtpError, Tree

ARDUPILOT_FILES: Mapping[str, bytes] = {
    "/APM/LOGS/00000001.BIN": bytes(range(256)) * 40,
    "/APM/LOGS/LASTLOG.TXT": b"1\n",
    "/APM/scripts/README.txt": b"Scripts in this folder are run at start.\n",
    "/APM/terrain/.keep": b"",
}
PX4_FILES: Mapping[str, bytes] = {
    "/etc/extras/parameters.json": b'{"version": 1, "parameters": []}',
    "/fs/microsd/dataman": bytes(8192),
    "/fs/microsd/log/2026-11-20/10_00_00.ulg": b"ULog\x01\x12\x35\x01" + bytes(range(256)) * 40,
    "/fs/microsd/etc/.keep": b"",
}
#: Where ArduPilot has all parameters as one file (https://ardupilot.org/dev/docs/common-mavftp.html).
PACKED_PARAMETERS = "@PARAM/param.pck"
_PACK_MAGIC, _LONGEST_RUN = 0x671B, 15
#: Of a packed parameter: the number of its type, and how its value is written.
_PACKED = {
    ParameterType.INT8: (1, "<b"),
    ParameterType.INT16: (2, "<h"),
    ParameterType.INT32: (3, "<i"),
    ParameterType.REAL32: (4, "<f"),
}


class Files(Service):
    """The file server of one vehicle."""

    def __init__(self, autopilot: Autopilot, place: Place) -> None:
        super().__init__(autopilot, place)
        if autopilot.flavour.name == "px4":
            self._server = FtpServer(Tree(PX4_FILES), own_sessions=True)
        else:
            # Of an opcode that it does not know ArduPilot says that it failed, not that it is unknown.
            made = {PACKED_PARAMETERS: self._packed_parameters}
            self._server = FtpServer(Tree(ARDUPILOT_FILES, made), unknown=FtpError.FAIL)
        self.handles = {dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: self._on_request}

    def advance(self, now: float) -> list[Any]:
        """The next packets of bursts."""
        return [_message(peer, payload) for peer, payload in self._server.advance()]

    def reboot(self) -> None:
        """Nothing is open any more; the files stay."""
        self._server.forget()

    def _on_request(self, message: Any) -> list[Any]:
        peer = message.get_srcSystem(), message.get_srcComponent()
        return [_message(peer, payload) for payload in self._server.receive(peer, bytes(message.payload))]

    def _packed_parameters(self) -> bytes:
        table = parameter_table(self.autopilot.flavour.name, self.autopilot.kind.name)
        rows = {
            name: (table[name].type if name in table else ParameterType.REAL32, value)
            for name, value in self.autopilot.parameters.items()
        }
        return packed_parameters(rows)


def packed_parameters(rows: Mapping[str, tuple[ParameterType, float]]) -> bytes:
    """ArduPilot's param.pck: sorted names, each told by how much of it is new, with its value."""
    data = struct.pack("<HHH", _PACK_MAGIC, len(rows), len(rows))
    before = ""
    for name in sorted(rows):
        kind, value = rows[name]
        number, form = _PACKED[kind]
        common = min(_common(before, name), _LONGEST_RUN, len(name) - 1)
        rest = name[common:]
        data += bytes((number, (len(rest) - 1) << 4 | common)) + rest.encode()
        data += struct.pack(form, value if kind is ParameterType.REAL32 else int(value))
        before = name
    return data


def _common(a: str, b: str) -> int:
    """How many characters two names begin with alike."""
    return next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


def _message(peer: tuple[int, int], payload: bytes) -> Any:
    return dialect.MAVLink_file_transfer_protocol_message(0, *peer, payload)
