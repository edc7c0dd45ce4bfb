"""Simulated devices that use the real wire protocols.

`mavlink`: copters and rovers with an `autopilot` like ArduPilot or PX4; `can`: a bus with drives;
`dynamixel`: a chain of servos. Each has a model (pure, stepped by time), a protocol (bytes in, bytes out) and
a server (sockets).
"""
