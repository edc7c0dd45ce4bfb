"""Who may do what in a mission: its access file, and what the rules of it say."""
