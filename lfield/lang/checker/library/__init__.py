"""Calls of the library that is written in L: methods of arrays, and maps."""
