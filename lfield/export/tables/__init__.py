"""CSV tables of a stream."""
