"""Checks of the invariants of a run, from observations."""
