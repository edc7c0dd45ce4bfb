"""Here, so that the tests of all rooms find the helpers that lie in this folder."""
