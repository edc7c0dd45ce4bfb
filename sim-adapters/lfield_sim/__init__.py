"""Fakes that speak the real wire protocols: the same mission on a desk as in the field.

`mavlink` is copters and rovers with an `autopilot` like ArduPilot or PX4, `can` a bus with drives,
`dynamixel` a chain of servos. Each is a model of the thing (pure, stepped by time), a protocol (bytes in,
bytes out) and a server (sockets), in that order.
"""
