"""What the host itself asks the resources that it runs."""
