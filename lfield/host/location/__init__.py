"""Which host holds a coordinator, as the other hosts report it. Pure."""
