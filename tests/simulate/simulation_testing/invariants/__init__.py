"""Checks whether a run kept the promises, from observations of it."""
