"""Voxel backends."""
