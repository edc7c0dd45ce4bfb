"""What people write and what they are told: sources, findings, files, YAML with its places."""
