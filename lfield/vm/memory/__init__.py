"""The block: the whole execution state of an agent in one run of bytes (chapter V, Memory Management)."""
