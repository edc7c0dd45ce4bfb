"""Event subscriptions of an observer, across link losses and restarts."""
