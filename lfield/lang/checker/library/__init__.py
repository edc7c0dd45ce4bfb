"""Calls of what is a private method of each unit that calls it: the library in L, enums, functions."""
