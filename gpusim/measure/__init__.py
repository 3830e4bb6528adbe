"""Measurements of cameras and pictures, as made in a laboratory."""

from gpusim.measure.difference import ciede2000, samples_per_degree, scielab
from gpusim.measure.fidelity import cpsnr, ssim
from gpusim.measure.ideal import ideal
from gpusim.measure.merge import MergeInputs, merge_inputs
from gpusim.measure.photon_transfer import PhotonTransfer, photon_transfer
from gpusim.measure.sfr import EdgeResponse, mtf50, sfr
from gpusim.measure.snr import SnrCurve, dynamic_range, snr, snr_curve, visible_snr

__all__ = [
    "EdgeResponse",
    "MergeInputs",
    "PhotonTransfer",
    "SnrCurve",
    "ciede2000",
    "cpsnr",
    "dynamic_range",
    "ideal",
    "merge_inputs",
    "mtf50",
    "photon_transfer",
    "samples_per_degree",
    "scielab",
    "sfr",
    "snr",
    "snr_curve",
    "ssim",
    "visible_snr",
]
