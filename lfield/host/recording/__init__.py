"""The flight recorder of a host: what enters its core, and digests of what the core makes of it."""
