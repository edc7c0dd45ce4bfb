"""Answers every frame with the next higher id, by python-can alone: the other end of the figure `drivers`.

python can_echo.py HOST PORT
"""

from __future__ import annotations

import sys

import can


def main() -> None:
    """Echo until killed."""
    bus = can.Bus(
        interface="socketcand", channel="can0", host=sys.argv[1], port=int(sys.argv[2]), tcp_tune=True
    )
    print("ready", flush=True)
    while True:
        message = bus.recv(1.0)
        if message is not None and message.arbitration_id == 0x100:
            bus.send(can.Message(arbitration_id=0x101, data=message.data, is_extended_id=False))


if __name__ == "__main__":
    main()
