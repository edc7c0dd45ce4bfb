"""What the first pass must know of `together`: which calls can be begun, and what they are begun before."""
