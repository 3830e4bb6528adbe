"""What judges gpusim: truth, verification, benchmarks, forecasts, hard cases."""
