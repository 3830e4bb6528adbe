"""Simulated things: scenes, lenses, sensors, processors, displays; with units and checks.

This package imports no other package of gpusim.
"""
