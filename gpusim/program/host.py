"""What a Program may do on the host while frames follow each other, and why; all else runs on the device alone."""

STEPS = {  # that may read values of the device
    "facts": "a plan for another kind of scene is made on the host, which looks at the samples",
    "metered": "a picture by itself waits for a few numbers, those of its own exposure; a stream's come a frame late",
    "white": "a white that is estimated from the picture needs a thumbnail of 48 x 64 blocks",
    "mean of pixels": "a Frame, with its report, is NumPy",
}
STAGES = {  # that may work on the host where the device is a CPU
    "optics.mosaic": "SciPy's transforms are faster there than the kernels'",
    "optics.blur": "SciPy's transforms are faster there than the kernels'",
    "optics.field": "SciPy's transforms, and few highlights",
}


def undeclared(on_host, is_gpu: bool) -> list[tuple[str, str]]:
    """(Step, stage) of each read or piece of host work that is not declared above.

    on_host: what `Kept.on_host` gives. is_gpu: whether the device is a GPU.
    """
    return [(step, stage) for step, *stages in on_host if step not in STEPS
            for stage in sorted({*stages[0], *stages[1]}) if is_gpu or stage not in STAGES]
