"""Recordings for other tools: a stream of events and telemetry as MCAP for Foxglove, or as CSV tables."""
