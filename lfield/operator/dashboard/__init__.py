"""Read model of a running team, built from the event streams of its hosts."""
