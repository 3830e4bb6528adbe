"""Writers of frames: pictures, raw files, events."""
