"""Directory updates of a host: sampling of its agents, polling, encoding."""
