"""WebAssembly engine: all blocks of a host in one memory, and its program's methods as functions."""
