"""A plan bound to a device: what runs when, and what is kept from one frame to the next."""
