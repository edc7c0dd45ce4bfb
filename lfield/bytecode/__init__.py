"""Interface between compiler and machine: instructions, program files, verifier."""
