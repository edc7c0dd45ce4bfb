"""Checked tree to program."""
