"""Tools to write programs of L: the formatter, and the functions of a language server."""
