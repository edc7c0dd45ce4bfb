"""Commands for operators of a running team."""
