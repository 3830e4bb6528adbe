"""Live preview: move a slider, see the camera change; `gpusim preview`."""
