"""The benchmark: every stage and twelve pipelines, verified, against the limits of a device."""
