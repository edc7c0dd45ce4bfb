"""Blocks shown to people: decoded, dumped, traced."""
