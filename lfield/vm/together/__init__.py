"""`together`: portal calls that are collected, begun, fetched and left (decision 46)."""
