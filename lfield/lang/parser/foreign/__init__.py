"""Constructs of other languages, for the hints of the parser."""
