"""The registry of capabilities, told to people."""
