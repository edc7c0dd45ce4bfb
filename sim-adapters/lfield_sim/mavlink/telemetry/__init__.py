"""What a vehicle can tell of itself, message by message: motion, condition, equipment."""
