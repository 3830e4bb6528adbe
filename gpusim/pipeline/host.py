"""What a Program may do on the host while frames follow each other, and why; all else runs on the device alone."""

STEPS = {  # that may read values of the device
    "facts": "small scenes from the host are looked at there",
    "probes": "now and then, ever more rarely, exact errors are computed on the host, in windows of a scene",
    "plan": "a plan for another kind of scene is made on the host, which looks at windows of the samples",
    "transfer": "tables for another plan begin with the wavelengths, a few numbers",
    "levels": "kernels for another plan, of blurs without transforms, are decomposed on the host",
    "metered": "a picture by itself waits for a few numbers, those of its own exposure; a stream's come a frame late",
    "white": "a white that is estimated from the picture needs a thumbnail of 48 x 64 blocks",
    "mean of pixels": "a Frame, with its report, is NumPy",
}
STAGES = {  # that may read values, or work on the host
    "optics.airy": "of scenes with depth, tables of every layer begin with the wavelengths, a few numbers",
    "optics.pupil": "of scenes with depth, tables of every layer begin with the wavelengths, a few numbers",
    "optics.field": "where the blur varies, highlights are mixed on the host; on CPUs SciPy transforms the tiles",
}
ON_CPUS = {  # the same where the device is a CPU
    "optics.mosaic": "SciPy's transforms are faster there than the kernels'",
    "optics.blur": "SciPy's transforms are faster there than the kernels'",
    "optics.tiles": "by Warp, which has no vectors there, SciPy's transforms are faster than a kernel's",
}


def undeclared(on_host, is_gpu: bool) -> list[tuple[str, str]]:
    """(Step, stage) of each read or piece of host work that is not declared above.

    on_host: what `Kept.on_host` gives. is_gpu: whether the device is a GPU.
    """
    declared = {*STAGES} if is_gpu else {*STAGES, *ON_CPUS}
    return [
        (step, stage)
        for step, reads, work in on_host
        if step not in STEPS
        for stage in sorted({*reads, *work} - declared)
    ]
