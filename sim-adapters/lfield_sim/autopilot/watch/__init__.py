"""What an autopilot watches by itself: `failsafes` (station, setpoints, battery, position), `fences`."""
