"""Runs plans on a device: the steps of a frame, their order, and the cache between frames."""
