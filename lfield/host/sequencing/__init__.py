"""Coordinators that others start and stop: the decisions of their home."""
