"""The part of the library that is written in L, and what a program uses of it."""
