"""Fakes that speak the real wire protocols: the same mission on a desk as in the field.

`mavlink` is a copter or a rover with an ArduPilot-like autopilot. Each fake is a model of the thing
(pure, stepped by time), a protocol (bytes in, bytes out) and a server (sockets), in that order.
"""
