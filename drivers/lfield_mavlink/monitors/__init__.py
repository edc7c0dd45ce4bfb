"""What telemetry says of a flight while it goes on: falls, crashes, a lost position, a foreign target."""
