"""The autopilots as data: `ardupilot`, `px4`."""
