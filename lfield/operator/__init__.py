"""A team seen from outside: asked, queried, found, diagnosed."""
