"""What a vehicle is to do with its body."""
