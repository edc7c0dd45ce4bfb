"""The capability registry."""
