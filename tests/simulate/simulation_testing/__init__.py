"""Deterministic simulation testing: scenarios from seeds, injected faults, checks of invariants."""
