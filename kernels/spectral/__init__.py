"""From scene content to spectrally weighted planes."""
