"""Serial ports for authors of drivers: one owner, no blocking, frames, answers in time, back after an unplug.

`SerialLine` is what most drivers want: frames in, requests and their answers. `SerialPort` is the port alone,
bytes in and out. `Lines` and `Packets` cut bytes into frames; any other class with `feed` and `reset` does
too.
They need pyserial, which the extra `serial` brings; importing this needs nothing.
"""

from lfield.driver.serial.framing import Framer, Lines, Packets
from lfield.driver.serial.line import SerialLine
from lfield.driver.serial.port import PortEvents, SerialPort, parse_serial_endpoint

__all__ = [
    "Framer",
    "Lines",
    "Packets",
    "PortEvents",
    "SerialLine",
    "SerialPort",
    "parse_serial_endpoint",
]
