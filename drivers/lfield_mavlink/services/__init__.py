"""Protocols beside flight, each over a few messages of its own: parameters, plans, files."""
