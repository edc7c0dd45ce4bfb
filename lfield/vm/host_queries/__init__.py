"""Queries of the host itself to its resources."""
