"""Commands that run hosts."""
