"""Deterministic simulation of a team in one process on virtual time, with fault injection."""
