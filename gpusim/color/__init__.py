"""Colour: matrices, rendering, white balance, encoding, shading."""
