"""Compiler back end: checked syntax tree to program."""
