"""From planes to electrons per channel: diffraction, relative illumination."""
