"""Calls of private methods of each unit that calls them: the library in L, enums, functions."""
