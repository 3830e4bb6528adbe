"""Programs built on the pipeline: video, data sets, preview, filters, tensors."""
