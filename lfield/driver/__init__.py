"""Everything a driver plugin may import."""
