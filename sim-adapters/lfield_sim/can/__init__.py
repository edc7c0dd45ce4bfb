"""Fakes on a CAN bus."""
