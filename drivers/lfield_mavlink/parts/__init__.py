"""Instructions of a vehicle by topic: the `do_...` coroutines of its manifest, and their common parts."""
