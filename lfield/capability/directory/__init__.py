"""Who offers what now, as this host knows it, and what hosts tell one another of it."""
