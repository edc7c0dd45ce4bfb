"""Views of commands in a terminal."""
