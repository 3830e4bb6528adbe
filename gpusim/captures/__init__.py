"""Recipes for several exposures of a scene: brackets, bursts, merges, motion, events, autofocus."""
