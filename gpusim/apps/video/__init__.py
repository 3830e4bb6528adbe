"""Videos: a frame of every scene, as numbered files or encoded; `gpusim video`."""
