"""What an autopilot watches by itself: `failsafes` (station, setpoints, battery, position), `fences`,
and whether it is fit to be armed (`readiness`).
"""
