"""Queries of capabilities: their conditions, and the values of the program in them."""
