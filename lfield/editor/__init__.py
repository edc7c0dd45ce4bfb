"""Tools to write programs of L: the formatter, and what an editor asks a language server."""
