"""The engine of a host: which it is, and where the machine code of its program is from."""
