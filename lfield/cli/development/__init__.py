"""Commands for whoever writes a mission."""
