"""The flight recorder of a host: the inputs of its core, and digests of the effects of the core."""
