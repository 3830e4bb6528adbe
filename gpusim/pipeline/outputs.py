"""The values that a program gives by name, from the optical image to display codes."""

OUTPUTS = {
    "irradiance": "the optical image at every wavelength of the scene, over each pixel's aperture (L, rows, cols) "
    "[photon s-1 m-2 nm-1]",
    "electrons": "mean electrons that every pixel would collect in every channel (C, rows, cols) [e-]",
    "mean": "mean electrons of every pixel (rows, cols), or of stacked pixels (C, rows, cols) [e-]",
    "chip_mean": "the same of this very chip, binned where charge is [e-]",
    "raw": "digital numbers (rows, cols), layers of stacked pixels one below the other [DN]",
    "camera": "camera values of every pixel, demosaicked (C, rows, cols), white level 1",
    "linear": "linear display RGB before clipping and tone curve (3, rows, cols), display white 1",
    "xyz": "CIE XYZ of that (3, rows, cols), Y of display white 1",
    "codes": "display codes (rows, cols, 3)",
}
