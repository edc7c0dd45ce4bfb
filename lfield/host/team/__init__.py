"""The coordinators on one host: how they come, are kept and go on, and what happens when none is left."""
