"""Event subscriptions of a host: links, timers, telemetry snapshots."""
