"""Monitors of an autopilot: `failsafes` (station, setpoints, battery, position), `fence_monitor`, and
`arming_readiness`.
"""
