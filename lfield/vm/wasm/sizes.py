"""Sizes that the text of a program, its memory and its compiler agree on, in bytes."""

PAGE = 1 << 16
#: The most a memory can have. With so many addresses reserved, code needs no checks that it stays within.
WHOLE = 1 << 32
#: The size of WebAssembly's own stack.
STACK = 1 << 20
