"""python station.py ENDPOINT: sends the heartbeats of a ground station with the defaults of QGroundControl.

System 255, component 190, once a second, on a separate link, until the process is ended.
"""

from __future__ import annotations

import socket
import sys
import time

from pymavlink.dialects.v20 import all as dialect

SYSTEM, COMPONENT, PERIOD = 255, 190, 1.0


def beat(endpoint: str) -> None:
    """Send heartbeats to a vehicle at `udp:HOST:PORT`; never returns."""
    _, host, port = endpoint.split(":")
    packer = dialect.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
    heartbeat = dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        while True:
            link.sendto(bytes(heartbeat.pack(packer)), (host, int(port)))
            packer.seq = (packer.seq + 1) % 256
            time.sleep(PERIOD)


if __name__ == "__main__":
    beat(sys.argv[1])
