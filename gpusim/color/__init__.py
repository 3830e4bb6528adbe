"""Color: matrices, rendering, white balance, encoding, shading."""
