"""Scenarios: drawn from seeds, run, checked, shrunk."""
