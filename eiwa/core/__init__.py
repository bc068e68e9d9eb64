"""Numerics, the study file, and the plugin registry."""
