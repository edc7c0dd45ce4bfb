"""The part of the library that is written in L, and its use by a program."""
