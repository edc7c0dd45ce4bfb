"""Telemetry messages of a vehicle: motion, condition, payload."""
