"""Commands for mission developers."""
