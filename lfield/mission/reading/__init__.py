"""Parts of a devices file: one device, and where agents are in the team's frame."""
