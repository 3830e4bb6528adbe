"""Sizes of training pictures [pixel]."""

TILE = 160  # a tile's side
PIECE = 2 * TILE  # a part of a picture that a camera sees at once
CROP = 128  # the part of a tile that a step of training sees
EDGE = 8  # of that part, what does not count
