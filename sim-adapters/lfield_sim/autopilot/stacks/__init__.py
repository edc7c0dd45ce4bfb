"""The autopilots there are, as data: `ardupilot`, `px4`."""
