"""The maths of L, identical to the bit on every engine and computer (decision 58, table J.9)."""
