"""Serial ports for driver authors: exclusive, non-blocking, framed, with time-outs and reconnection.

`SerialLine` suits most drivers: frames, requests and responses. `SerialPort` is only the port: bytes in and
out. `Lines` and `Packets` cut bytes into frames, as does any class with `feed` and `reset`. Requires pyserial
(extra `serial`), except for importing this package.
"""

from lfield.driver.serial.serial_framing import Framer, Lines, Packets
from lfield.driver.serial.serial_line import SerialLine
from lfield.driver.serial.serial_port import PortEvents, SerialPort, parse_serial_endpoint

__all__ = [
    "Framer",
    "Lines",
    "Packets",
    "PortEvents",
    "SerialLine",
    "SerialPort",
    "parse_serial_endpoint",
]
