"""The coordinators that are on one host: how they come, are kept, go on, and what happens when none is left."""
