"""The outputs of a program by name, from the optical image to display codes."""

OUTPUTS = {
    "irradiance": "optical image at each wavelength of the scene, averaged over pixel apertures (L, rows, cols) "
    "[photon s-1 m-2 nm-1]",
    "electrons": "mean electrons of each pixel in each channel, as if it had all filters (C, rows, cols) [e-]",
    "mean": "mean electrons of each pixel (rows, cols), or of stacked pixels (C, rows, cols) [e-]",
    "chip_mean": "mean electrons with this chip's fixed pattern, after charge binning [e-]",
    "raw": "digital numbers (rows, cols), layers of stacked pixels below each other [DN]",
    "camera": "demosaicked camera values (C, rows, cols), white level 1",
    "linear": "linear display RGB before clipping and tone curve (3, rows, cols), display white 1",
    "xyz": "CIE XYZ of the linear display RGB (3, rows, cols), Y of display white 1",
    "codes": "display codes (rows, cols, 3)",
}
