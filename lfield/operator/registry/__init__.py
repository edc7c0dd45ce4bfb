"""Text output of the capability registry."""
