"""Training of learned filters (local, linear, learned)."""
