"""Communication with one vehicle: its state, commands, telemetry streams and link quality."""
