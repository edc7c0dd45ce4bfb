"""What browsers believe of a page on a network: a root of their own, and the keys of pages."""
