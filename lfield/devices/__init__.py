"""The host's side of its guards: opens devices, calls them and reads their telemetry."""
