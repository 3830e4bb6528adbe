"""What to model: from a scene and a camera to weights, matrices and models, in float64 on the host."""
