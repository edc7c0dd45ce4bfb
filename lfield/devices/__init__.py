"""The host's end of its guards: devices opened, called, and read."""
