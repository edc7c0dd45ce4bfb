"""Instructions with which a thread waits for its host: for a line of input."""
