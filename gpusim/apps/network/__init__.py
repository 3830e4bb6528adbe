"""Training of the demosaicking network (`gpusim train-network`)."""
