"""Measures of cameras and of pictures: what a laboratory would find."""

from gpusim.measure.merge import MergeInputs, merge_inputs
from gpusim.measure.photon_transfer import PhotonTransfer, photon_transfer

__all__ = ["MergeInputs", "PhotonTransfer", "merge_inputs", "photon_transfer"]
