"""Link health: heartbeats, round-trip times, loss, TCP options."""
