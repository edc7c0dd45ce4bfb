"""A MAVLink cable that writes down when commands pass, by the kernel's own clock.

    python deadman_wire.py FAKE_PORT...

One UDP port for each fake; the lines are `ready PORT...`, then for each command of the driver
`set VEHICLE TIME NUMBER` (a velocity setpoint, its number in millimetres per second north) or
`safe VEHICLE TIME` (a change of mode). Times are seconds since 1970: the kernel stamps a datagram when it is
sent over loopback, so it does not matter how late this process reads it.
"""

from __future__ import annotations

import select
import socket
import struct
import sys

from pymavlink.dialects.v20 import all as dialect

_TIMESPEC = struct.Struct("@qq")
_SO_TIMESTAMPNS = 35


class Cable:
    """Both ends of one cable."""

    def __init__(self, number: int, fake_port: int) -> None:
        self.number = number
        self.near, self.far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self.near.bind(("127.0.0.1", 0))
        self.near.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self.far.connect(("127.0.0.1", fake_port))
        self._driver: object = None
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True

    def from_driver(self) -> None:
        """Pass a datagram on, and tell what it commands."""
        data, ancillary, _, self._driver = self.near.recvmsg(2048, 128)
        self.far.send(data)
        stamp = next(part for level, kind, part in ancillary if kind == _SO_TIMESTAMPNS)
        seconds, nanoseconds = _TIMESPEC.unpack(stamp[: _TIMESPEC.size])
        at = seconds + nanoseconds * 1e-9
        for message in self._parser.parse_buffer(data) or ():
            self._tell(message, at)

    def from_fake(self) -> None:
        """Pass a datagram back."""
        data = self.far.recv(2048)
        if self._driver is not None:
            self.near.sendto(data, self._driver)

    def _tell(self, message: dialect.MAVLink_message, at: float) -> None:
        kind = message.get_type()
        if kind == "SET_POSITION_TARGET_LOCAL_NED":
            print(f"set {self.number} {at:.6f} {round(message.vx * 1000)}", flush=True)
        elif kind == "COMMAND_LONG" and message.command == dialect.MAV_CMD_DO_SET_MODE:
            # Mode 4 is GUIDED, in which a setpoint begins; any other is a safe state.
            safe = round(message.param2) != 4
            print(f"safe {self.number} {at:.6f}" if safe else f"guided {self.number} {at:.6f}", flush=True)


def main() -> None:
    """Pass datagrams until killed."""
    cables = [Cable(number, int(port)) for number, port in enumerate(sys.argv[1:])]
    print("ready", *(cable.near.getsockname()[1] for cable in cables), flush=True)
    ends = {c.near: c.from_driver for c in cables} | {c.far: c.from_fake for c in cables}
    while True:
        for ready in select.select(list(ends), [], [])[0]:
            try:
                ends[ready]()
            except ConnectionRefusedError:
                continue


if __name__ == "__main__":
    main()
