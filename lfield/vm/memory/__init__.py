"""The block: the execution state of an agent in contiguous bytes (chapter V, Memory Management)."""
