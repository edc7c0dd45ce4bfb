"""Failures: of the host itself, and of agents that died here."""
