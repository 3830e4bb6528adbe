"""Recipes over a Simulator: several exposures of one scene, and what is made of them."""
