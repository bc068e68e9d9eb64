"""Dexterity indices."""
