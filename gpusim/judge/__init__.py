"""Judges of gpusim: truth, verification, benchmarks, forecasts, hard cases."""
