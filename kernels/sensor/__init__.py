"""From mean electrons to digital numbers."""
