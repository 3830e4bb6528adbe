"""How the knobs of a plan are turned: one file for each subject."""
