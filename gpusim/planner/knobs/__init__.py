"""How each knob of a plan is turned: one file a knob."""
