"""From digital numbers to linear display colour."""
