"""Flight monitoring by telemetry: falls, crashes, a lost position, a foreign target."""
