"""The event stream of a host: recording, causes, rate limits, subscriptions."""
