"""Capabilities as classes of L, and whether a program fits them."""
