"""Hops on a host, between arrival and call: effects, acknowledgements, init barrier, write-ahead queue."""
