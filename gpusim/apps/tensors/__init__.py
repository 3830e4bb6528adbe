"""Batches of frames as tensors of other libraries."""
