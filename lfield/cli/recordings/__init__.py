"""Commands on recordings: replay, export."""
