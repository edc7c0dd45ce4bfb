"""The maths of L, written once for every engine and every computer (decision 58, table J.9)."""
