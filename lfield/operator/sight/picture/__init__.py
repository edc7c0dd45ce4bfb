"""What is known of a team now, from what its hosts tell. Pure."""
